"""Response envelopes: what one state answers to small probes in all directions (Gudehus 1979).

The probes lie in the plane of lateral and axial components, in 3D the Rendulic plane: there both
lateral components are equal, and count by sqrt(2). Compression is positive.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .mixed_control import Servo, StressCondition

#: Angle (rad) that a packing turns by to be held without any strain.
TURN = 2.0**-30


@dataclass(frozen=True)
class Envelope:
    """Probes and answers, n of them.

    strain (n, 2): lateral (times sqrt(2) in 3D) and axial, compression positive. stress (n, 2) Pa,
    the same of the stress increments.
    """

    strain: np.ndarray
    stress: np.ndarray

    @property
    def stiffness(self) -> np.ndarray:
        """(n,) size of the stress increment over that of the strain increment, Pa."""
        return np.linalg.norm(self.stress, axis=1) / np.linalg.norm(self.strain, axis=1)


def directions(number: int) -> np.ndarray:
    """(number, 2) unit vectors, all round."""
    if number < 3:
        raise ValueError(f"probes: an envelope needs 3 directions or more, got {number}")
    angle = 2 * np.pi * np.arange(number) / number
    return np.column_stack([np.cos(angle), np.sin(angle)])


def strain_probes(law, size: float) -> Envelope:
    """Stress answers to strain increments of one size.

    Args:
        law: with one material point per probe, all in the same state; it ends there too.
        size: of the strain increments.

    Raises ValueError for a size that is not positive and fewer than 3 points.
    """
    if not size > 0:
        raise ValueError(f"probes: their size must be positive, got {size}")
    strain = size * directions(law.size)
    identity = np.broadcast_to(np.eye(law.dim), (law.size, law.dim, law.dim))
    turn = np.zeros((law.dim, law.dim))  # by next to nothing: F = I itself is given no hold
    turn[0, 1], turn[1, 0] = -TURN, TURN
    before = law.evaluate(identity + turn)
    after = law.evaluate(identity - tensor(strain, law.dim))
    law.discard()
    return Envelope(strain, plane(before - after))


def stress_probes(
    law: Callable[[], object], size: float, number: int, tolerance: float
) -> Envelope:
    """Strain answers to stress increments of one size.

    Args:
        law: makes a law of size 1 in the state to be probed.
        size: of the stress increments, Pa.
        number: of probes.
        tolerance: on the stress, Pa.

    Raises ValueError as above, and NotReached where a stress cannot be reached.
    """
    if not size > 0:
        raise ValueError(f"probes: their size must be positive, got {size}")
    stress = size * directions(number)
    answers = []
    for probe in stress:
        servo = Servo(law(), tolerance, most=40)
        dim, before = servo.law.dim, servo.stress
        target = before - tensor(probe[None], dim)[0]
        servo.to(np.eye(dim), StressCondition.components(np.eye(dim, dtype=bool), target))
        answers.append((np.eye(dim) - servo.deformation, before - servo.stress))
    strain, reached = (np.array(x) for x in zip(*answers, strict=True))
    return Envelope(plane(strain), plane(reached))


def tensor(plane: np.ndarray, dim: int) -> np.ndarray:
    """(n, d, d) from lateral and axial components (n, 2)."""
    lateral = plane[:, :1] / np.sqrt(dim - 1)
    values = np.concatenate([np.repeat(lateral, dim - 1, 1), plane[:, 1:]], 1)
    return values[:, :, None] * np.eye(dim)


def plane(tensor: np.ndarray) -> np.ndarray:
    """Lateral and axial components (n, 2) of tensors (n, d, d)."""
    dim = tensor.shape[-1]
    diagonal = np.diagonal(tensor, axis1=1, axis2=2)
    lateral = diagonal[:, :-1].sum(1) / np.sqrt(dim - 1)
    return np.column_stack([lateral, diagonal[:, -1]])
