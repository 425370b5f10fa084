"""The continuum by name: what solves, loads and writes does not know which one it is."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from femxdem_fenicsx.double_stress import one_parameter
from femxdem_fenicsx.fem.quadrature_points import QuadraturePoints

from .first_gradient import FirstGradient

if TYPE_CHECKING:
    from .second_gradient import SecondGradient


def medium_for(
    args: argparse.Namespace, points: QuadraturePoints
) -> FirstGradient | SecondGradient:
    """The continuum that --gradient, --second-gradient-modulus, ... and --formulation ask for.

    Raises ValueError for a modulus that is not positive and an element without a mixed space.
    """
    if args.gradient == "first":
        return FirstGradient(points, args.formulation)
    from .second_gradient import SecondGradient  # a first-gradient run does not even load it

    stiffness = one_parameter(args.second_gradient_modulus, points.mesh.geometry.dim)
    return SecondGradient(points, args.formulation, stiffness, args.micro_strain or "linear")
