"""Packing: one periodic assembly of grains. PackingBatch: many of them, for the kernels."""

from dataclasses import dataclass, field, replace

import numpy as np

from .contacts import LinearContact
from .dynamics import Material
from .neighbours import box_heights

#: Skin of the pair list as a share of the mean radius: dense packings hardly rearrange.
SKIN = 0.08
#: Pairs (and contacts) that there is room for, per grain; a monodisperse disk touches at most 6.
PAIRS_PER_GRAIN, CONTACTS_PER_GRAIN = 5, 3


@dataclass(frozen=True)
class Packing:
    """A periodic assembly of N disks at rest.

    Attributes:
        box: (2, 2), columns are the periodicity vectors h, m (Desrues fig. 4).
        positions: (N, 2) reduced positions s; r = h s (eq. 13).
        radii: (N,) m.
        law: contact law.
        density: of the grains, kg/m3.
        thickness: out of plane, m.
        contacts: (C, 2) pairs (i, j), i < j, that transmit a tangential force.
        tangential: (C,) force on j along (-n_y, n_x), n from i to j, N.

    Raises ValueError for no grains, radii or density that are not positive, a box that is turned
    inside out or so small that a grain would meet its own image, and anything not finite.
    """

    box: np.ndarray
    positions: np.ndarray
    radii: np.ndarray
    law: LinearContact
    density: float = 2650.0
    thickness: float = 1.0
    contacts: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int32))
    tangential: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self):
        for name in ("box", "positions", "radii", "tangential"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        object.__setattr__(self, "contacts", np.array(self.contacts, dtype=np.int32))
        self._check()

    def _check(self):
        size = self.radii.size
        shapes = {
            "box": (2, 2),
            "positions": (size, 2),
            "radii": (size,),
            "contacts": (self.tangential.size, 2),
            "tangential": (self.tangential.size,),
        }
        if size == 0:
            raise ValueError("Packing: it has no grains")
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(
                    f"Packing: {name} has shape {getattr(self, name).shape}, expected {shape}"
                )
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"Packing: {name} has values that are not finite")
        if not (self.radii > 0).all():
            raise ValueError(f"Packing: radii must be positive, the smallest is {self.radii.min()}")
        if not (self.density > 0 and self.thickness > 0):
            raise ValueError("Packing: density and thickness must be positive")
        if not np.linalg.det(self.box) > 0:
            raise ValueError("Packing: the box has no positive area")
        if len(self.contacts) and not (
            (self.contacts[:, 0] >= 0).all()
            and (self.contacts[:, 0] < self.contacts[:, 1]).all()
            and (self.contacts[:, 1] < size).all()
        ):
            raise ValueError("Packing: contacts must be pairs (i, j) of grains with i < j")
        if min(box_heights(self.box)) < 4 * self.radii.max() * (1 + SKIN):
            raise ValueError(
                "Packing: the box is lower than two diameters of the largest grain, which would"
                " meet its own image; use more grains"
            )

    @property
    def dim(self) -> int:
        """Space dimension."""
        return 2

    @property
    def size(self) -> int:
        """Number of grains."""
        return self.radii.size

    @property
    def masses(self) -> np.ndarray:
        """(N,) kg."""
        return self.density * self.thickness * np.pi * self.radii**2

    @property
    def volume(self) -> float:
        """Volume of the box, m3."""
        return float(np.linalg.det(self.box)) * self.thickness

    @property
    def void_ratio(self) -> float:
        """Volume of voids over volume of grains; overlaps count as grain twice."""
        return float(np.linalg.det(self.box) / (np.pi * (self.radii**2).sum()) - 1.0)

    @property
    def mean_diameter(self) -> float:
        """<d> of eq. 18, m."""
        return float(2 * self.radii.mean())

    @property
    def material(self) -> Material:
        """Constants of this packing as the kernels take them."""
        return Material(
            self.radii,
            1.0 / self.masses,
            *self.law.stiffnesses,
            float(self.law.stiffness_ratio),
            *self.law.features,
            SKIN * float(self.radii.mean()),
        )

    @property
    def contact_modulus(self) -> float:
        """k_n / thickness of a mean contact, Pa: the scale of the packing's stiffness."""
        constant, modulus = self.law.stiffnesses
        return (constant + modulus * float(self.radii.mean())) / self.thickness

    def but(self, **changes) -> "Packing":
        """A copy with some attributes changed."""
        return replace(self, **changes)

    def deformed(self, F: np.ndarray) -> "Packing":
        """The packing moved affinely by F (2, 2): nothing but the box changes."""
        return self.but(box=np.asarray(F) @ self.box)


@dataclass(frozen=True)
class PackingBatch:
    """B packings that differ in state but share grain sizes, contact law and density.

    Attributes, all contiguous, first index the packing:
        box (B, 2, 2), position (B, 2, N): where the grains are;
        flow (B, 3, N), flow_gradient (B, 2, 2): how they moved when they were last loaded, that is
            velocities beyond the affine motion and rim speed (m/s), and the L that caused it (1/s);
        row (B, N + 1), second (B, C), tangential (B, C): contacts that hold a tangential force,
            in compressed rows (`neighbours.History`).
        template: the packing that gives radii, contact law, density and thickness.
    """

    template: Packing
    box: np.ndarray
    position: np.ndarray
    flow: np.ndarray
    flow_gradient: np.ndarray
    row: np.ndarray
    second: np.ndarray
    tangential: np.ndarray

    STATE = ("box", "position", "flow", "flow_gradient", "row", "second", "tangential")

    @classmethod
    def of(cls, packing: Packing, size: int) -> "PackingBatch":
        """`size` copies of one packing; ValueError where size is negative."""
        if size < 0:
            raise ValueError(f"PackingBatch: size must not be negative, got {size}")
        N = packing.size
        room = CONTACTS_PER_GRAIN * N
        batch = cls(
            packing,
            np.zeros((size, 2, 2)),
            np.zeros((size, 2, N)),
            np.zeros((size, 3, N)),
            np.zeros((size, 2, 2)),
            np.zeros((size, N + 1), np.uint32),
            np.zeros((size, room), np.uint32),
            np.zeros((size, room)),
        )
        for b in range(size):
            batch.put(b, packing)
        return batch

    @property
    def size(self) -> int:
        """Number of packings."""
        return len(self.box)

    @property
    def state(self) -> tuple[np.ndarray, ...]:
        """The arrays of `STATE` as the kernels take them."""
        return tuple(getattr(self, name) for name in self.STATE)

    def copy(self) -> "PackingBatch":
        """A batch with its own arrays and the same values."""
        return replace(self, **{name: getattr(self, name).copy() for name in self.STATE})

    def put(self, b: int, packing: Packing) -> None:
        """Make `packing` the state of number b; it must have the template's grains."""
        if not np.array_equal(packing.radii, self.template.radii):
            raise ValueError("PackingBatch: all packings of a batch must have the same grains")
        order = np.lexsort((packing.contacts[:, 1], packing.contacts[:, 0]))
        pairs, count = packing.contacts[order], len(order)
        if count > self.second.shape[1]:
            raise ValueError(f"PackingBatch: {count} contacts, room for {self.second.shape[1]}")
        self.box[b] = packing.box
        self.position[b] = packing.positions.T
        self.flow[b] = 0.0
        self.flow_gradient[b] = 0.0
        self.row[b] = np.searchsorted(pairs[:, 0], np.arange(packing.size + 1))
        self.second[b, :count] = pairs[:, 1]
        self.tangential[b, :count] = packing.tangential[order]

    def packing(self, b: int) -> Packing:
        """Number b on its own."""
        row = self.row[b].astype(np.int64)
        count = row[-1]
        first = np.repeat(np.arange(self.template.size), np.diff(row))
        return self.template.but(
            box=self.box[b],
            positions=self.position[b].T,
            contacts=np.column_stack([first, self.second[b, :count]]),
            tangential=self.tangential[b, :count],
        )
