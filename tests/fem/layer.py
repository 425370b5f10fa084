"""A layer sheared between rough plates, without a gradient of rotation at them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from dolfinx import fem
from mpi4py import MPI

from femxdem_fenicsx.double_stress import one_parameter
from femxdem_fenicsx.fem.elements import element
from femxdem_fenicsx.fem.external_operator import ExternalOperator
from femxdem_fenicsx.fem.problem import Convergence, Problem
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints
from femxdem_fenicsx.law import Law
from forms.second_gradient import SecondGradient
from meshes import rectangle


class Layer:
    """Three columns of Q8, as high as it is told, uniform along x; the upper plate is moved along x.

    Args:
        make_law: given the points.
        modulus: D, N.
        height: m.
        rows: of elements.
        tolerance: on FNORM/RNORM.
    """

    def __init__(
        self,
        make_law: Callable[[QuadraturePoints], Law],
        modulus: float,
        height: float,
        rows: int,
        tolerance: float = 1e-8,
    ):
        kind, width = element("Q8"), 3 * height / rows
        mesh = rectangle.rectangle(MPI.COMM_WORLD, width, height, 3, rows, kind)
        tags = rectangle.sides(mesh, width, height)
        self.height, self.width = height, width
        self.points = QuadraturePoints(mesh, kind)
        self.law = make_law(self.points)
        self.medium = SecondGradient(self.points, "small", one_parameter(modulus))
        operator = ExternalOperator(self.medium.F, self.law, self.points, 0.5, self.medium.states)
        residual, jacobian = self.medium.equilibrium(operator.stress, operator.tangent)
        self.pulled, zero = fem.Constant(mesh, 0.0), fem.Constant(mesh, 0.0)
        bcs = []

        def fix(component: int, side: np.ndarray, value=zero) -> np.ndarray:
            space = self.medium.space.sub(component)
            dofs = fem.locate_dofs_topological(space, 1, side)
            bcs.append(fem.dirichletbc(value, dofs, space))
            return dofs

        for side in (rectangle.LEFT, rectangle.RIGHT):
            fix(1, tags.find(side))
            bcs += self.medium.straight(tags.find(side), 0, 1)
        for side in (rectangle.BOTTOM, rectangle.TOP):
            fix(1, tags.find(side))
            self.top = fix(0, tags.find(side), self.pulled if side == rectangle.TOP else zero)
            for component in (0, 1):
                bcs += self.medium.straight(tags.find(side), 1, component)
        self.problem = Problem(
            self.medium.unknown, residual, jacobian, operator, bcs, Convergence(tolerance)
        )

    def shear(self, start: float, end: float) -> None:
        """Move the upper plate so that the mean shear strain du_x/dy goes from start to end."""
        self.pulled.value = (end - start) * self.height

    def stress(self) -> float:
        """Shear stress, Pa."""
        return self.problem.reaction(self.top) / self.width
