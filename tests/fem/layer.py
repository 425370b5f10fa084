"""A layer of height 1 sheared between rough plates, uniform along x."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.problem import Convergence, Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from femxdem_fenicsx.law import Law
from forms.second_gradient import SecondGradient
from meshes import box, rectangle


class Layer:
    """The upper plate is moved along x by `pulled`; `walls` at the sides keep the layer from more.

    Args:
        make_law: given the points.
        stiffness: A of the double stress, (d,) * 6, N.
        cells: along each axis.
        width: m.
        name: of the element.
        micro_strain: "linear" or "quadratic".
        bent: whether du_x/dy at the plates is free, else zero.
        double_force: at the upper plate, N/m, along x; None for none.
        tolerance: on FNORM/RNORM.
    """

    def __init__(
        self,
        make_law: Callable[[QuadraturePoints], Law],
        stiffness: np.ndarray,
        cells: tuple[int, ...],
        width: float = 0.5,
        *,
        name: str = "Q8",
        micro_strain: str = "linear",
        bent: bool = True,
        double_force: float | None = None,
        tolerance: float = 1e-10,
    ):
        kind = element(name)
        d, up = kind.dim, kind.dim - 1
        shape, size = (rectangle, (width, 1.0)) if d == 2 else (box, (width, width, 1.0))
        if d == 2:
            self.mesh = rectangle.rectangle(MPI.COMM_WORLD, *size, *cells, kind)
            tags, across = rectangle.sides(self.mesh, *size), [("LEFT", "RIGHT")]
        else:
            self.mesh = box.box(MPI.COMM_WORLD, size, cells, kind)
            tags, across = box.sides(self.mesh, size), [("LEFT", "RIGHT"), ("FRONT", "BACK")]
        self.area = width**up
        self.points = QuadraturePoints(self.mesh, kind)
        self.law = make_law(self.points)
        self.medium = medium = SecondGradient(self.points, "small", stiffness, micro_strain)
        operator = ExternalOperator(medium.F, self.law, self.points, 0.5, medium.states)
        double_forces = []
        if double_force is not None:
            ds = ufl.Measure("ds", domain=self.mesh, subdomain_data=tags)
            P = fem.Constant(self.mesh, (double_force, 0.0))
            double_forces = [(P, ds(shape.TOP))]
        residual, jacobian = medium.equilibrium(
            operator.stress, operator.tangent, double_forces=double_forces
        )
        self.pulled, zero = fem.Constant(self.mesh, 0.0), fem.Constant(self.mesh, 0.0)
        bcs = []

        def fix(space, side: int, value=zero) -> np.ndarray:
            dofs = fem.locate_dofs_topological(space, up, tags.find(side))
            bcs.append(fem.dirichletbc(value, dofs, space))
            return dofs

        for side in (shape.BOTTOM, shape.TOP):
            top = side == shape.TOP
            self.top = fix(medium.space.sub(0), side, self.pulled if top else zero)
            for component in range(1, d):
                fix(medium.space.sub(component), side)
            for component in range(d):
                bcs.extend(medium.straight(tags.find(side), up, component))
            if not bent:
                fix(medium.micro_space.sub(up), side)
        for normal, walls in enumerate(across):
            for side in (getattr(shape, wall) for wall in walls):
                for component in range(1, d):
                    fix(medium.space.sub(component), side)
                    bcs.extend(medium.straight(tags.find(side), normal, component))
        self.problem = Problem(
            medium.unknown, residual, jacobian, operator, bcs, Convergence(tolerance)
        )

    def shear(self, start: float, end: float) -> None:
        """Move the upper plate so that the mean of du_x/dy goes from start to end."""
        self.pulled.value = end - start

    def stress(self) -> float:
        """Shear stress, Pa."""
        return self.problem.reaction(self.top) / self.area
