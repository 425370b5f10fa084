"""The FEM x DEM law: packings behind the Law protocol (Desrues section 2.4.2)."""

from dataclasses import dataclass
from time import perf_counter

import h5py
import numpy as np

from .dem.accuracy import PRESETS, Accuracy
from .dem.homogenisation import fabric_anisotropy
from .dem.loading import Outcome
from .dem.packing import Packing, PackingBatch
from .dem.response import Response
from .dem.tangents import operator
from .law import InadmissibleDeformation

#: A packing with fewer contacts per grain than this carries no load: it has failed.
FAILED_CONTACTS_PER_GRAIN = 0.5
#: Stiffness that a failed packing lends the global matrix, as a share of the initial one.
FAILED_STIFFNESS = 1e-2
#: Strains are rounded to multiples of this before the grains see them. It is far below what they
#: can resolve, and far above the rounding of the linear solver, which would otherwise be amplified
#: by the grains until 1 and 2 ranks part (docs/accuracy.md).
STRAIN_QUANTUM = 2.0**-30


@dataclass
class Tally:
    """What the packings have done so far, summed over all evaluations of this rank.

    evaluations: of the batch. packings: evaluations of a packing. steps: of the DEM. unfinished:
    evaluations of a packing that ended at the hold limit. worst_unbalance: the largest left by any
    of them (Desrues eq. 19). worst_overlap: the largest of a contact over its grains' mean
    diameter. seconds: spent in evaluations. tangent_seconds: in tangents.
    """

    evaluations: int = 0
    packings: int = 0
    steps: int = 0
    unfinished: int = 0
    worst_unbalance: float = 0.0
    worst_overlap: float = 0.0
    seconds: float = 0.0
    tangent_seconds: float = 0.0

    def clear(self) -> None:
        """Start counting anew."""
        self.__init__()

    def add(self, outcome: Outcome, seconds: float) -> None:
        """Count one evaluation of the batch."""
        self.evaluations += 1
        self.packings += len(outcome.stress)
        self.steps += int((outcome.loading_steps + outcome.hold_steps).sum())
        self.unfinished += int((~outcome.at_rest).sum())
        self.worst_unbalance = max(self.worst_unbalance, float(outcome.unbalance.max(initial=0)))
        self.worst_overlap = max(self.worst_overlap, float(outcome.overlap.max(initial=0)))
        self.seconds += seconds


class HomogenisedLaw:
    """A periodic packing at every material point; stress by Desrues eq. 27.

    Attributes:
        dim: of the packings, 2 or 3. size: number of material points. tally: see `Tally`.
        response: the packings, committed and trial.
    """

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
        self.dim, self.size = packing.dim, size
        self._identity = np.eye(self.dim)
        self.tally = Tally()
        self._F = np.broadcast_to(self._identity, (size, self.dim, self.dim))
        self._initial_box = self.response.committed.box.copy()
        stiffest = np.abs(operator("UKO")(self.response, self._F)).max(initial=0.0)
        self._failed_stiffness = FAILED_STIFFNESS * max(stiffest, 1e-6 * packing.contact_modulus())
        self._grains = packing.size
        self._initial_void_ratio = packing.void_ratio

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        """Stress (n, d, d), Pa, at F (n, d, d) relative to the committed state.

        F - I is rounded to multiples of `STRAIN_QUANTUM`.

        Raises InadmissibleDeformation for an F that is no deformation or lets a packing collapse.
        """
        shape = (self.size, self.dim, self.dim)
        if np.shape(F) != shape:
            raise ValueError(f"F has shape {np.shape(F)}, expected {shape}")
        started = perf_counter()
        F = self._identity + np.round((F - self._identity) / STRAIN_QUANTUM) * STRAIN_QUANTUM
        try:
            outcome = self.response.deform(F)
        except (ValueError, FloatingPointError) as error:
            raise InadmissibleDeformation(str(error)) from None
        self._F = F
        self.tally.add(outcome, perf_counter() - started)
        return outcome.stress.copy()

    def tangent(self) -> np.ndarray:
        """C = d sigma / d F (n, d, d, d, d), Pa, at the last trial, by the law's operator.

        A failed packing gets a small isotropic stiffness, so that the global matrix is regular.
        """
        started = perf_counter()
        C = self._operator(self.response, self._F)
        identity = np.einsum("ik,jl->ijkl", self._identity, self._identity)
        C[self._failed(self.response.outcome)] += self._failed_stiffness * identity
        self.tally.tangent_seconds += perf_counter() - started
        return np.einsum("nijkl,nml->nijkm", C, np.linalg.inv(self._F))

    def commit(self) -> None:
        """The trial becomes the state."""
        self.response.commit()
        self._F = np.broadcast_to(self._identity, (self.size, self.dim, self.dim))

    def discard(self) -> None:
        """Forget the trial."""
        self.response.discard()
        self._F = np.broadcast_to(self._identity, (self.size, self.dim, self.dim))

    def save(self, group: h5py.Group) -> None:
        """Write the committed state, the whole of it, into an HDF5 group."""
        for name in PackingBatch.STATE:
            group[name] = getattr(self.response.committed, name)
        for name, value in self.response.committed_outcome._asdict().items():
            group[f"outcome/{name}"] = value
        group["initial_box"] = self._initial_box
        group.attrs["failed_stiffness"] = self._failed_stiffness

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
        self._failed_stiffness = float(group.attrs["failed_stiffness"])
        self.discard()

    @property
    def stress(self) -> np.ndarray:
        """Committed stress (n, d, d), Pa."""
        return self.response.committed_outcome.stress

    @property
    def deformation(self) -> np.ndarray:
        """Committed deformation gradient (n, d, d) since the beginning."""
        state = self.response.committed
        return state.box @ np.linalg.inv(state.turns) @ np.linalg.inv(self._initial_box)

    @property
    def deviatoric_strain(self) -> np.ndarray:
        """eps_q = sqrt(2 e : e) (n,), e the deviator of the logarithmic strain (GZ eq. 13)."""
        F = self.deformation
        principal = 0.5 * np.log(np.linalg.eigvalsh(F @ np.swapaxes(F, 1, 2)))
        deviator = principal - principal.mean(1, keepdims=True)
        return np.sqrt(2.0 * (deviator**2).sum(1))

    @property
    def void_ratio(self) -> np.ndarray:
        """(n,)."""
        return (1.0 + self._initial_void_ratio) * np.linalg.det(self.deformation) - 1.0

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
