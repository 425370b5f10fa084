"""From F_i to F_f: a packing is deformed at a quasi-static rate, then held until it is at rest."""

import math
from typing import NamedTuple

import numpy as np

from . import dynamics
from .accuracy import Accuracy
from .aliasing import kernel, next_ticket
from .dynamics import NO_ROOM, OK
from .homogenisation import measure
from .neighbours import remember
from .packing import Packing
from .small import product
from .stability import stable_time_step

#: Steps of a hold between two looks at its criterion.
HOLD_BLOCK = 25
#: A hold counts for the stress from this many times the tolerance down.
NEARLY_AT_REST = 4.0
#: A packing with fewer contacts per grain than this carries no load: it has failed.
FAILED_CONTACTS_PER_GRAIN = 0.5
#: Fewest loading steps of an increment that is not zero.
FEWEST_STEPS = 4


class Loading(NamedTuple):
    """Settings of `deform`, as the kernel takes them."""

    inertial_number: float
    tolerance: float
    hold_limit: int
    time_step: float  # s, for the packing as it was prepared
    damping: float
    hold_damping: float
    mean_diameter: float  # m
    density: float  # kg/m3
    thickness: float  # m
    least_pressure: float  # Pa; a packing under less is loaded and held as if under this


class Outcome(NamedTuple):
    """What `deform` tells of the B packings, one row each."""

    stress: np.ndarray  # (B, d, d) Pa
    fabric: np.ndarray  # (B, d, d)
    loading_steps: np.ndarray  # (B,)
    hold_steps: np.ndarray  # (B,)
    unbalance: np.ndarray  # (B,) of eq. 19 at the end; 0 without contacts
    at_rest: np.ndarray  # (B,) bool: the hold ended by its criterion, not by its limit
    contacts: np.ndarray  # (B,)
    overlap: np.ndarray  # (B,) largest, over the mean diameter of its grains

    @classmethod
    def of(cls, size: int, dim: int) -> "Outcome":
        """Room for that many packings."""
        return cls(
            np.zeros((size, dim, dim)), np.zeros((size, dim, dim)), np.zeros(size, np.int64),
            np.zeros(size, np.int64), np.zeros(size), np.zeros(size, np.bool_),
            np.zeros(size, np.int64), np.zeros(size),
        )  # fmt: skip


def settings(packing: Packing, accuracy: Accuracy, pressure: float) -> Loading:
    """Settings for packings like this one, at work around `pressure` (Pa, positive)."""
    return Loading(
        accuracy.inertial_number,
        accuracy.tolerance,
        accuracy.hold_limit,
        accuracy.time_step * stable_time_step(packing, pressure),
        accuracy.damping,
        accuracy.hold_damping,
        packing.mean_diameter,
        packing.density,
        packing.thickness,
        0.1 * pressure,
    )


def logarithm(F: np.ndarray) -> np.ndarray:
    """Matrix logarithm of F (..., d, d), by square roots and the series of artanh.

    L = ln F / tau is the constant velocity gradient that leads from I to F in the time tau.
    Raises ValueError, with the number of the first bad one, where F has values that are not
    finite, no positive determinant, or turns by about 180 degrees.
    """
    F = np.asarray(F, dtype=np.float64)
    identity = np.eye(F.shape[-1])
    finite = np.isfinite(F).all((-2, -1))
    determinant = np.linalg.det(np.where(finite[..., None, None], F, identity))
    good = finite & (determinant > 0)
    if not good.all():
        raise ValueError(
            f"deformation gradient {int(np.flatnonzero(~good)[0])} is not finite or has a"
            " determinant that is not positive: the load step is too large or the mesh is turned"
            " inside out"
        )
    half_turn = ValueError("a deformation gradient turns by about 180 degrees in one increment")
    root, halvings = F.copy(), np.zeros((*F.shape[:-2], 1, 1))
    far = np.abs(root - identity).max((-2, -1)) > 0.1
    while far.any():  # the roots of one F must not depend on the others
        try:
            root[far] = _square_root(root[far])
        except np.linalg.LinAlgError:  # exactly 180 degrees
            raise half_turn from None
        halvings[far] += 1
        if halvings.max() > 12 or not np.isfinite(root).all():
            raise half_turn
        far = np.abs(root - identity).max((-2, -1)) > 0.1
    z = np.linalg.solve(root + identity, root - identity)
    square, term, total = z @ z, z, z
    for k in range(3, 21, 2):
        term = term @ square
        total = total + term / k
    result = 2.0 ** (halvings + 1) * total
    dilation = np.trace(result, axis1=-2, axis2=-1) - np.log(determinant)
    if np.abs(dilation).max(initial=0.0) > 1e-9:  # the roots did not converge
        raise half_turn
    return result


def _square_root(F: np.ndarray) -> np.ndarray:
    """Principal square root of F (..., d, d) by Denman-Beavers iteration."""
    Y, Z = F, np.broadcast_to(np.eye(F.shape[-1]), F.shape)
    for _ in range(12):
        Y, Z = 0.5 * (Y + np.linalg.inv(Z)), 0.5 * (Z + np.linalg.inv(Y))
    return Y


def shear_of(log_F: np.ndarray) -> np.ndarray:
    """gamma = e_1 - e_3 of the strain, the symmetric part of ln F (n, d, d), Desrues eq. 17.

    Out of the plane e = 0, so that gamma is never zero unless the strain is. Shape (n,).
    """
    principal = np.linalg.eigvalsh(0.5 * (log_F + np.swapaxes(log_F, -1, -2)))
    return np.maximum(principal[..., -1], 0.0) - np.minimum(principal[..., 0], 0.0)


def pressure_of(stress: np.ndarray) -> np.ndarray:
    """Mean pressure of stress (..., d, d), Pa, compression positive."""
    return -np.trace(stress, axis1=-2, axis2=-1) / stress.shape[-1]


@kernel
def resume_flow(motion, gradient, flow, flow_gradient):
    """Let the grains start as they flowed when last loaded, as far as L points the same way.

    Beyond the affine motion a packing flows in much the same pattern from increment to increment.
    Started from rest, each increment shakes the grains anew: the rms error of the stress is then
    1.0 % in place of 0.8 % at I = 1e-3, 0.44 % in place of 0.32 % at 1e-4 (docs/accuracy.md).
    """
    along = (gradient * flow_gradient).sum()
    squared = (flow_gradient * flow_gradient).sum()
    share = max(along / squared, 0.0) if squared > 0.0 else 0.0
    dim = len(motion.velocity)
    motion.velocity[:] = share * flow[:dim]
    motion.rim_velocity[:] = share * flow[dim:]


@kernel
def share_of_look(ratio, tolerance):
    """Share of the stress that a look at a hold decides: none if far from rest, all if at rest.

    A hold ends after so many blocks, and the stress at the end of the last one jumps where F
    changes ever so little and their number jumps: by up to 1 %, and Newton finds no balance below
    that. The stress is hence a mean over the looks since the packing was nearly at rest
    (docs/operators.md).
    """
    return max(1.0 - math.log(max(ratio / tolerance, 1.0)) / math.log(NEARLY_AT_REST), 0.0)


@kernel
def restore(b, state, work):
    """Box, positions and contact history of packing b of a batch; the pair list is out of date."""
    motion, history = work.motion, work.history
    motion.box[:] = state[0][b]
    motion.position[:] = state[1][b]
    history.first[:] = state[5][b]
    count = history.first[-1]
    history.j[:count] = state[6][b, :count]
    history.tangential[:, :count] = state[7][b, :, :count]
    history.memory[:, :count] = state[8][b, :, :count]


@kernel
def deform(
    b, F, log_F, shear, pressure, time_step, material, loading, state, new, place, outcome, row,
    work,
):  # fmt: skip
    """Deform packing b by F (d, d) in the time of its shear, then hold it; Desrues eq. 16-19.

    `state` and `new` hold the arrays of PackingBatches: the new state goes to `place` of `new`,
    what is measured to `row` of `outcome`. Returns OK, or NO_ROOM where the work space is too small
    for the contacts; what has been written then has no meaning.
    """
    motion, history = work.motion, work.history
    restore(b, state, work)
    final_box = product(F, motion.box)
    if dynamics.start(material, work) != OK:
        return NO_ROOM

    held_pressure = max(pressure, loading.least_pressure)
    speed = loading.inertial_number * math.sqrt(held_pressure / loading.density)
    duration = shear * loading.mean_diameter / speed  # tau of eq. 18
    steps = max(math.ceil(duration / time_step), FEWEST_STEPS)
    dt = duration / steps if duration > 0 else time_step
    gradient = log_F / (steps * dt)
    resume_flow(motion, gradient, state[2][b], state[3][b])
    if dynamics.advance(steps, dt, gradient, loading.damping, material, work) != OK:
        return NO_ROOM
    motion.box[:] = final_box
    new[2][place, : len(F)], new[2][place, len(F) :] = motion.velocity, motion.rim_velocity
    new[3][place] = gradient
    new[4][place] = state[4][b]

    motion.velocity[:] = 0.0
    motion.rim_velocity[:] = 0.0
    weakest = held_pressure * loading.mean_diameter * loading.thickness
    if len(F) == 3:
        weakest *= loading.mean_diameter
    still = np.zeros_like(F)
    held, ratio, at_rest = 0, 0.0, False
    measured, left = np.zeros_like(F), 1.0
    outcome.stress[row] = 0.0
    while not at_rest and held < loading.hold_limit:
        status = dynamics.advance(
            HOLD_BLOCK, time_step, still, loading.hold_damping, material, work
        )
        if status != OK:
            return NO_ROOM
        held += HOLD_BLOCK
        net, contact = dynamics.unbalance(work)
        ratio = net / max(contact, 1e-3 * weakest)
        at_rest = ratio < loading.tolerance
        share = left * share_of_look(ratio, loading.tolerance)
        if held >= loading.hold_limit:
            share = left
        if share > 0.0 or at_rest:
            outcome.contacts[row], outcome.overlap[row] = measure(
                motion, work.pairs, material, loading.thickness, measured, outcome.fabric[row]
            )
            outcome.stress[row] += share * measured
            left -= share
    if outcome.contacts[row] < FAILED_CONTACTS_PER_GRAIN * motion.position.shape[1]:
        outcome.stress[row] = measured  # what it bore before it collapsed in the hold is gone

    remember(work.pairs, history)
    count = history.first[-1]
    if count > new[6].shape[1]:
        return NO_ROOM
    new[0][place] = motion.box
    new[1][place] = motion.position
    new[5][place] = history.first
    new[6][place, :count] = history.j[:count]
    new[7][place, :, :count] = history.tangential[:, :count]
    new[8][place, :, :count] = history.memory[:, :count]
    outcome.loading_steps[row], outcome.hold_steps[row] = steps, held
    outcome.unbalance[row], outcome.at_rest[row] = ratio, at_rest
    return OK


@kernel
def deform_in_turn(
    tickets, order, packings, places, F, log_F, shear, pressure, time_step, material, loading,
    state, new, outcome, status, work,
):  # fmt: skip
    """Deform rows of `order`, each the next that no other thread has taken, until none is left.

    The threads of a process all call this with the same `tickets` (1,) at zero and with a work
    space of their own. Row r is packing `packings[r]`, goes to `places[r]` of `new`, and leaves
    what `deform` returns in `status[r]`.
    """
    while True:
        turn = next_ticket(tickets)
        if turn >= order.size:
            return
        r = order[turn]
        b = packings[r]
        status[r] = deform(
            b, F[r], log_F[r], shear[r], pressure[b], time_step[b], material, loading, state, new,
            places[r], outcome, r, work,
        )  # fmt: skip
