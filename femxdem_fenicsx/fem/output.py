"""Results on disk: fields in XDMF + HDF5 for ParaView, a table of the load path, a log."""

from __future__ import annotations

import shutil
import tempfile
import time as clock
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
from dolfinx import fem
from mpi4py import MPI

from ..collective import together
from ..writing import hdf5_bytes, write_whole
from . import _dolfinx
from .quadrature_points import QuadraturePoints

#: XDMF's names of cells, by DOLFINx' name and number of nodes.
TOPOLOGY = {
    ("triangle", 3): "Triangle",
    ("triangle", 6): "Triangle_6",
    ("quadrilateral", 4): "Quadrilateral",
    ("quadrilateral", 9): "Quadrilateral_9",
    ("tetrahedron", 4): "Tetrahedron",
    ("tetrahedron", 10): "Tetrahedron_10",
    ("hexahedron", 8): "Hexahedron",
    ("hexahedron", 27): "Hexahedron_27",
}
#: XDMF's names of values, by how many components they have in three dimensions.
VALUES = {1: "Scalar", 3: "Vector", 9: "Tensor"}


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


def on_first_rank(comm: MPI.Comm, action: Callable, *arguments):
    """Call it on rank 0 alone; what it raises, all ranks raise."""
    return together(comm, action if comm.rank == 0 else lambda *_: None, *arguments)


class Fields:
    """Time series in ``<path>.xdmf``, on the mesh as it is now.

    The values of each time are an HDF5 file of their own in the folder ``<path>_fields``, which is
    there as a whole or not at all: what has been written can be read while the run goes on, and
    after it was killed. DOLFINx' own writer keeps one HDF5 file open, unreadable, to the end.

    Make it before the mesh moves: then "warp by vector" with the displacement shows the deformed
    specimen. Nodes and cells are in their original order, whatever the number of ranks.

    Args:
        path: without suffix.
        points: whose mesh and cell means are written.
        displacement: of the nodes (`problem.motion.displacement`), m.
        keep: go on behind so many times of an earlier run; what it wrote later is dropped.
    """

    def __init__(
        self,
        path: str | Path,
        points: QuadraturePoints,
        displacement: fem.Function,
        keep: int = 0,
    ):
        self._points, self._displacement = points, displacement
        self._comm, self._dim = points.mesh.comm, points.mesh.geometry.dim
        self._path = Path(path).with_suffix(".xdmf")
        self._folder = self._path.with_name(f"{self._path.stem}_fields")
        self._times: dict[int, tuple[float, dict[str, list[int]]]] = {}
        self._next = keep
        owned = slice(len(points.cells))
        numbers = np.asarray(points.mesh.geometry.input_global_indices, np.int64)
        nodes = numbers[_dolfinx.geometry_dofmap(points.mesh)[owned]]
        self._dofs = _dolfinx.dofmap(displacement.function_space)[owned]
        x = points.mesh.geometry.x[_dolfinx.geometry_dofmap(points.mesh)[owned]][..., : self._dim]
        on_first_rank(self._comm, self._begin, keep, points.gather(nodes, x))

    def _begin(self, keep: int, mesh: tuple[np.ndarray, np.ndarray]) -> None:
        self._nodes, x = mesh
        self._count = int(self._nodes.max()) + 1
        if keep == 0:
            shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir(exist_ok=True)
        for file in self._folder.glob("[0-9]*.h5"):
            if int(file.stem) >= keep:
                file.unlink()
        topology = self._nodes[:, _dolfinx.vtk_order(self._points.mesh, self._nodes.shape[1])]
        geometry = self._at_nodes(x)

        def fill(file: h5py.File) -> None:
            file["topology"], file["geometry"] = topology, geometry

        write_whole(self._folder / "mesh.h5", hdf5_bytes(fill))
        for number in range(keep):
            file = self._folder / f"{number:06d}.h5"
            if file.exists():
                with h5py.File(file, "r") as h5:
                    shapes = {name: list(h5[name].shape) for name in h5.attrs["names"]}
                    self._times[number] = float(h5.attrs["time"]), shapes
        self._write_document()

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

        Raises:
            OSError: on all ranks, where rank 0 cannot write.
        """
        means = [self._points.cell_means(at_points) for at_points in values.values()]
        moved = self._displacement.x.array.reshape(-1, self._dim)[self._dofs]
        gathered = self._points.gather(moved, *means)
        on_first_rank(self._comm, self._write, time, tuple(values), gathered)

    def _write(self, time: float, names: tuple[str, ...], gathered: tuple[np.ndarray, ...]) -> None:
        displacement, *means = gathered
        arrays = {self._displacement.name: _in_space(self._at_nodes(displacement))}
        arrays |= {name: _in_space(mean) for name, mean in zip(names, means, strict=True)}

        def fill(file: h5py.File) -> None:
            file.attrs["time"], file.attrs["names"] = time, list(arrays)
            for name, array in arrays.items():
                file[name] = array

        write_whole(self._folder / f"{self._next:06d}.h5", hdf5_bytes(fill))
        shapes = {name: list(array.shape) for name, array in arrays.items()}
        self._times[self._next] = time, shapes
        self._next += 1
        self._write_document()

    def _at_nodes(self, by_cell: np.ndarray) -> np.ndarray:
        """Values at the nodes of each cell (c, k, m) -> values of each node (n, m)."""
        at_nodes = np.zeros((self._count, by_cell.shape[-1]))
        at_nodes[self._nodes] = by_cell
        return at_nodes

    def _write_document(self) -> None:
        """The XML: one grid per time, so that ParaView can warp the stress by the displacement."""
        document = ElementTree.Element("Xdmf", Version="3.0")
        series = ElementTree.SubElement(
            ElementTree.SubElement(document, "Domain"),
            "Grid",
            Name=self._path.stem,
            GridType="Collection",
            CollectionType="Temporal",
        )
        cells, k = self._nodes.shape
        kind = TOPOLOGY[self._points.element.cell, k]
        for number, (time, shapes) in self._times.items():
            grid = ElementTree.SubElement(series, "Grid", Name=self._path.stem, GridType="Uniform")
            ElementTree.SubElement(grid, "Time", Value=repr(float(time)))
            topology = ElementTree.SubElement(
                grid, "Topology", TopologyType=kind, NumberOfElements=str(cells)
            )
            self._item(topology, "mesh.h5", "topology", [cells, k], NumberType="Int")
            plane = "XY" if self._dim == 2 else "XYZ"
            geometry = ElementTree.SubElement(grid, "Geometry", GeometryType=plane)
            self._item(geometry, "mesh.h5", "geometry", [self._count, self._dim])
            for name, shape in shapes.items():
                attribute = ElementTree.SubElement(
                    grid,
                    "Attribute",
                    Name=name,
                    AttributeType=VALUES[shape[1]],
                    Center="Node" if name == self._displacement.name else "Cell",
                )
                self._item(attribute, f"{number:06d}.h5", name, shape)
        text = ElementTree.tostring(document, encoding="utf-8", xml_declaration=True)
        write_whole(self._path, text)

    def _item(self, parent, file: str, name: str, shape: Sequence[int], NumberType="Float") -> None:
        item = ElementTree.SubElement(
            parent,
            "DataItem",
            Dimensions=" ".join(map(str, shape)),
            Format="HDF",
            NumberType=NumberType,
            Precision="8",
        )
        item.text = f"{self._folder.name}/{file}:/{name}"

    def close(self) -> None:
        """Nothing is left to do: the files are complete after each `write`."""


def _in_space(values: np.ndarray) -> np.ndarray:
    """(n, ...) with components as XDMF knows them: scalars 1, vectors 3, tensors 9."""
    missing = [(0, 3 - length) for length in values.shape[1:] if length > 1]
    if values.ndim == 1 or not missing:
        return values.reshape(len(values), 1)
    return np.pad(values, [(0, 0), *missing]).reshape(len(values), -1)


class History:
    """A CSV table that grows by one row per load step and is on disk after each.

    Args:
        comm: rank 0 writes.
        path: of the file.
        columns: names, with units where there are any.
        rows: of an earlier run, to go on behind them.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        path: str | Path,
        columns: Sequence[str],
        rows: Sequence[Mapping[str, float]] = (),
    ):
        self._comm, self._path, self._columns = comm, Path(path), tuple(columns)
        self._file = None
        on_first_rank(comm, self._begin, rows)

    def _begin(self, rows: Sequence[Mapping[str, float]]) -> None:
        lines = [",".join(self._columns), *map(self._text, rows)]
        write_whole(self._path, "".join(f"{line}\n" for line in lines).encode())
        self._file = open(self._path, "a")

    def __enter__(self) -> History:
        return self

    def __exit__(self, *error) -> None:
        self.close()

    def write(self, row: Mapping[str, float]) -> None:
        """Add a row.

        Raises:
            ValueError: names other than the columns.
            OSError: on all ranks, where rank 0 cannot write.
        """
        if set(row) != set(self._columns):
            raise ValueError(f"history row has {sorted(row)}, the table {sorted(self._columns)}")
        on_first_rank(self._comm, self._append, row)

    def _append(self, row: Mapping[str, float]) -> None:
        self._file.write(self._text(row) + "\n")
        self._file.flush()

    def _text(self, row: Mapping[str, float]) -> str:
        return ",".join(_text(row[name]) for name in self._columns)

    def close(self) -> None:
        """Close the file."""
        if self._file:
            self._file.close()


def _text(value: float) -> str:
    """Integers and flags as integers, numbers with all their digits."""
    whole = isinstance(value, (bool, int, np.integer, np.bool_))
    return str(int(value)) if whole else repr(float(value))


class Log:
    """What happens during a run, with the time of day, on rank 0.

    Args:
        comm: rank 0 writes.
        path: of the file.
        append: go on with the file of an earlier run.
    """

    def __init__(self, comm: MPI.Comm, path: str | Path, append: bool = False):
        self._comm = comm
        self._file = on_first_rank(comm, open, path, "a" if append else "w")

    def __enter__(self) -> Log:
        return self

    def __exit__(self, kind, error, trace) -> None:
        if self._file:
            if error is not None:
                self.say(f"stopped: {type(error).__name__}: {error}")
            self._file.close()

    def say(self, line: str) -> None:
        """Add a line. A log that cannot be written stops nothing."""
        if self._file:
            try:
                print(clock.strftime("%Y-%m-%d %H:%M:%S"), line, file=self._file, flush=True)
            except OSError:
                pass
