"""From F_i to F_f: a packing is deformed at a quasi-static rate, then held until it is at rest."""

import math
from typing import NamedTuple

import numpy as np

from . import dynamics
from .accuracy import Accuracy
from .aliasing import kernel, next_ticket, part_of_kernels
from .dynamics import NO_ROOM, OK, TOO_MANY_CONTACTS
from .homogenisation import measure
from .neighbours import remember
from .packing import Packing
from .reproducible import determinant, eigenvalues, inverse, log, transposed
from .reproducible import product as stack_product
from .small import product
from .stability import stable_time_step, stiffest_contact

#: Steps of a hold between two looks at its criterion.
HOLD_BLOCK = 25
#: A hold counts for the stress from this many times the tolerance down.
NEARLY_AT_REST = 4.0
#: A packing with fewer contacts per grain than this carries no load: it has failed.
FAILED_CONTACTS_PER_GRAIN = 0.5
#: Fewest loading steps of an increment that is not zero.
FEWEST_STEPS = 4
#: The inertial number counts from this share of the least pressure up; without any it is infinite.
PRESSURE_FLOOR = 1e-2


class Loading(NamedTuple):
    """Settings of `deform`, as the kernel takes them."""

    inertial_number: float
    tolerance: float
    hold_limit: int
    time_step: float  # s, for the packing as it was prepared, if nothing is damped
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
    inertial_number: np.ndarray  # (B,) at the lower one of the pressures before and behind
    vibration: np.ndarray  # (B,) 1/s2, see `stability.stiffest_contact`

    @classmethod
    def of(cls, size: int, dim: int) -> "Outcome":
        """Room for that many packings."""
        return cls(
            np.zeros((size, dim, dim)), np.zeros((size, dim, dim)), np.zeros(size, np.int64),
            np.zeros(size, np.int64), np.zeros(size), np.zeros(size, np.bool_),
            np.zeros(size, np.int64), np.zeros(size), np.zeros(size), np.zeros(size),
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
    volume = determinant(np.where(finite[..., None, None], F, identity))
    good = finite & (volume > 0)
    if not good.all():
        raise ValueError(
            f"deformation gradient {int(np.flatnonzero(~good)[0])} is not finite or has a"
            " determinant that is not positive: the load step is too large or the mesh is turned"
            " inside out"
        )
    half_turn = ValueError("a deformation gradient turns by about 180 degrees in one increment")
    root, halvings = F.copy(), np.zeros((*F.shape[:-2], 1, 1), np.int64)
    far = np.abs(root - identity).max((-2, -1)) > 0.1
    while far.any():  # the roots of one F must not depend on the others
        root[far] = _square_root(root[far])
        halvings[far] += 1
        if halvings.max() > 12 or not np.isfinite(root).all():  # at 180 degrees there is no inverse
            raise half_turn
        far = np.abs(root - identity).max((-2, -1)) > 0.1
    z = stack_product(inverse(root + identity), root - identity)
    square, term, total = stack_product(z, z), z, z
    for k in range(3, 21, 2):
        term = stack_product(term, square)
        total = total + term / k
    result = np.ldexp(total, halvings + 1)
    dilation = np.trace(result, axis1=-2, axis2=-1) - log(volume)
    if np.abs(dilation).max(initial=0.0) > 1e-9:  # the roots did not converge
        raise half_turn
    return result


def _square_root(F: np.ndarray) -> np.ndarray:
    """Principal square root of F (..., d, d) by Denman-Beavers iteration."""
    Y, Z = F, np.broadcast_to(np.eye(F.shape[-1]), F.shape)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(12):
            Y, Z = 0.5 * (Y + inverse(Z)), 0.5 * (Z + inverse(Y))
    return Y


def shear_of(log_F: np.ndarray) -> np.ndarray:
    """gamma = e_1 - e_3 of the strain, the symmetric part of ln F (n, d, d), Desrues eq. 17.

    Out of the plane e = 0, so that gamma is never zero unless the strain is. Shape (n,).
    """
    principal = eigenvalues(0.5 * (log_F + transposed(log_F)))
    return np.maximum(principal[..., -1], 0.0) - np.minimum(principal[..., 0], 0.0)


def pressure_of(stress: np.ndarray) -> np.ndarray:
    """Mean pressure of stress (..., d, d), Pa, compression positive."""
    return -np.trace(stress, axis1=-2, axis2=-1) / stress.shape[-1]


@part_of_kernels
def mean_pressure(stress):
    """`pressure_of` one stress (d, d)."""
    return -np.trace(stress) / len(stress)


@kernel
def resume_flow(motion, gradient, flow, flow_gradient):
    """Let the grains start as they flowed when last loaded, as far as the packing strains that way.

    Only the symmetric parts of both L (1/s) are compared: grains flow because the packing strains,
    and a rotation, however fast, must not move them along. Beyond the affine motion a packing flows
    in much the same pattern from increment to increment. Started from rest, each increment shakes
    the grains anew: the rms error of the stress is then 1.0 % in place of 0.8 % at I = 1e-3, 0.44 %
    in place of 0.32 % at 1e-4 (docs/accuracy.md).
    """
    along = squared = 0.0
    for i in range(len(gradient)):
        for j in range(len(gradient)):
            rate = 0.5 * (gradient[i, j] + gradient[j, i])
            last = 0.5 * (flow_gradient[i, j] + flow_gradient[j, i])
            along += rate * last
            squared += last * last
    share = max(along / squared, 0.0) if squared > 0.0 else 0.0
    dim, grains = motion.velocity.shape
    for i in range(grains):
        for a in range(dim):
            motion.velocity[a, i] = share * flow[a, i]
        for a in range(len(motion.rim_velocity)):
            motion.rim_velocity[a, i] = share * flow[dim + a, i]


@kernel
def come_to_rest(motion, flow):
    """Let the grains stand still, and keep how they flowed in `flow` (d + q, N)."""
    dim, grains = motion.velocity.shape
    for i in range(grains):
        for a in range(dim):
            flow[a, i] = motion.velocity[a, i]
            motion.velocity[a, i] = 0.0
        for a in range(len(motion.rim_velocity)):
            flow[dim + a, i] = motion.rim_velocity[a, i]
            motion.rim_velocity[a, i] = 0.0


@part_of_kernels
def share_of_look(ratio, tolerance):
    """Share of the stress that a look at a hold decides: none if far from rest, all if at rest.

    A hold ends after so many blocks, and the stress at the end of the last one jumps where F
    changes ever so little and their number jumps: by up to 1 %, and Newton finds no balance below
    that. The stress is hence a mean over the looks since the packing was nearly at rest
    (docs/operators.md).
    """
    over = max(ratio / tolerance, 1.0)
    return max((NEARLY_AT_REST - over) / (NEARLY_AT_REST - 1.0), 0.0)


@kernel
def copy_columns(count, source, target):
    """The first columns of an array (rows, n) into another."""
    for a in range(source.shape[0]):
        for c in range(count):
            target[a, c] = source[a, c]


@kernel
def copy_entries(count, source, target):
    """The first entries of an array (n,) into another."""
    for c in range(count):
        target[c] = source[c]


@kernel
def restore(b, state, motion, history):
    """Box, positions and contact history of packing b of a batch; the pair list is out of date."""
    dim, grains = motion.position.shape
    copy_columns(dim, state[0][b], motion.box)
    copy_columns(grains, state[1][b], motion.position)
    copy_entries(grains + 1, state[5][b], history.first)
    count = history.first[-1]
    copy_entries(count, state[6][b], history.j)
    copy_columns(count, state[7][b], history.tangential)
    copy_columns(count, state[8][b], history.memory)


@kernel
def store(motion, history, new, place):
    """Box, positions and contact history into packing `place` of a batch.

    False, with nothing written, where the batch has no room for so many contacts.
    """
    dim, grains = motion.position.shape
    count = history.first[-1]
    if count > new[6].shape[1]:
        return False
    copy_columns(dim, motion.box, new[0][place])
    copy_columns(grains, motion.position, new[1][place])
    copy_entries(grains + 1, history.first, new[5][place])
    copy_entries(count, history.j, new[6][place])
    copy_columns(count, history.tangential, new[7][place])
    copy_columns(count, history.memory, new[8][place])
    return True


@part_of_kernels
def deform(
    b, F, log_F, shear, pressure, time_step, material, loading, state, new, place, outcome, row,
    work,
):  # fmt: skip
    """Deform packing b by F (d, d) in the time of its shear, then hold it; Desrues eq. 16-19.

    Damping a takes (1 + a) of the force where grains slow down, which is as a spring as much
    stiffer: the stable time step is 1 / sqrt(1 + a) of `time_step`, the one without any.

    `state` and `new` hold the arrays of PackingBatches: the new state goes to `place` of `new`,
    what is measured to `row` of `outcome`. Returns OK; NO_ROOM where the work space is too small
    for the pairs; or TOO_MANY_CONTACTS for `new`. What has been written then has no meaning.
    """
    motion, history = work.motion, work.history
    restore(b, state, motion, history)
    final_box = product(F, motion.box)
    status = dynamics.start(
        work, material.radius, material.inverse_mass, material.law, material.viscosity,
        material.skin,
    )  # fmt: skip
    if status != OK:
        return NO_ROOM

    held_pressure = max(pressure, loading.least_pressure)
    speed = loading.inertial_number * math.sqrt(held_pressure / loading.density)
    duration = shear * loading.mean_diameter / speed  # tau of eq. 18
    dt = time_step / math.sqrt(1.0 + loading.damping)
    steps = max(math.ceil(duration / dt), FEWEST_STEPS)
    dt = duration / steps if duration > 0 else dt
    gradient = log_F / (steps * dt)
    resume_flow(motion, gradient, state[2][b], state[3][b])
    status = dynamics.advance(
        steps, dt, gradient, loading.damping, material, work, material.inverse_radius
    )
    if status != OK:
        return NO_ROOM
    copy_columns(len(F), final_box, motion.box)
    come_to_rest(motion, new[2][place])
    copy_columns(len(F), gradient, new[3][place])
    copy_columns(len(F), state[4][b], new[4][place])

    weakest = held_pressure * loading.mean_diameter * loading.thickness
    if len(F) == 3:
        weakest *= loading.mean_diameter
    still = np.zeros_like(F)
    held, ratio, at_rest = 0, 0.0, False
    hold_dt = time_step / math.sqrt(1.0 + loading.hold_damping)
    measured, left = np.zeros_like(F), 1.0
    outcome.stress[row] = 0.0
    while not at_rest and held < loading.hold_limit:
        # a literal would be a type of its own, and `advance` compiled for it once more
        status = dynamics.advance(
            np.int64(HOLD_BLOCK), hold_dt, still, loading.hold_damping, material, work,
            material.inverse_radius,
        )  # fmt: skip
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
                motion, work.pairs, material.law, material.cohesion, material.bonds,
                loading.thickness, measured, outcome.fabric[row],
            )  # fmt: skip
            outcome.stress[row] += share * measured
            left -= share
    if outcome.contacts[row] < FAILED_CONTACTS_PER_GRAIN * motion.position.shape[1]:
        outcome.stress[row] = measured  # what it bore before it collapsed in the hold is gone

    remember(work.pairs, history)
    if not store(motion, history, new, place):
        return TOO_MANY_CONTACTS
    outcome.loading_steps[row], outcome.hold_steps[row] = steps, held
    outcome.unbalance[row], outcome.at_rest[row] = ratio, at_rest
    outcome.vibration[row] = stiffest_contact(work, material, outcome.overlap[row])
    outcome.inertial_number[row] = 0.0
    if outcome.contacts[row] > 0:
        lower = max(
            min(pressure, mean_pressure(outcome.stress[row])),
            PRESSURE_FLOOR * loading.least_pressure,
        )
        outcome.inertial_number[row] = (
            shear / (steps * dt) * loading.mean_diameter * math.sqrt(loading.density / lower)
        )
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
