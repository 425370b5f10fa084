"""Packings for ParaView: one VTP file with the grains as points and the contacts as lines.

In ParaView: filter Glyph (sphere, scaled by `diameter`) shows the grains; Tube (vary radius by
`normal_force`) the force chains. Format: XML PolyData, arrays inline in base64 with a UInt64
header, as any version of VTK since 6 reads it.
"""

from __future__ import annotations

import base64
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from .dem.homogenisation import touching
from .dem.packing import Packing
from .dem.structure import rattlers
from .writing import write_text

_TYPES = {"float64": "Float64", "int64": "Int64", "uint8": "UInt8"}


def save_vtp(path: str | Path, packing: Packing) -> None:
    """Write grains (vertices) and contacts (lines from centre to centre) of a packing.

    Point data: `diameter` (m), `contacts`, `rattler`. Cell data: `normal_force` (N, compression
    positive, 0 at grains), `tangential_force` (N), `is_contact`. A contact across a side of the box
    is drawn whole, to an image of the second grain: that point is added, with diameter 0, so that
    glyphs leave it out.

    Raises OSError where it cannot be written.
    """
    contacts = touching(packing)
    size, dim = packing.size, packing.dim
    wrapped = packing.positions - np.floor(packing.positions)
    centres = wrapped @ packing.box.T
    start, end = centres[contacts.pairs[:, 0]], centres[contacts.pairs[:, 1]]
    far = np.linalg.norm(start + contacts.branches - end, axis=1) > 1e-9 * packing.mean_diameter
    images = (start + contacts.branches)[far]
    points = np.zeros((size + len(images), 3))
    points[:, :dim] = np.concatenate([centres, images])
    ends = contacts.pairs[:, 1].copy()
    ends[far] = size + np.arange(len(images))
    lines = np.column_stack([contacts.pairs[:, 0], ends])

    none = np.zeros(len(images))
    point_data = {
        "diameter": np.append(2 * packing.radii, none),
        "contacts": np.append(np.bincount(contacts.pairs.ravel(), minlength=size), none).astype(
            np.int64
        ),
        "rattler": np.append(rattlers(packing, contacts), none).astype(np.uint8),
    }
    tangential = contacts.forces + contacts.normal_force[:, None] * contacts.normals
    grains = np.zeros(size)
    cell_data = {
        "normal_force": np.append(grains, contacts.normal_force),
        "tangential_force": np.append(grains, np.linalg.norm(tangential, axis=1)),
        "is_contact": np.append(grains, np.ones(len(lines))).astype(np.uint8),
    }
    counts = (
        f'NumberOfPoints="{len(points)}" NumberOfVerts="{size}" NumberOfLines="{len(lines)}"'
        ' NumberOfStrips="0" NumberOfPolys="0"'
    )
    text = "\n".join([
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        f"<PolyData><Piece {counts}>",
        "<PointData>", *(_array(name, values) for name, values in point_data.items()),
        "</PointData><CellData>", *(_array(name, values) for name, values in cell_data.items()),
        "</CellData><Points>", _array("Points", points), "</Points>",
        "<Verts>", *_cells(np.arange(size)[:, None]), "</Verts>",
        "<Lines>", *_cells(lines), "</Lines>",
        "</Piece></PolyData></VTKFile>", "",
    ])  # fmt: skip
    write_text(path, text)


def _cells(cells: np.ndarray) -> tuple[str, str]:
    """Connectivity and offsets of cells that all have the same number of points."""
    offsets = cells.shape[1] * np.arange(1, len(cells) + 1)
    return _array("connectivity", cells.ravel()), _array("offsets", offsets)


def _array(name: str, values: np.ndarray) -> str:
    """A DataArray, inline: the number of bytes (UInt64) and the bytes, both little endian."""
    kind = _TYPES[values.dtype.name]
    content = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes()
    header = np.array([len(content)], "<u8").tobytes()
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    encoded = base64.b64encode(header + content).decode()
    return (
        f'<DataArray type="{kind}" Name={quoteattr(name)}{components} format="binary">{encoded}'
        "</DataArray>"
    )
