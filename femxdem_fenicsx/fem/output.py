"""Results on disk: fields in XDMF + HDF5 for ParaView, and a table of the load path."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from dolfinx import fem, io
from mpi4py import MPI

from . import _dolfinx
from ..collective import together
from .quadrature_points import QuadraturePoints


def writable_folder(comm: MPI.Comm, folder: str | Path) -> Path:
    """Make the folder, if need be, and try to write into it.

    Raises:
        OSError: on all ranks, with one line, if that does not work.
    """
    message = None
    if comm.rank == 0:
        try:
            Path(folder).mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            message = f"cannot write results into {folder}: {error.strerror}"
    message = comm.bcast(message)
    if message:
        raise OSError(message)
    return Path(folder)


class Fields:
    """Time series in ``<path>.xdmf`` and ``<path>.h5``, on the mesh as it is now.

    Make it before the mesh moves: then "warp by vector" with the displacement shows the deformed
    specimen. Use it in a `with` statement; the files are complete when it ends.

    Args:
        path: without suffix.
        points: whose mesh and cell means are written.
        displacement: of the nodes (`problem.motion.displacement`), m.
    """

    def __init__(self, path: str | Path, points: QuadraturePoints, displacement: fem.Function):
        self._points, self._displacement = points, displacement
        self._functions: dict[str, fem.Function] = {}
        self._path = Path(path).with_suffix(".xdmf")
        self._file = io.XDMFFile(points.mesh.comm, str(self._path), "w")
        self._file.write_mesh(points.mesh)

    def __enter__(self) -> Fields:
        return self

    def __exit__(self, *error) -> None:
        self.close()

    def write(self, time: float, values: Mapping[str, np.ndarray]) -> None:
        """Write the displacement and the mean over each cell of values at quadrature points.

        Args:
            time: abscissa of the series, e.g. the axial strain.
            values: name -> (points.size, ...): scalars, vectors or tensors; the same names in each
                call and on each rank.
        """
        self._file.write_function(self._displacement, time)
        for name, at_points in values.items():
            means = self._points.cell_means(_dolfinx.xdmf_tensors(at_points))
            function = self._function(name, means.shape[1:])
            means = means.reshape(len(means), -1)
            dofs = _dolfinx.dofmap(function.function_space)[: len(means), 0]
            function.x.array.reshape(-1, means.shape[1])[dofs] = means
            function.x.scatter_forward()
            self._file.write_function(function, time)
        if self._points.mesh.comm.rank == 0:
            _one_grid_per_time(self._path)

    def _function(self, name: str, shape: tuple[int, ...]) -> fem.Function:
        if name not in self._functions:
            element = _dolfinx.discontinuous_element(self._points.element.cell, shape)
            space = _dolfinx.functionspace(self._points.mesh, element)
            self._functions[name] = fem.Function(space)
            self._functions[name].name = name
        return self._functions[name]

    def close(self) -> None:
        """Complete the files."""
        self._file.close()


def _one_grid_per_time(path: Path) -> None:
    """Gather the attributes of each time into one grid.

    DOLFINx writes one series of grids per function, so that ParaView could not warp the stress by
    the displacement. It keeps its own document in memory and writes it anew each time.
    """
    domain = ElementTree.parse(path).getroot().find("Domain")
    shape = [domain.find("Grid[@GridType='Uniform']").find(tag) for tag in ("Topology", "Geometry")]
    attributes: dict[str, list[ElementTree.Element]] = {}
    for grid in domain.findall("Grid[@GridType='Collection']/Grid"):
        time = grid.find("Time").get("Value")
        attributes.setdefault(time, []).extend(grid.findall("Attribute"))
    document = ElementTree.Element("Xdmf", Version="3.0")
    series = ElementTree.SubElement(
        ElementTree.SubElement(document, "Domain"),
        "Grid",
        Name=path.stem,
        GridType="Collection",
        CollectionType="Temporal",
    )
    for time, present in attributes.items():
        grid = ElementTree.SubElement(series, "Grid", Name=path.stem, GridType="Uniform")
        ElementTree.SubElement(grid, "Time", Value=time)
        grid.extend([*shape, *present])
    ElementTree.ElementTree(document).write(path, encoding="utf-8", xml_declaration=True)


class History:
    """A CSV table that grows by one row per load step and is on disk after each.

    Args:
        comm: rank 0 writes.
        path: of the file.
        columns: names, with units where there are any.
    """

    def __init__(self, comm: MPI.Comm, path: str | Path, columns: Sequence[str]):
        self._columns = tuple(columns)
        self._file = together(comm, lambda: open(path, "w") if comm.rank == 0 else None)
        self._line(self._columns)

    def __enter__(self) -> History:
        return self

    def __exit__(self, *error) -> None:
        self.close()

    def write(self, row: Mapping[str, float]) -> None:
        """Add a row.

        Raises:
            ValueError: names other than the columns.
        """
        if set(row) != set(self._columns):
            raise ValueError(f"history row has {sorted(row)}, the table {sorted(self._columns)}")
        self._line([_text(row[name]) for name in self._columns])

    def _line(self, cells: Sequence[str]) -> None:
        if self._file:
            self._file.write(",".join(cells) + "\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        if self._file:
            self._file.close()


def _text(value: float) -> str:
    """Integers and flags as integers, numbers with all their digits."""
    return str(int(value)) if isinstance(value, (bool, int, np.integer)) else repr(float(value))
