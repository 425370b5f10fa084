"""The only file that knows DOLFINx versions: 0.5.2 (Debian 12), 0.9 (Debian 13) and later.

Everything else in the project uses DOLFINx names that all these versions share, or the functions
below, which have the same arguments and results on all of them.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence

import basix
import dolfinx
import dolfinx.fem.petsc
import dolfinx.mesh
import numpy as np
import ufl
from mpi4py import MPI
from petsc4py import PETSc

VERSION = tuple(int(part) for part in dolfinx.__version__.split(".")[:2])
UFL_ELEMENTS = VERSION < (0, 8)  # elements are UFL objects; basix.ufl came after them

if UFL_ELEMENTS:
    import basix.ufl_wrapper
else:
    import basix.ufl


def _drop_compiler_chatter(record: logging.LogRecord) -> bool:
    return record.levelno >= logging.WARNING or "distutils" not in record.pathname


# The JIT of 0.5 builds through distutils, which sets the level of the root logger back to INFO.
logging.getLogger().addFilter(_drop_compiler_chatter)


# ---- elements and spaces -----------------------------------------------------------------------


def lagrange_element(cell: str, degree: int, shape: tuple[int, ...] = ()):
    """Continuous Lagrange element with values of the given shape."""
    return _element("Lagrange", cell, degree, shape)


def discontinuous_element(cell: str, shape: tuple[int, ...] = ()):
    """One value (of the given shape) per cell."""
    return _element("DG", cell, 0, shape)


def quadrature_element(cell: str, degree: int, shape: tuple[int, ...] = ()):
    """Values of the given shape at the points of Basix' default scheme."""
    if UFL_ELEMENTS:
        return _ufl_element("Quadrature", cell, degree, shape, quad_scheme="default")
    return basix.ufl.quadrature_element(cell, value_shape=shape, scheme="default", degree=degree)


def serendipity_element(shape: tuple[int, ...] = ()):
    """Eight-node serendipity quadrilateral with nodal dofs, values of the given shape.

    Basix' own serendipity family has moment dofs on the edges: no coordinates, no constants in
    Dirichlet conditions. This element spans the same functions.
    """
    cell = basix.CellType.quadrilateral
    points, weights = basix.make_quadrature(cell, 6)
    legendre = basix.tabulate_polynomials(basix.PolynomialType.legendre, cell, 2, points)
    x, y = points.T
    span = [np.ones_like(x), x, y, x * y, x * x, y * y, x * x * y, x * y * y]
    coefficients = np.array([[np.sum(weights * s * p) for p in legendre] for s in span])
    vertices = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    midpoints = np.array([[0.5, 0.0], [0.0, 0.5], [1.0, 0.5], [0.5, 1.0]])
    nodes = [[v[None] for v in vertices], [m[None] for m in midpoints], [np.zeros((0, 2))], []]
    at_node = np.ones((1, 1, 1, 1))
    matrices = [[at_node] * 4, [at_node] * 4, [np.zeros((0, 1, 0, 1))], []]
    if UFL_ELEMENTS:
        scalar = basix.ufl_wrapper.BasixElement(
            basix.create_custom_element(
                cell, [], coefficients, nodes, matrices, 0, basix.MapType.identity, False, 1, 2
            )
        )
        if not shape:
            return scalar
        if len(shape) == 1:
            return basix.ufl_wrapper.VectorElement(scalar, shape[0])
        return basix.ufl_wrapper.TensorElement(scalar, shape)
    scalar = basix.ufl.custom_element(
        cell,
        (),
        coefficients,
        nodes,
        matrices,
        0,
        basix.MapType.identity,
        basix.SobolevSpace.H1,
        False,
        1,
        2,
    )
    return basix.ufl.blocked_element(scalar, shape) if shape else scalar


def mixed_element(elements: Sequence):
    """Element of functions that are solved for together."""
    return ufl.MixedElement(elements) if UFL_ELEMENTS else basix.ufl.mixed_element(elements)


def _element(family: str, cell: str, degree: int, shape: tuple[int, ...]):
    if UFL_ELEMENTS:
        return _ufl_element(family, cell, degree, shape)
    return basix.ufl.element(family, cell, degree, shape=shape or None)


def _ufl_element(family: str, cell: str, degree: int, shape: tuple[int, ...], **scheme):
    if not shape:
        return ufl.FiniteElement(family, cell, degree, **scheme)
    if len(shape) == 1:
        return ufl.VectorElement(family, cell, degree, dim=shape[0], **scheme)
    return ufl.TensorElement(family, cell, degree, shape=shape, **scheme)


def functionspace(mesh, element):
    """Function space of `element` on `mesh`."""
    if UFL_ELEMENTS:
        return dolfinx.fem.FunctionSpace(mesh, element)
    return dolfinx.fem.functionspace(mesh, element)


def quadrature_rule(cell: str, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (q, tdim) and weights (q,) of Basix' default scheme on the reference cell."""
    return basix.make_quadrature(getattr(basix.CellType, cell), degree)


def vertex_weights(cell: str, degree: int) -> np.ndarray:
    """Weights of a cell's vertices (v) at its Lagrange nodes of `degree` (k), (k, v).

    Both in DOLFINx' order, for cells with straight edges.
    """
    kind, lagrange = getattr(basix.CellType, cell), basix.ElementFamily.P
    nodes = basix.create_element(lagrange, kind, degree).points
    return basix.create_element(lagrange, kind, 1).tabulate(0, nodes)[0, :, :, 0].round(12)


# ---- meshes ------------------------------------------------------------------------------------


def create_mesh(comm: MPI.Comm, cells: np.ndarray, x: np.ndarray, cell: str, degree: int):
    """Mesh of Lagrange cells of `degree` from `cells` (c, k) and node coordinates `x` (n, gdim).

    Each rank passes a share of both, or none; nodes are in DOLFINx' order.
    """
    cells = np.ascontiguousarray(cells, dtype=np.int64)
    x = np.ascontiguousarray(x, dtype=np.float64)
    coordinates = lagrange_element(cell, degree, (x.shape[1],))
    if UFL_ELEMENTS:
        return dolfinx.mesh.create_mesh(comm, cells, x, ufl.Mesh(coordinates))
    # by keyword: 0.10 swapped the positions of x and e
    return dolfinx.mesh.create_mesh(comm, cells=cells, x=x, e=ufl.Mesh(coordinates))


def number_of_cells(mesh) -> tuple[int, int]:
    """Cells on this rank: owned ones, and owned ones with ghosts."""
    index_map = mesh.topology.index_map(mesh.topology.dim)
    return index_map.size_local, index_map.size_local + index_map.num_ghosts


def geometry_dofmap(mesh) -> np.ndarray:
    """Rows of ``mesh.geometry.x`` at the nodes of each cell, ghosts included, (c, k)."""
    geometry = mesh.geometry
    nodes = geometry.dofmaps[0] if VERSION >= (0, 11) else geometry.dofmap
    return _rows(nodes, number_of_cells(mesh)[1], geometry.cmap.create_dof_layout())


def dofmap(space) -> np.ndarray:
    """Blocked dofs of each cell, ghosts included, (c, k)."""
    return _rows(space.dofmap.list, number_of_cells(space.mesh)[1], space.dofmap.dof_layout)


def vtk_order(mesh, nodes: int) -> np.ndarray:
    """Places in DOLFINx' order of a cell's nodes, in the order of VTK and XDMF, (nodes,)."""
    kind = dolfinx.cpp.mesh.to_type(mesh.ufl_cell().cellname())
    return np.argsort(dolfinx.cpp.io.perm_vtk(kind, nodes))


def cell_values(function) -> np.ndarray:
    """Dofs of a function on each cell, ghosts included, (c, k): the same on any number of ranks.

    For elements with at most one node in the inside of an edge or face, whose order on a cell
    follows from that cell alone.
    """
    space = function.function_space
    block = space.dofmap.index_map_bs
    dofs = dofmap(space)
    return function.x.array.reshape(-1, block)[dofs].reshape(len(dofs), dofs.shape[1] * block)


def set_cell_values(function, values: np.ndarray) -> None:
    """Give a function the dofs that `cell_values` has read, ghosts included."""
    space = function.function_space
    block = space.dofmap.index_map_bs
    dofs = dofmap(space)
    function.x.array.reshape(-1, block)[dofs] = values.reshape(*dofs.shape, block)


def cell_dofs(space) -> np.ndarray:
    """Unblocked dofs of each cell, ghosts included, in the order of `cell_values`, (c, k)."""
    block = space.dofmap.index_map_bs
    dofs = dofmap(space)[:, :, None] * block + np.arange(block)
    return dofs.reshape(len(dofs), dofs.shape[1] * block).astype(PETSc.IntType)


def cell_matrices(matrix: PETSc.Mat, space) -> np.ndarray:
    """Entries of an assembled `matrix` between the dofs of each owned cell, (c, k, k).

    Together they are all entries of a form without integrals over interior facets.
    """
    owned = cell_dofs(space)[: number_of_cells(space.mesh)[0]]
    own, at = np.unique(matrix.getLGMap()[0].apply(owned.ravel()), return_inverse=True)
    rows = PETSc.IS().createGeneral(own, comm=PETSc.COMM_SELF)
    (mine,) = matrix.createSubMatrices([rows], [rows])  # with rows of other ranks
    cells = at.astype(PETSc.IntType).reshape(owned.shape)
    values = [mine.getValues(cell, cell) for cell in cells]
    mine.destroy()
    return np.array(values).reshape(*cells.shape, cells.shape[1])


def set_cell_matrices(matrix: PETSc.Mat, space, values: np.ndarray) -> None:
    """Give a matrix the entries that `cell_matrices` has read, of owned cells at least."""
    matrix.zeroEntries()
    owned = cell_dofs(space)[: number_of_cells(space.mesh)[0]]
    for dofs, entries in zip(owned, values, strict=False):
        matrix.setValuesLocal(dofs, dofs, entries)
    matrix.assemble()


def _rows(adjacency, count: int, layout) -> np.ndarray:
    flat = adjacency.array if hasattr(adjacency, "array") else np.asarray(adjacency)
    columns = -1 if count else layout.num_dofs  # a rank without any cell
    return flat.reshape(count, columns)


# ---- expressions and linear algebra ------------------------------------------------------------


def evaluate(expression, mesh, cells: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Values of a compiled expression, (len(cells), points, *shape)."""
    cells = np.ascontiguousarray(cells, dtype=np.int32)
    values = expression.eval(cells) if UFL_ELEMENTS else expression.eval(mesh, cells)
    return np.asarray(values).reshape(len(cells), expression.X().shape[0], *shape)


def interpolation_points(space) -> np.ndarray:
    """Reference points at which the space evaluates what it interpolates."""
    points = space.element.interpolation_points
    return points() if callable(points) else points


def create_vector(form, space) -> PETSc.Vec:
    """Vector with ghosts, to assemble the linear `form` of `space` into."""
    return dolfinx.fem.petsc.create_vector(space if VERSION >= (0, 10) else form)


def assemble_vector(vector: PETSc.Vec, form) -> None:
    """Assemble a linear form; contributions of other ranks are added to the owned entries."""
    with vector.localForm() as local:
        local.set(0.0)
    dolfinx.fem.petsc.assemble_vector(vector, form)
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)


def assemble_matrix(matrix: PETSc.Mat, form, bcs: Sequence) -> None:
    """Assemble a bilinear form, identity in the rows and columns of constrained dofs."""
    matrix.zeroEntries()
    dolfinx.fem.petsc.assemble_matrix(matrix, form, bcs)
    matrix.assemble()


def lift(vector: PETSc.Vec, form, bcs: Sequence) -> None:
    """Subtract the bilinear `form` applied to the prescribed values from `vector` (owned)."""
    with vector.localForm() as local:
        before = local.array.copy()
        local.set(0.0)
    dolfinx.fem.petsc.apply_lifting(vector, [form], [bcs])
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    vector.array[:] += before[: vector.local_size]


def prescribed(vector: PETSc.Vec, bcs: Sequence) -> tuple[np.ndarray, np.ndarray]:
    """Owned dofs (unblocked) that `bcs` constrain, sorted, and their present values.

    `vector` lends its layout; its entries are overwritten.
    """
    owned = [indices[:first_ghost] for indices, first_ghost in (bc.dof_indices() for bc in bcs)]
    dofs = np.unique(np.concatenate([np.zeros(0, dtype=np.int32), *owned]))
    dolfinx.fem.petsc.set_bc(vector, bcs)
    return dofs, vector.array_r[dofs].copy()
