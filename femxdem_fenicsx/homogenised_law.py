"""The FEM x DEM law: packings behind the Law protocol (Desrues section 2.4.2)."""

from dataclasses import replace
from time import perf_counter

import h5py
import numpy as np

from .dem.accuracy import PRESETS, Accuracy
from .dem.homogenisation import fabric_anisotropy
from .dem.loading import FAILED_CONTACTS_PER_GRAIN, Outcome
from .dem.packing import Packing, PackingBatch
from .dem.reproducible import determinant, inverse, product
from .dem.response import Response
from .dem.strength import deviatoric_strain
from .dem.tangents import operator
from .law import InadmissibleDeformation

#: Stiffness that a failed packing lends the global matrix, as a share of the initial one.
FAILED_STIFFNESS = 1e-2
#: What is zero in the state of a program that did not know it.
NOT_IN_THE_FIRST_FORMAT = ("outcome/inertial_number", "outcome/vibration")

#: What a `Tally` knows of each packing.
COUNTS = np.dtype(
    [
        ("evaluations", np.int64),
        ("steps", np.int64),
        ("unfinished", np.int64),
        ("unbalance", np.float64),
        ("overlap", np.float64),
        ("inertial_number", np.float64),
    ]
)


#: In names of what rejected and pending tries have changed, and a resumed run must not know of.
WITH_TRIALS = "_with_trials"


def _copies(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    return {name: array.copy() for name, array in arrays.items()}


class Tally:
    """What the packings of this rank have done so far, in all their evaluations.

    Attributes:
        by_packing: (n,) `COUNTS`: evaluations; steps of the DEM; evaluations that ended at the
            hold limit; the largest unbalance left by any (Desrues eq. 19); the largest overlap of
            a contact over its grains' mean diameter; the largest inertial number reached. It moves
            with the packings.
        evaluations: of the batch. seconds: spent in them. tangent_seconds: in tangents.
    """

    def __init__(self, size: int):
        self.by_packing = np.zeros(size, COUNTS)
        self.clear()

    def clear(self) -> None:
        """Start counting anew."""
        self.by_packing[:] = 0
        self.evaluations, self.seconds, self.tangent_seconds = 0, 0.0, 0.0

    def add(self, outcome: Outcome, seconds: float) -> None:
        """Count one evaluation of the batch."""
        counts = self.by_packing
        counts["evaluations"] += 1
        counts["steps"] += outcome.loading_steps + outcome.hold_steps
        counts["unfinished"] += ~outcome.at_rest
        for name in ("unbalance", "overlap", "inertial_number"):
            np.maximum(counts[name], getattr(outcome, name), out=counts[name])
        self.evaluations += 1
        self.seconds += seconds

    @property
    def packings(self) -> int:
        """Evaluations of a packing."""
        return int(self.by_packing["evaluations"].sum())

    @property
    def steps(self) -> int:
        """Of the DEM, summed over the packings."""
        return int(self.by_packing["steps"].sum())

    @property
    def unfinished(self) -> int:
        """Evaluations of a packing that ended at the hold limit."""
        return int(self.by_packing["unfinished"].sum())

    @property
    def worst_unbalance(self) -> float:
        """The largest left by any evaluation of any packing."""
        return float(self.by_packing["unbalance"].max(initial=0.0))

    @property
    def worst_overlap(self) -> float:
        """The largest of any contact in any evaluation."""
        return float(self.by_packing["overlap"].max(initial=0.0))

    @property
    def largest_inertial_number(self) -> float:
        """That any packing reached in any evaluation; more than asked for where pressure fell."""
        return float(self.by_packing["inertial_number"].max(initial=0.0))


class HomogenisedLaw:
    """A periodic packing at every material point; stress by Desrues eq. 27.

    Attributes:
        dim: of the packings, 2 or 3. size: number of material points. tally: see `Tally`.
        response: the packings, committed and trial.
        FIELDS: the attributes that have a value for each point.
    """

    FIELDS = (
        "stress", "deformation", "deviatoric_strain", "void_ratio", "coordination_number",
        "fabric_anisotropy", "failed",
    )  # fmt: skip

    def __init__(
        self,
        packing: Packing,
        size: int,
        accuracy: Accuracy = PRESETS["balanced"],
        operator_name: str = "UKO",
        threads: int = 1,
        friction: np.ndarray | None = None,
    ):
        """The same packing at all `size` points; ValueError for what is not possible.

        `friction`: coefficient of the contacts of each point (size,); the contact law's if None.
        """
        self._operator = operator(operator_name)
        self._memory = getattr(self._operator, "memory", {})
        if hasattr(self._operator, "start"):
            self._operator.start(size, packing.dim)
        self.response = Response(packing, size, accuracy, threads, friction)
        self.dim, self.size = packing.dim, size
        self._identity = np.eye(self.dim)
        self.tally = Tally(size)
        self._committed_tally = self.tally.by_packing.copy()
        self._committed_memory = _copies(self._memory)
        self._F = np.broadcast_to(self._identity, (size, self.dim, self.dim))
        self._initial_box = self.response.committed.box.copy()
        one = Response(packing, 1, accuracy)  # a rank may have no packing at first
        stiffest = np.abs(operator("UKO")(one, self._identity[None])).max()
        self._failed_stiffness = FAILED_STIFFNESS * max(stiffest, 1e-6 * packing.contact_modulus())
        self._grains = packing.size
        self._initial_void_ratio = packing.void_ratio

    def evaluate(self, F: np.ndarray) -> np.ndarray:
        """Stress (n, d, d), Pa, at F (n, d, d) relative to the committed state.

        F - I is rounded to multiples of `Response.strain_quantum`.

        Raises InadmissibleDeformation for an F that is no deformation or lets a packing collapse.
        """
        shape = (self.size, self.dim, self.dim)
        if np.shape(F) != shape:
            raise ValueError(f"F has shape {np.shape(F)}, expected {shape}")
        started = perf_counter()
        F = self.response.rounded(F)
        try:
            outcome = self.response.deform(F)
        except (ValueError, FloatingPointError) as error:
            raise InadmissibleDeformation(str(error)) from None
        self._F = F
        self.tally.add(outcome, perf_counter() - started)
        return outcome.stress.copy()

    def expected_cost(self, F: np.ndarray) -> np.ndarray:
        """Steps of the DEM that each packing will take at F, (n,); only the hold's are a guess.

        Raises InadmissibleDeformation for an F that is no deformation.
        """
        try:
            return self.response.expected_steps(self.response.rounded(F))
        except ValueError as error:
            raise InadmissibleDeformation(str(error)) from None

    def tangent(self) -> np.ndarray:
        """C = d sigma / d F (n, d, d, d, d), Pa, at the last trial, by the law's operator.

        A failed packing gets a small isotropic stiffness, so that the global matrix is regular.
        """
        started = perf_counter()
        C = self._operator(self.response, self._F)
        identity = np.einsum("ik,jl->ijkl", self._identity, self._identity)
        C[self._failed(self.response.outcome)] += self._failed_stiffness * identity
        self.tally.tangent_seconds += perf_counter() - started
        return np.einsum("nijkl,nml->nijkm", C, inverse(self._F))

    def commit(self) -> None:
        """The trial becomes the state."""
        self.response.commit()
        self._committed_tally = self.tally.by_packing.copy()
        self._committed_memory = _copies(self._memory)
        self._F = np.broadcast_to(self._identity, (self.size, self.dim, self.dim))

    def discard(self) -> None:
        """Forget the trial."""
        self.response.discard()
        self._F = np.broadcast_to(self._identity, (self.size, self.dim, self.dim))

    def state(self) -> dict[str, np.ndarray]:
        """The committed state, the whole of it: arrays with one row per packing."""
        self.response.committed.clear_unused()
        return self._arrays()

    def _arrays(self) -> dict[str, np.ndarray]:
        response = self.response
        arrays = {name: getattr(response.committed, name) for name in PackingBatch.STATE}
        arrays = {name: array for name, array in arrays.items() if array is not None}
        for name, array in response.committed_outcome._asdict().items():
            arrays[f"outcome/{name}"] = array
        for name, array in self._memory.items():
            arrays[f"operator/{name}"] = self._committed_memory[name]
            arrays[f"operator{WITH_TRIALS}/{name}"] = array
        if response.friction is not None:
            arrays["friction"] = response.friction
        return arrays | {
            "initial_box": self._initial_box,
            "held": response.held,
            "tally": self._committed_tally,
            f"tally{WITH_TRIALS}": self.tally.by_packing,
        }

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Take over what `state` gave, here or elsewhere, of any number of packings.

        The arrays are this law's from then on.

        Raises ValueError, and changes nothing, for arrays other than this law's.
        """
        own = self._arrays()
        missing = sorted(own.keys() ^ state.keys())
        if missing:
            raise ValueError(f"a state of another law: not in both are {', '.join(missing)}")
        size = len(state["box"])
        for name, array in own.items():
            shape = (size, *array.shape[1:])
            if state[name].shape != shape:
                raise ValueError(f"{name} has shape {state[name].shape}, this law has {shape}")
        state = {name: np.asarray(array, own[name].dtype) for name, array in state.items()}
        self._initial_box = state.pop("initial_box")
        self._committed_tally = state.pop("tally")
        self.tally.by_packing = state.pop(f"tally{WITH_TRIALS}")
        self.response.friction = state.pop("friction", None)
        outcome = {name: state.pop(f"outcome/{name}") for name in Outcome._fields}
        for name in self._memory:
            self._committed_memory[name] = state.pop(f"operator/{name}")
            self._memory[name] = state.pop(f"operator{WITH_TRIALS}/{name}")
        self.size = size
        self.response.restore(state, Outcome(**outcome), state.pop("held"))
        self._F = np.broadcast_to(self._identity, (size, self.dim, self.dim))

    def save(self, group: h5py.Group) -> None:
        """Write the committed state into an HDF5 group, one row per packing."""
        for name, array in self.state().items():
            if WITH_TRIALS not in name:  # a resumed run tries again
                group[name] = array

    def load(self, group: h5py.Group) -> None:
        """Read back, bit for bit, what `save` wrote; ValueError for a state of another shape."""
        if len(group["box"]) != self.size:
            shape, own = group["box"].shape, (self.size, self.dim, self.dim)
            raise ValueError(f"{group.file.filename}: box has shape {shape}, this law has {own}")
        state = {}
        group.visititems(
            lambda name, item: (
                state.update({name: item[()]}) if isinstance(item, h5py.Dataset) else None
            )
        )
        tally = np.zeros(self.size, COUNTS)
        for name in state["tally"].dtype.names:
            tally[name] = state["tally"][name]
        state["tally"] = tally
        for name in NOT_IN_THE_FIRST_FORMAT:
            state.setdefault(name, np.zeros(self.size))
        if state.pop("cost", None) is not None:  # of the first format
            state["held"] = state["outcome/hold_steps"].copy()
        memory = {name: state.get(f"operator/{name}") for name in self._memory}
        state = {name: array for name, array in state.items() if not name.startswith("operator/")}
        for name, array in memory.items():
            if array is None:  # another operator was at work
                array = np.zeros_like(self._memory[name])
            state[f"operator/{name}"] = array
            state[f"operator{WITH_TRIALS}/{name}"] = array.copy()
        self.restore(state | {f"tally{WITH_TRIALS}": tally.copy()})

    @property
    def threads(self) -> int:
        """Threads that share the packings."""
        return self.response.threads

    @property
    def stress(self) -> np.ndarray:
        """Committed stress (n, d, d), Pa."""
        return self.response.committed_outcome.stress

    @property
    def deformation(self) -> np.ndarray:
        """Committed deformation gradient (n, d, d) since the beginning."""
        state = self.response.committed
        box = product(state.box, inverse(state.turns).round())
        return product(box, inverse(self._initial_box))

    @property
    def deviatoric_strain(self) -> np.ndarray:
        """eps_q = sqrt(2 e : e) (n,), e the deviator of the logarithmic strain (GZ eq. 13)."""
        return deviatoric_strain(self.deformation)

    @property
    def void_ratio(self) -> np.ndarray:
        """(n,)."""
        return (1.0 + self._initial_void_ratio) * determinant(self.deformation) - 1.0

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

    def packing(self, point: int | None) -> Packing | None:
        """The committed packing of one point; None of none."""
        if point is None:
            return None
        packing, friction = self.response.committed.packing(point), self.response.friction
        if friction is None:
            return packing
        return replace(packing, law=replace(packing.law, friction=float(friction[point])))
