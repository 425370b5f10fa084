"""The FEM x DEM law: packings behind the Law protocol (Desrues section 2.4.2)."""

from dataclasses import dataclass

import h5py
import numpy as np

from .dem.accuracy import PRESETS, Accuracy
from .dem.homogenisation import fabric_anisotropy
from .dem.loading import Outcome
from .dem.packing import Packing, PackingBatch
from .dem.response import Response
from .dem.tangents import operator

#: A packing with fewer contacts per grain than this carries no load: it has failed.
FAILED_CONTACTS_PER_GRAIN = 0.5
#: Stiffness that a failed packing lends the global matrix, as a share of the initial one.
FAILED_STIFFNESS = 1e-2


@dataclass
class Tally:
    """What the packings have done so far, summed over all evaluations of this rank.

    evaluations of the batch; steps of the DEM; unfinished: evaluations of a packing that ended at
    the hold limit; worst_unbalance: the largest left by any of them (Desrues eq. 19).
    """

    evaluations: int = 0
    steps: int = 0
    unfinished: int = 0
    worst_unbalance: float = 0.0


class HomogenisedLaw:
    """A periodic packing at every material point; stress by Desrues eq. 27.

    Attributes:
        dim: 2. size: number of material points. tally: see `Tally`.
        response: the packings, committed and trial.
    """

    dim = 2

    def __init__(
        self,
        packing: Packing,
        size: int,
        accuracy: Accuracy = PRESETS["balanced"],
        operator_name: str = "UKO",
        threads: int = 1,
    ):
        """The same packing at all `size` points; ValueError for what is not possible."""
        self._operator = operator(operator_name)
        self.response = Response(packing, size, accuracy, threads)
        self.size = size
        self.tally = Tally()
        self._F = np.broadcast_to(np.eye(2), (size, 2, 2))
        self._initial_box = self.response.committed.box.copy()
        self._initial_stiffness = 0.0
        self._grains = packing.size
        self._area_of_grains = float(np.pi * (packing.radii**2).sum())

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        """Stress (n, 2, 2), Pa, at F (n, 2, 2) relative to the committed state.

        Raises ValueError for an F that is no deformation, FloatingPointError for a packing that
        has collapsed.
        """
        if np.shape(F) != (self.size, 2, 2):
            raise ValueError(f"F has shape {np.shape(F)}, expected {(self.size, 2, 2)}")
        outcome = self.response.deform(F)
        if not np.isfinite(outcome.stress).all():
            bad = int(np.flatnonzero(~np.isfinite(outcome.stress).all((1, 2)))[0])
            raise FloatingPointError(
                f"packing {bad}: its stress is not finite; use a smaller time step"
            )
        self._F = np.array(F)
        self.tally.evaluations += 1
        self.tally.steps += int((outcome.loading_steps + outcome.hold_steps).sum())
        self.tally.unfinished += int((~outcome.at_rest).sum())
        self.tally.worst_unbalance = max(
            self.tally.worst_unbalance, float(outcome.unbalance.max(initial=0.0))
        )
        return outcome.stress.copy()

    def tangent(self) -> np.ndarray:
        """C = d sigma / d F (n, 2, 2, 2, 2), Pa, at the last trial, by the law's operator.

        A failed packing gets a small isotropic stiffness, so that the global matrix is regular.
        """
        C = self._operator(self.response, self._F)
        if self._initial_stiffness == 0.0:
            self._initial_stiffness = float(np.abs(C).max(initial=0.0))
        identity = np.einsum("ik,jl->ijkl", np.eye(2), np.eye(2))
        C[self._failed(self.response.outcome)] += (
            FAILED_STIFFNESS * self._initial_stiffness * identity
        )
        return np.einsum("nijkl,nml->nijkm", C, np.linalg.inv(self._F))

    def commit(self) -> None:
        """The trial becomes the state."""
        self.response.commit()
        self._F = np.broadcast_to(np.eye(2), (self.size, 2, 2))

    def discard(self) -> None:
        """Forget the trial."""
        self.response.discard()
        self._F = np.broadcast_to(np.eye(2), (self.size, 2, 2))

    def save(self, group: h5py.Group) -> None:
        """Write the committed state, the whole of it, into an HDF5 group."""
        for name in PackingBatch.STATE:
            group[name] = getattr(self.response.committed, name)
        for name, value in self.response.committed_outcome._asdict().items():
            group[f"outcome/{name}"] = value
        group["initial_box"] = self._initial_box
        group.attrs["initial_stiffness"] = self._initial_stiffness

    def load(self, group: h5py.Group) -> None:
        """Read back, bit for bit, what `save` wrote; ValueError for a state of another shape."""
        response = self.response
        for name in PackingBatch.STATE:
            target = getattr(response.committed, name)
            if group[name].shape != target.shape:
                raise ValueError(
                    f"{group.file.filename}: {name} has shape {group[name].shape}, this law has"
                    f" {target.shape}"
                )
        for name in PackingBatch.STATE:
            getattr(response.committed, name)[:] = group[name][()]
        for name, value in response.committed_outcome._asdict().items():
            value[:] = group[f"outcome/{name}"][()]
        self._initial_box[:] = group["initial_box"][()]
        self._initial_stiffness = float(group.attrs["initial_stiffness"])
        self.discard()

    @property
    def stress(self) -> np.ndarray:
        """Committed stress (n, 2, 2), Pa."""
        return self.response.committed_outcome.stress

    @property
    def deformation(self) -> np.ndarray:
        """Committed deformation gradient (n, 2, 2) since the beginning."""
        return self.response.committed.box @ np.linalg.inv(self._initial_box)

    @property
    def deviatoric_strain(self) -> np.ndarray:
        """eps_q = sqrt(2 e : e) (n,), e the deviator of the logarithmic strain (GZ eq. 13)."""
        F = self.deformation
        principal = 0.5 * np.log(np.linalg.eigvalsh(F @ np.swapaxes(F, 1, 2)))
        return np.abs(principal[:, 1] - principal[:, 0])

    @property
    def void_ratio(self) -> np.ndarray:
        """(n,)."""
        return np.linalg.det(self.response.committed.box) / self._area_of_grains - 1.0

    @property
    def coordination_number(self) -> np.ndarray:
        """2 C / N (n,)."""
        return 2.0 * self.response.committed_outcome.contacts / self._grains

    @property
    def fabric_anisotropy(self) -> np.ndarray:
        """F_a (n,), Guo-Zhao eq. 25; 0 for a packing without contacts."""
        return fabric_anisotropy(self.response.committed_outcome.fabric)

    @property
    def failed(self) -> np.ndarray:
        """(n,) bool: the packing carries no load any more (Guo-Zhao section 4.2)."""
        return self._failed(self.response.committed_outcome)

    def _failed(self, outcome: Outcome) -> np.ndarray:
        return outcome.contacts < FAILED_CONTACTS_PER_GRAIN * self._grains

    def packing(self, point: int) -> Packing:
        """The committed packing of one point."""
        return self.response.committed.packing(point)
