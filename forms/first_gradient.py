"""Equilibrium of a first-gradient continuum, for one load step.

The unknown u is the displacement of the step, on the geometry at its start. The stress comes from
outside: `stress` (d, d) holds the Cauchy stress at the end of the step, Pa, tension positive, and
`tangent` (d*d, d*d) its derivative by the step's deformation gradient, C[d i + j, d k + l] =
d stress_ij / d F_kl. The other part of the derivative, which holds the stress and varies the
configuration, follows from the form itself.

Both formulations return the residual (internal minus external forces) and the Jacobian. Pressures
are pairs (p, ds): p in Pa, compression positive, on the facets of the measure ds.
"""

from __future__ import annotations

from collections.abc import Sequence

import ufl
from dolfinx import fem

from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints


def deformation_gradient(u):
    """F = I + grad u, from the start of the step to its end (Desrues eq. 1)."""
    return ufl.Identity(len(u)) + ufl.grad(u)


def small(u, stress, tangent, dx, pressures: Sequence = ()) -> tuple[ufl.Form, ufl.Form]:
    """Infinitesimal strain and rotation: equilibrium at the start's geometry (Guo-Zhao eq. 1, 4).

    The pressures act on the start's geometry along its normal.
    """
    space = u.function_space
    w, du = ufl.TestFunction(space), ufl.TrialFunction(space)
    residual = ufl.inner(stress, ufl.grad(w)) * dx
    residual += pressure_work(pressures, ufl.FacetNormal(space.mesh), w)
    jacobian = ufl.inner(stress_increment(tangent, du), ufl.grad(w)) * dx
    return residual, jacobian


def finite(u, stress, tangent, dx, pressures: Sequence = ()) -> tuple[ufl.Form, ufl.Form]:
    """Large strain (Desrues eq. 2): equilibrium at the end's geometry, pulled back to the start's.

    The pressures follow the surface: n da = J F^-T N dA (Nanson).
    """
    space = u.function_space
    w, du = ufl.TestFunction(space), ufl.TrialFunction(space)
    F = deformation_gradient(u)
    cofactor = ufl.det(F) * ufl.inv(F).T
    residual = ufl.inner(stress * cofactor, ufl.grad(w)) * dx
    residual += pressure_work(pressures, cofactor * ufl.FacetNormal(space.mesh), w)
    jacobian = ufl.derivative(residual, u, du)
    jacobian += ufl.inner(stress_increment(tangent, du) * cofactor, ufl.grad(w)) * dx
    return residual, jacobian


def pressure_work(pressures: Sequence, normal, w):
    """Virtual work of pressures, pairs (p, ds), against the area vector per area of ds."""
    return sum(pressure * ufl.inner(normal, w) * ds for pressure, ds in pressures)


def stress_increment(tangent, du):
    """C : dF for the quadrature function of a tangent, (d*d, d*d)."""
    d = len(du)
    dF = ufl.grad(du)
    return ufl.as_tensor(
        [
            [
                sum(tangent[d * i + j, d * k + m] * dF[k, m] for k in range(d) for m in range(d))
                for j in range(d)
            ]
            for i in range(d)
        ]
    )


FORMULATIONS = {"small": small, "finite": finite}


class FirstGradient:
    """A first-gradient continuum: what is solved for, and its equilibrium.

    Attributes:
        unknown: the step's displacement u, m.
        displacement: u, as a UFL expression.
        space: of displacements, to fix components of.
        F: deformation gradient of the step.
        states: what the form remembers: nothing.

    Args:
        points: of the mesh.
        formulation: one of `FORMULATIONS`.
    """

    states = ()

    def __init__(self, points: QuadraturePoints, formulation: str = "finite"):
        self._equilibrium, self._points = FORMULATIONS[formulation], points
        self.unknown = self.displacement = fem.Function(points.element.space(points.mesh))
        self.space = self.unknown.function_space
        self.F = deformation_gradient(self.displacement)

    def straight(self, side, normal: int, component: int) -> list:
        """Conditions on the gradient along a side with a uniform component: none here."""
        return []

    def equilibrium(self, stress, tangent, pressures: Sequence = ()) -> tuple[ufl.Form, ufl.Form]:
        """Residual and Jacobian; see the head of this module."""
        dx = self._points.element.dx(self._points.mesh)
        return self._equilibrium(self.unknown, stress, tangent, dx, pressures)
