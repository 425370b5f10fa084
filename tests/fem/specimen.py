"""A rectangular specimen for the tests: platens above and below, pressure on the sides."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.problem import Convergence, Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from femxdem_fenicsx.law import Law
from forms import first_gradient
from meshes.rectangle import BOTTOM, LEFT, RIGHT, TOP, rectangle, sides, vertex_near

WIDTH, HEIGHT = 1.0, 2.0


class Specimen:
    """1 m x 2 m; the bottom is smooth with one point fixed, the top is moved by `top`."""

    def __init__(
        self,
        make_law: Callable[[QuadraturePoints], Law],
        *,
        name: str = "Q8",
        formulation: str = "finite",
        cells: tuple[int, int] = (2, 3),
        distortion: float = 0.2,
        rough: bool = False,
        axial_load: bool = False,
        tolerance: float = 1e-10,
        max_iterations: int = 30,
        comm: MPI.Comm = MPI.COMM_WORLD,
    ):
        kind = element(name)
        self.mesh = mesh = rectangle(comm, WIDTH, HEIGHT, *cells, kind, distortion)
        tags = sides(mesh, WIDTH, HEIGHT)
        self.points = QuadraturePoints(mesh, kind)
        self.law = make_law(self.points)
        self.u = u = fem.Function(kind.space(mesh))
        self.operator = ExternalOperator(
            first_gradient.deformation_gradient(u), self.law, self.points
        )
        self.pressure, self.axial = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
        self.top, zero = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
        ds = kind.ds(mesh, tags)
        loads = [(self.pressure, ds((LEFT, RIGHT))), (self.axial, ds(TOP))]
        residual, jacobian = getattr(first_gradient, formulation)(
            u, self.operator.stress, self.operator.tangent, kind.dx(mesh), loads
        )
        x, y = u.function_space.sub(0), u.function_space.sub(1)
        self.top_dofs = fem.locate_dofs_topological(y, 1, tags.find(TOP))
        bottom = fem.locate_dofs_topological(y, 1, tags.find(BOTTOM))
        point = fem.locate_dofs_topological(x, 0, vertex_near(mesh, WIDTH / 2, 0.0))
        bcs = [fem.dirichletbc(zero, bottom, y), fem.dirichletbc(zero, point, x)]
        if not axial_load:
            bcs.append(fem.dirichletbc(self.top, self.top_dofs, y))
        if rough:
            rough_dofs = fem.locate_dofs_topological(x, 1, tags.find(TOP))
            bcs.append(fem.dirichletbc(zero, rough_dofs, x))
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
        return self.law.evaluate(np.tile(np.eye(2), (self.points.size, 1, 1)))
