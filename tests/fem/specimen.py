"""A specimen for the tests, in 2D and 3D: platens above and below, pressure on the sides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from femxdem_fenicsx.double_stress import one_parameter
from femxdem_fenicsx.fem.convergence import Convergence
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.problem import Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from femxdem_fenicsx.law import Law
from forms.first_gradient import FirstGradient
from forms.second_gradient import SecondGradient
from meshes import box, rectangle

WIDTH, HEIGHT = 1.0, 2.0


class Specimen:
    """1 m x 2 m, or 1 m x 1 m x 2 m for an element in 3D; the top is moved by `top`.

    A modulus, N, makes it a second-gradient continuum. The bottom is smooth, with one point fixed,
    and another one against rotation in 3D.
    """

    def __init__(
        self,
        make_law: Callable[[QuadraturePoints], Law],
        *,
        name: str = "Q8",
        formulation: str = "finite",
        modulus: float | None = None,
        micro_strain: str = "linear",
        cells: tuple[int, ...] | None = None,
        distortion: float | None = None,
        rough: bool = False,
        axial_load: bool = False,
        tolerance: float = 1e-10,
        max_iterations: int = 30,
        comm: MPI.Comm = MPI.COMM_WORLD,
    ):
        kind = element(name)
        if kind.dim == 2:
            size, shape = (WIDTH, HEIGHT), rectangle
            distortion = 0.2 if distortion is None else distortion
            mesh = rectangle.rectangle(comm, *size, *(cells or (2, 3)), kind, distortion)
            tags = rectangle.sides(mesh, *size)
            lateral = (rectangle.LEFT, rectangle.RIGHT)
        else:
            size, shape = (WIDTH, WIDTH, HEIGHT), box
            distortion = 0.15 if distortion is None else distortion
            mesh = box.box(comm, size, cells or (2, 2, 3), kind, distortion)
            tags = box.sides(mesh, size)
            lateral = (box.LEFT, box.RIGHT, box.FRONT, box.BACK)
        self.mesh = mesh
        self.points = QuadraturePoints(mesh, kind)
        self.law = make_law(self.points)
        if modulus is None:
            self.medium = FirstGradient(self.points, formulation)
        else:
            stiffness = one_parameter(modulus, kind.dim)
            self.medium = SecondGradient(self.points, formulation, stiffness, micro_strain)
        self.u = u = self.medium.unknown
        self.operator = ExternalOperator(
            self.medium.F, self.law, self.points, 0.5, self.medium.states
        )
        self.pressure, self.axial = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
        self.top, zero = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
        ds = kind.ds(mesh, tags)
        loads = [(self.pressure, ds(lateral)), (self.axial, ds(shape.TOP))]
        residual, jacobian = self.medium.equilibrium(
            self.operator.stress, self.operator.tangent, loads
        )
        V, facet = self.medium.space, kind.dim - 1
        *across, axial = (V.sub(axis) for axis in range(kind.dim))
        self.top_dofs = fem.locate_dofs_topological(axial, facet, tags.find(shape.TOP))
        bottom = fem.locate_dofs_topological(axial, facet, tags.find(shape.BOTTOM))
        bcs = [fem.dirichletbc(zero, bottom, axial)]
        for side in (shape.TOP, shape.BOTTOM):
            bcs += self.medium.straight(tags.find(side), facet, facet)
        held = [(component, [WIDTH / 2] * len(across)) for component in across]
        if kind.dim == 3:
            held.append((across[1], [WIDTH, WIDTH / 2]))
        for component, place in held:
            vertex = shape.vertex_near(mesh, *place, 0.0)
            dofs = fem.locate_dofs_topological(component, 0, vertex)
            bcs.append(fem.dirichletbc(zero, dofs, component))
        if not axial_load:
            bcs.append(fem.dirichletbc(self.top, self.top_dofs, axial))
        if rough:
            for component in across:
                dofs = fem.locate_dofs_topological(component, facet, tags.find(shape.TOP))
                bcs.append(fem.dirichletbc(zero, dofs, component))
        self.problem = Problem(
            u, residual, jacobian, self.operator, bcs, Convergence(tolerance, None, max_iterations)
        )

    def compress(self, start: float, end: float) -> None:
        """Move the top so that the axial strain (by the first height) goes from start to end."""
        self.top.value = -(end - start) * HEIGHT

    def top_force(self) -> float:
        return self.problem.reaction(self.top_dofs)

    def volume(self) -> float:
        return self.mesh.comm.allreduce(float(self.points.volumes().sum()))

    def committed_stress(self) -> np.ndarray:
        return self.law.evaluate(np.tile(np.eye(self.law.dim), (self.points.size, 1, 1)))
