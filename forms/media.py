"""The continuum by name: what solves, loads and writes does not know which one it is."""

from __future__ import annotations

from femxdem_fenicsx.double_stress import one_parameter
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints

from .first_gradient import FirstGradient
from .second_gradient import SecondGradient


def medium(
    points: QuadraturePoints,
    formulation: str = "finite",
    gradient: str = "first",
    modulus: float | None = None,
) -> FirstGradient | SecondGradient:
    """A continuum of first or second gradient on the mesh of `points`.

    Args:
        points: of the mesh.
        formulation: "small" or "finite".
        gradient: "first" or "second".
        modulus: D of the second gradient, N (Desrues eq. 44).

    Raises:
        ValueError: a modulus that is not positive, an element without a mixed space.
    """
    if gradient == "first":
        return FirstGradient(points, formulation)
    stiffness = one_parameter(modulus, points.mesh.geometry.dim)
    return SecondGradient(points, formulation, stiffness)
