"""Small packings whose answers are known, and a way to move them step by step."""

import numpy as np

from femxdem_fenicsx.dem import dynamics
from femxdem_fenicsx.dem.contacts import LinearContact
from femxdem_fenicsx.dem.neighbours import remember
from femxdem_fenicsx.dem.packing import Packing, PackingBatch

RADIUS, STIFFNESS = 1e-2, 1e5
FRICTIONLESS = LinearContact(stiffness=STIFFNESS, friction=0.0)


def two_grains(
    gap: float, law: LinearContact = FRICTIONLESS, radii=(RADIUS, RADIUS), angle: float = 0.0
) -> Packing:
    """Two disks in a wide box, that far apart (m) along a line at that angle (rad) to x."""
    box = 40 * max(radii)
    branch = (sum(radii) + gap) * np.array([np.cos(angle), np.sin(angle)])
    middle = np.full(2, box / 2)
    positions = np.array([middle - branch / 2, middle + branch / 2]) / box
    return Packing(np.eye(2) * box, positions, np.array(radii), law, thickness=0.1)


def hexagonal(
    columns: int = 6, rows: int = 6, overlap: float = 1e-3, law: LinearContact = FRICTIONLESS
) -> Packing:
    """Equal disks on a triangular lattice; every contact overlaps by that share of a diameter."""
    spacing = 2 * RADIUS * (1 - overlap)
    place = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), -1)
    place = place.reshape(-1, 2).astype(float)
    place[:, 0] += 0.5 * (place[:, 1] % 2)
    box = spacing * np.diag([columns, rows * np.sqrt(0.75)])
    positions = place / (columns, rows)
    return Packing(box, positions, np.full(len(place), RADIUS), law, thickness=0.1)


def chain(axis: int, law: LinearContact, grains: int = 6, overlap: float = 1e-3) -> Packing:
    """Equal disks in a straight periodic line along x (0) or y (1)."""
    spacing = 2 * RADIUS * (1 - overlap)
    box = np.eye(2) * 20 * RADIUS
    box[axis, axis] = grains * spacing
    positions = np.full((grains, 2), 0.5)
    positions[:, axis] = np.arange(grains) / grains
    return Packing(box, positions, np.full(grains, RADIUS), law, thickness=0.1)


def loose(grains: int, seed: int, box: np.ndarray, law: LinearContact = FRICTIONLESS) -> Packing:
    """Disks of 3-7 mm anywhere in the box and in its images; they may overlap a lot."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-1, 2, (grains, 2))
    return Packing(box, positions, rng.uniform(3e-3, 7e-3, grains), law, thickness=0.1)


def started(material: dynamics.Material, work: dynamics.Workspace) -> bool:
    """Whether the work space has room for the pair list of its motion, which it then holds."""
    status = dynamics.start(
        work, material.radius, material.inverse_mass, material.law, material.viscosity,
        material.skin,
    )  # fmt: skip
    return status == dynamics.OK


class Moving:
    """A packing in a work space of its own, for tests that look at single time steps."""

    def __init__(self, packing: Packing, velocity=0.0, rim_speed=0.0, **material):
        """Velocities (N, d) and rim speeds (N,), of spheres (N, 3), m/s; `material`: constants."""
        self.packing = packing
        self.material = packing.material._replace(**material)
        viscous = self.material.viscosity is not None
        room = max(30, packing.size) * packing.size
        self.work = dynamics.workspace(
            packing.size, packing.dim, room, viscous, len(packing.memory)
        )
        self.work.motion.box[:] = packing.box
        self.work.motion.position[:] = packing.positions.T
        self.work.motion.velocity[:] = np.transpose(velocity)
        self.work.motion.rim_velocity[:] = np.transpose(rim_speed)
        batch, history = PackingBatch.of(packing, 1), self.work.history
        history.first[:] = batch.row[0]
        history.j[: batch.second.shape[1]] = batch.second[0]
        history.tangential[:, : batch.second.shape[1]] = batch.tangential[0]
        history.memory[:, : batch.second.shape[1]] = batch.memory[0]
        assert started(self.material, self.work)

    def advance(self, steps: int, dt: float, gradient=0.0, damping: float = 0.0) -> "Moving":
        """Take steps of dt (s) while the box moves with that velocity gradient (1/s)."""
        gradient = np.zeros((self.packing.dim, self.packing.dim)) + gradient
        status = dynamics.advance(
            steps, dt, gradient, damping, self.material, self.work, self.material.inverse_radius
        )
        assert status == dynamics.OK
        return self

    @property
    def velocity(self) -> np.ndarray:
        """(N, d) m/s, half a step before the positions."""
        return self.work.motion.velocity.T

    @property
    def now(self) -> Packing:
        """The packing as it stands."""
        remember(self.work.pairs, self.work.history)
        row = self.work.history.first.astype(int)
        history = self.work.history
        first = np.repeat(np.arange(self.packing.size), np.diff(row))
        return self.packing.with_contacts(
            np.column_stack([first, history.j[: row[-1]]]),
            history.tangential[:, : row[-1]],
            history.memory[:, : row[-1]],
            box=self.work.motion.box,
            positions=self.work.motion.position.T,
        )

    def listed(self) -> dict[tuple[int, int], int]:
        """Place in the pair list of every pair (i, j)."""
        pairs = self.work.pairs
        return {(int(pairs.i[c]), int(pairs.j[c])): c for c in range(pairs.first[-1])}


def pairs_closer_than_reach_plus(skin: float, box, positions, radii) -> dict:
    """Brute force: {(i, j): image shift of j} of all pairs, over 7^d images of the box."""
    box, positions = np.asarray(box), np.asarray(positions)
    i, j = np.triu_indices(len(radii), 1)
    nearest = -np.rint(positions[j] - positions[i])
    found = {}
    for image in np.array(list(np.ndindex(*[7] * len(box)))) - 3:
        shift = nearest + image
        branch = (positions[j] - positions[i] + shift) @ box.T
        near = np.flatnonzero((branch**2).sum(1) < (radii[i] + radii[j] + skin) ** 2)
        for k in near:
            pair = (int(i[k]), int(j[k]))
            assert pair not in found, "a grain meets two images of another"
            found[pair] = tuple(shift[k])
    return found


def two_spheres(
    gap: float,
    law: LinearContact = FRICTIONLESS,
    radii=(RADIUS, RADIUS),
    direction=(1.0, 0.0, 0.0),
) -> Packing:
    """Two spheres in a wide box, that far apart (m) along a direction."""
    box = 40 * max(radii)
    branch = (sum(radii) + gap) * np.array(direction) / np.linalg.norm(direction)
    positions = np.array([-0.5 * branch, 0.5 * branch]) / box + 0.5
    return Packing(np.eye(3) * box, positions, np.array(radii), law)


def cubic(cells: int = 4, overlap: float = 1e-3, law: LinearContact = FRICTIONLESS) -> Packing:
    """Equal spheres on a simple cubic lattice; contacts overlap by that share of a diameter."""
    spacing = 2 * RADIUS * (1 - overlap)
    positions = np.array(list(np.ndindex(cells, cells, cells))) / cells
    return Packing(np.eye(3) * cells * spacing, positions, np.full(cells**3, RADIUS), law)


def loose_spheres(
    grains: int, seed: int, box: np.ndarray, law: LinearContact = FRICTIONLESS
) -> Packing:
    """Spheres of 3-7 mm anywhere in the box and in its images; they may overlap a lot."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-1, 2, (grains, 3))
    return Packing(box, positions, rng.uniform(3e-3, 7e-3, grains), law)


def turn(axis, angle: float) -> np.ndarray:
    """Rotation (3, 3) about an axis (rad)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
