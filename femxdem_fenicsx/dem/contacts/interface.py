"""What kernels ask a contact law for: functions that Numba takes from the law's own class.

A law reaches the kernels as a NamedTuple of its parameters, and its methods are compiled into them,
so that a kernel knows no law, and a law no kernel. Called from Python they are the methods.
"""

import math

from numba.core import types
from numba.extending import overload

from ..aliasing import kernel


def asked_of_the_law(function):
    """The function, which calls the method of that name of its first argument."""

    @overload(function, strict=False)
    def compiled(law, *arguments):
        if isinstance(law, types.BaseNamedTuple):
            return getattr(law.instance_class, function.__name__)

    return function


@asked_of_the_law
def coefficient(law, radius_i, radius_j):
    """What the law computes once per pair from its radii; for the linear law k_n."""
    return law.coefficient(radius_i, radius_j)


@asked_of_the_law
def normal_force(law, coefficient, overlap):
    """Elastic force (N) at an overlap (m) that is zero or more."""
    return law.normal_force(coefficient, overlap)


@asked_of_the_law
def stiffnesses(law, coefficient, overlap):
    """(k_n, k_t) = (df_n / du_n, df_t / du_t), N/m, at an overlap (m) that is zero or more."""
    return law.stiffnesses(coefficient, overlap)


@asked_of_the_law
def holds(bonds, normal, tangential, limit):
    """Whether a bond bears a normal (compression positive) and a tangential force, N."""
    return bonds.holds(normal, tangential, limit)


@asked_of_the_law
def rolling_stiffness(rolling, k_t, radius):
    """k_r, N m, for r = R_i R_j / (R_i + R_j)."""
    return rolling.rolling_stiffness(k_t, radius)


@asked_of_the_law
def rolling_limit(rolling, normal, radius):
    """Largest rolling moment (N m) under a compressive force (N)."""
    return rolling.rolling_limit(normal, radius)


def kept_share(law, coefficient, strained, before):
    """Share of the tangential force that a contact keeps as its overlap changes.

    Where it softens, k_t falls and the force with it: f_t k_t / k_t before; where it stiffens the
    force stays. The spring's energy f_t^2 / (2 k_t) then never grows unless slip does work on it,
    whereas f_t kept in unloading creates energy (Elata and Berryman, Mechanics of Materials 24
    (1996) 229-240; Thornton et al., Powder Technology 233 (2013) 30-46). A law that does not
    stiffen has no trace of this in its kernels.
    """
    _, k_t = stiffnesses(law, coefficient, abs(strained))
    _, k_t_before = stiffnesses(law, coefficient, abs(before))
    return k_t / max(k_t, k_t_before, 1e-300)


@overload(kept_share, strict=False)
def _compiled_kept_share(law, coefficient, strained, before):
    if getattr(law.instance_class, "stiffens", True):
        return kept_share
    return lambda law, coefficient, strained, before: 1.0


@kernel
def strained_overlap(bonds, bond, overlap):
    """Overlap that strains a contact, m: no gap does, but for that of an intact bond (< 0)."""
    if bonds is None:
        return max(overlap, 0.0)
    return overlap if overlap > 0.0 or bond > 0.0 else 0.0


@kernel
def elastic_force(law, bonds, coefficient, strained):
    """Elastic normal force of a strained contact, N, compression positive."""
    if bonds is None:
        return normal_force(law, coefficient, strained)
    return math.copysign(normal_force(law, coefficient, abs(strained)), strained)


@kernel
def attraction(cohesion, overlap):
    """Constant force of cohesion, N, between grains that touch (f_c of p*, Desrues 6.1)."""
    return cohesion if overlap > 0.0 else 0.0
