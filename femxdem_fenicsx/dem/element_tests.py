"""One material point on its own: strain prescribed in some components, stress in the others.

Works with anything that evaluates, commits and discards like a law (see `femxdem_fenicsx.law`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ElementState:
    """State after an increment.

    deformation (d, d) since the beginning; stress (d, d) Pa, tension positive; evaluations of the
    law in this increment; error: largest stress component off its target, Pa.
    """

    deformation: np.ndarray
    stress: np.ndarray
    evaluations: int
    error: float

    @property
    def axial_strain(self) -> float:
        """Engineering strain along the last axis, compression positive."""
        return 1.0 - float(self.deformation[-1, -1])

    @property
    def volumetric_strain(self) -> float:
        """det F - 1, dilation positive."""
        return float(np.linalg.det(self.deformation)) - 1.0

    @property
    def stress_ratio(self) -> float:
        """Axial over lateral stress."""
        return float(self.stress[-1, -1] / self.stress[0, 0])


def increment(
    law, F: np.ndarray, controlled: np.ndarray, target: np.ndarray, tolerance: float, most: int = 40
) -> tuple[np.ndarray, ElementState]:
    """One increment of law number 0 under mixed control; committed.

    Args:
        law: of size 1.
        F: (d, d) relative to the state; the first guess in the controlled components.
        controlled: (d, d) bool, where stress is prescribed and F free.
        target: (d, d) Pa, the stress there.
        tolerance: on the stress, Pa.
        most: evaluations at most.

    Returns the F found and the state (whose deformation is that of this increment).
    Raises RuntimeError where the stress is not reached; nothing is committed then.
    """
    F = np.array(F, dtype=np.float64)
    best, jacobian, before = None, None, None
    for evaluation in range(1, most + 1):
        stress = law.evaluate(F[None])[0]
        residual = stress[controlled] - target[controlled]
        error = float(np.abs(residual).max(initial=0.0))
        if error <= tolerance:
            law.commit()
            return F, ElementState(F, stress, evaluation, error)
        if jacobian is None:
            jacobian = law.tangent()[0][controlled][:, controlled]
        else:  # Broyden's rank-one update
            move = F[controlled] - before[0]
            jacobian = jacobian + np.outer(
                residual - before[1] - jacobian @ move, move / (move @ move)
            )
        best = min(error, best if best is not None else error)
        before = F[controlled], residual
        try:
            F[controlled] -= np.linalg.solve(jacobian, residual)
        except np.linalg.LinAlgError:  # the stress does not answer
            break
    law.discard()
    raise RuntimeError(
        f"element test: stress off by {best:.3g} Pa after {evaluation} evaluations, tolerance"
        f" {tolerance:.3g} Pa"
    )


def drained_compression(
    law,
    confining: float,
    strain: float,
    step: float = 1e-3,
    free_shear: bool = False,
    tolerance: float = 1e-3,
) -> Iterator[ElementState]:
    """Axial compression along the last axis under constant lateral pressure; state by state.

    In 2D that is a biaxial test, in 3D a triaxial one.

    Args:
        law: of size 1, two- or three-dimensional.
        confining: lateral pressure, Pa, compression positive.
        strain: engineering axial strain to reach, compression positive.
        step: of it per increment.
        free_shear: whether the box may shear sideways so that the shear stress vanishes, as a
            specimen between smooth plates may, or is kept rectangular.
        tolerance: of the prescribed stress, over the confining pressure.
    """
    d = law.dim
    controlled = np.diag(np.arange(d) < d - 1) | np.triu(np.full((d, d), free_shear), 1)
    target = -confining * np.eye(d)
    deformation = np.eye(d)
    guess = np.eye(d)
    for _ in range(round(strain / step)):
        height = deformation[-1, -1]
        guess[-1, -1] = (height - step) / height
        F, state = increment(law, guess, controlled, target, tolerance * confining)
        deformation = F @ deformation
        guess = F
        yield ElementState(deformation, state.stress, state.evaluations, state.error)


drained_biaxial = drained_compression
