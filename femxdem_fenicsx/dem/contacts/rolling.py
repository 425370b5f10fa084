"""Rolling resistance: a spring between the rotations of two grains, and a slider in it."""

from typing import NamedTuple


class RollingResistance(NamedTuple):
    """Elastic-plastic rolling resistance (Iwashita and Oda, J. Eng. Mech. 124 (1998) 285-292).

    The moment on grain j falls by k_r times the rotation of j against i, in 3D about the axes in
    the contact plane, up to eta r f_n; k_r = alpha k_t r^2, r = R_i R_j / (R_i + R_j) (model C of
    Ai et al., Powder Technology 206 (2011) 269-282, with this k_r and without its damping).
    """

    friction: float  # eta
    stiffness: float = 1.0  # alpha

    def rolling_stiffness(rolling, k_t, radius):
        """k_r, N m."""
        return rolling.stiffness * k_t * radius * radius

    def rolling_limit(rolling, normal, radius):
        """Largest moment, N m."""
        return rolling.friction * radius * normal
