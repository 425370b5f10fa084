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
    normal = ufl.FacetNormal(u.function_space.mesh)
    for pressure, ds in pressures:
        residual += pressure * ufl.inner(normal, w) * ds
    jacobian = ufl.inner(_increment(tangent, du), ufl.grad(w)) * dx
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
    normal = ufl.FacetNormal(u.function_space.mesh)
    for pressure, ds in pressures:
        residual += pressure * ufl.inner(cofactor * normal, w) * ds
    jacobian = ufl.derivative(residual, u, du)
    jacobian += ufl.inner(_increment(tangent, du) * cofactor, ufl.grad(w)) * dx
    return residual, jacobian


def _increment(tangent, du):
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
