"""Packing: one periodic assembly of grains. PackingBatch: many of them, for the kernels."""

from dataclasses import dataclass, field, fields, replace

import numpy as np

from .contacts import ContactLaw
from .dynamics import Material
from .neighbours import box_heights
from .reproducible import determinant, inverse, product, transposed

#: Skin of the pair list as a share of the mean radius: dense packings hardly rearrange.
SKIN = 0.08
#: A box is reduced where h_a . h_b is more than this share of |h_b|^2.
TOO_SKEWED = 0.6
#: Pairs that there is room for at first, per grain, by dimension.
PAIRS_PER_GRAIN = {2: 5, 3: 8}
#: Contacts that there is room for, per grain, where a packing does not ask for more. Contacts of
#: disks that hardly overlap form a planar graph: 3 at most.
CONTACTS_PER_GRAIN = {2: 3, 3: 5}


@dataclass(frozen=True)
class Packing:
    """A periodic assembly of N disks (d = 2) or spheres (d = 3) at rest.

    Attributes:
        box: (d, d), columns are the periodicity vectors h, m (Desrues fig. 4).
        positions: (N, d) reduced positions s; r = h s (eq. 13).
        radii: (N,) m.
        law: contact law.
        density: of the grains, kg/m3.
        thickness: out of plane, m; 1 for spheres.
        contacts: (C, 2) pairs (i, j), i < j, that transmit a tangential force or are bonded.
        tangential: force on j, N, (C,) along (-n_y, n_x) with n from i to j; of spheres (C, 3).
        rolling: moment of the rolling resistance on j, N m, (C,); of spheres (C, 3). None, which
            stands for zeros, where the law has no rolling resistance.
        bonded: (C,) 1 for cemented contacts, 0 for others. None where the law has no bonds.

    Raises ValueError for no grains, radii or density that are not positive, a box that is turned
    inside out or so small that a grain would meet its own image, contacts that remember what their
    law does not know (rolling moments, bonds), bonds that stretch too far, anything not finite.
    """

    box: np.ndarray
    positions: np.ndarray
    radii: np.ndarray
    law: ContactLaw
    density: float = 2650.0
    thickness: float = 1.0
    contacts: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int32))
    tangential: np.ndarray = field(default_factory=lambda: np.zeros(0))
    rolling: np.ndarray | None = None
    bonded: np.ndarray | None = None

    def __post_init__(self):
        for name in ("box", "positions", "radii", "tangential"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=np.float64))
        object.__setattr__(self, "contacts", np.array(self.contacts, dtype=np.int32))
        if self.dim == 3 and self.tangential.size == 0:
            object.__setattr__(self, "tangential", np.zeros((0, 3)))
        self._check()
        for name, rows in self.law.memory(self.dim).items():
            self._check_memory(name, rows.stop - rows.start)
        if self.law.bonds is not None:
            self._check_bonds()

    def _check(self):
        size, dim, contacts = self.radii.size, self.dim, len(self.tangential)
        shapes = {
            "box": (dim, dim),
            "positions": (size, dim),
            "radii": (size,),
            "contacts": (contacts, 2),
            "tangential": (contacts,) if dim == 2 else (contacts, 3),
        }
        if dim not in (2, 3):
            raise ValueError(f"Packing: the box has {dim} rows; grains live in 2 or 3 dimensions")
        if dim == 3 and self.thickness != 1.0:
            raise ValueError("Packing: spheres have no thickness; leave it at 1")
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
        if not determinant(self.box) > 0:
            raise ValueError("Packing: the box has no positive volume")
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

    def _check_memory(self, name: str, rows: int):
        """What contacts remember: zeros if nothing is given; refused where the law has no use."""
        given = getattr(self, name)
        if rows == 0:
            if given is not None and np.any(given):
                raise ValueError(
                    f"Packing: {np.count_nonzero(given)} values of {name} are not zero, but its"
                    f" contact law has no {'bonds' if name == 'bonded' else 'rolling resistance'}:"
                    f" give it some, or give the packing {name}=None"
                )
            object.__setattr__(self, name, None)
            return
        shape = self.tangential.shape if name == "rolling" else self.tangential.shape[:1]
        values = np.zeros(shape) if given is None else np.array(given, dtype=np.float64)
        if values.shape != shape:
            raise ValueError(f"Packing: {name} has shape {values.shape}, expected {shape}")
        if not np.isfinite(values).all():
            raise ValueError(f"Packing: {name} has values that are not finite")
        object.__setattr__(self, name, values)

    def _check_bonds(self):
        if not np.isin(self.bonded, (0.0, 1.0)).all():
            raise ValueError("Packing: bonded must be 0 or 1 for every contact")
        elasticity, skin = self.law.elasticity, SKIN * float(self.radii.mean())
        smallest = float(self.radii.min())
        strength = elasticity.normal_force(elasticity.coefficient(smallest, smallest), skin)
        if self.bonded.any() and strength < self.law.bonds.tension:
            raise ValueError(
                f"Packing: bonds of {self.law.bonds.tension:.4g} N stretch by more than"
                f" {SKIN:.0%} of the mean radius before they break (at {strength:.4g} N); take"
                " stiffer contacts or weaker bonds"
            )

    @property
    def dim(self) -> int:
        """Space dimension d."""
        return len(self.box)

    @property
    def size(self) -> int:
        """Number of grains."""
        return self.radii.size

    @property
    def masses(self) -> np.ndarray:
        """(N,) kg."""
        return self.density * self.grain_volumes

    @property
    def grain_volumes(self) -> np.ndarray:
        """(N,) m3."""
        if self.dim == 2:
            return np.pi * self.radii**2 * self.thickness
        return 4.0 / 3.0 * np.pi * (self.radii * self.radii * self.radii)

    @property
    def volume(self) -> float:
        """Volume of the box, m3."""
        return float(determinant(self.box)) * self.thickness

    @property
    def void_ratio(self) -> float:
        """Volume of voids over volume of grains; overlaps count as grain twice."""
        return float(self.volume / self.grain_volumes.sum() - 1.0)

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
            1.0 / self.radii if self.dim == 3 else None,
            self.law.elasticity,
            *self.law.features,
            self.law.rolling,
            self.law.bonds,
            *(self.law.turning if self.dim == 3 else (None, None)),
            SKIN * float(self.radii.mean()),
        )

    @property
    def memory(self) -> np.ndarray:
        """(m, C) what contacts remember beside their tangential force (`ContactLaw.memory`)."""
        rows = self.law.memory(self.dim)
        memory = np.zeros((rows["bonded"].stop, len(self.contacts)))
        for name, place in rows.items():
            if getattr(self, name) is not None:
                memory[place] = getattr(self, name).T
        return memory

    def with_contacts(
        self, contacts: np.ndarray, tangential: np.ndarray, memory: np.ndarray, **changes
    ) -> "Packing":
        """A copy with these contacts (C, 2) and what they remember, (q, C) and (m, C)."""
        vectors = (lambda rows: rows[0]) if self.dim == 2 else (lambda rows: rows.T)
        rows = self.law.memory(self.dim)
        rolling, bonded = memory[rows["rolling"]], memory[rows["bonded"]]
        return self.but(
            contacts=contacts,
            tangential=vectors(tangential),
            rolling=vectors(rolling) if len(rolling) else None,
            bonded=bonded[0] if len(bonded) else None,
            **changes,
        )

    def overlap_under(self, pressure: float) -> float:
        """Overlap of a mean contact under a pressure (Pa), m: its force is p d t, or p d^2."""
        elasticity, radius = self.law.elasticity, float(self.radii.mean())
        coefficient = elasticity.coefficient(radius, radius)
        force = pressure * 2 * radius * (self.thickness if self.dim == 2 else 2 * radius)
        low, high = 0.0, 2.0 * radius
        for _ in range(60):
            middle = 0.5 * (low + high)
            if elasticity.normal_force(coefficient, middle) < force:
                low = middle
            else:
                high = middle
        return high

    def stiffness_level(self, pressure: float) -> float:
        """Mean diameter over the overlap of a mean contact under a pressure (Pa).

        Of linear contacts it is k_n / (p t) of disks and k_n / (p d) of spheres.
        """
        return self.mean_diameter / self.overlap_under(pressure)

    def contact_modulus(self, overlap: float | None = None) -> float:
        """k_n of a mean contact over thickness or mean radius, Pa: a scale of stiffness.

        At that overlap (m), or one of 0.1 % of the mean diameter; linear contacts do not mind.
        """
        elasticity, radius = self.law.elasticity, float(self.radii.mean())
        overlap = 2e-3 * radius if overlap is None else overlap
        k_n, _ = elasticity.stiffnesses(elasticity.coefficient(radius, radius), overlap)
        return k_n / (self.thickness if self.dim == 2 else radius)

    def equals(self, other: "Packing") -> bool:
        """Whether the other one has the same grains at the same places, with the same law."""
        return all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name))
            if isinstance(getattr(self, field.name), np.ndarray)
            else getattr(self, field.name) == getattr(other, field.name)
            for field in fields(self)
        )

    def but(self, **changes) -> "Packing":
        """A copy with some attributes changed; other contacts remember only what is given."""
        if "contacts" in changes:
            changes = {"rolling": None, "bonded": None} | changes
        return replace(self, **changes)

    def deformed(self, F: np.ndarray) -> "Packing":
        """The packing moved affinely by F (d, d): nothing but the box changes."""
        return self.but(box=product(np.asarray(F), self.box))


def reduction(box: np.ndarray) -> np.ndarray:
    """Integer matrix A (d, d), determinant 1, that makes the columns of h A short (Gauss).

    From every column the nearest multiple of each other one is taken off, until nothing changes.
    """
    h, A = np.array(box), np.eye(len(box))
    changed = True
    while changed:
        changed = False
        for a in range(len(h)):
            for b in range(len(h)):
                if a == b:
                    continue
                times = np.round((h[:, a] * h[:, b]).sum() / (h[:, b] * h[:, b]).sum())
                if times != 0.0:
                    h[:, a] -= times * h[:, b]
                    A[:, a] -= times * A[:, b]
                    changed = True
    return A


@dataclass(frozen=True)
class PackingBatch:
    """B packings that differ in state but share grain sizes, contact law and density.

    Attributes, all contiguous, first index the packing:
        box (B, d, d), position (B, d, N): where the grains are;
        flow (B, d + q, N), flow_gradient (B, d, d): how they moved when they were last loaded, that
            is velocities beyond the affine motion and rim velocities (m/s), and the L that caused
            it (1/s); q = 1 in 2D, 3 in 3D;
        turns (B, d, d): integers; `box` is the box of the first committed state, deformed, times
            them (see `reduce_boxes`);
        row (B, N + 1), second (B, C), tangential (B, q, C), memory (B, m, C): contacts that hold a
            tangential force or are bonded, in compressed rows (`neighbours.History`), and what the
            contact law remembers of them (`ContactLaw.memory`; m may be 0).
        template: the packing that gives radii, contact law, density and thickness.
    """

    template: Packing
    box: np.ndarray
    position: np.ndarray
    flow: np.ndarray
    flow_gradient: np.ndarray
    turns: np.ndarray
    row: np.ndarray
    second: np.ndarray
    tangential: np.ndarray
    memory: np.ndarray

    STATE = (
        "box", "position", "flow", "flow_gradient", "turns", "row", "second", "tangential",
        "memory",
    )  # fmt: skip

    @classmethod
    def of(cls, packing: Packing, size: int) -> "PackingBatch":
        """`size` copies of one packing; ValueError where size is negative."""
        if size < 0:
            raise ValueError(f"PackingBatch: size must not be negative, got {size}")
        N, d = packing.size, packing.dim
        q = 1 if d == 2 else 3
        room = CONTACTS_PER_GRAIN[d] * N
        if len(packing.contacts) > room:  # very soft ones
            room = 3 * len(packing.contacts) // 2
        batch = cls(
            packing,
            np.zeros((size, d, d)),
            np.zeros((size, d, N)),
            np.zeros((size, d + q, N)),
            np.zeros((size, d, d)),
            np.zeros((size, d, d)),
            np.zeros((size, N + 1), np.uint32),
            np.zeros((size, room), np.uint32),
            np.zeros((size, q, room)),
            np.zeros((size, packing.law.memory(d)["bonded"].stop, room)),
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
        self.turns[b] = np.eye(packing.dim)
        self.row[b] = np.searchsorted(pairs[:, 0], np.arange(packing.size + 1))
        self.second[b, :count] = pairs[:, 1]
        self.tangential[b, :, :count] = packing.tangential[order].T
        self.memory[b, :, :count] = packing.memory[:, order]

    def clear_unused(self) -> None:
        """Zero the room behind the last contact, so that equal states are equal arrays."""
        unused = np.arange(self.second.shape[1]) >= self.row[:, -1:]
        self.second[unused] = 0
        np.moveaxis(self.tangential, 1, 2)[unused] = 0.0
        np.moveaxis(self.memory, 1, 2)[unused] = 0.0

    def reduce_boxes(self) -> None:
        """Replace every box that is too skewed by an equivalent one, h <- h A, s <- A^-1 s.

        A is an integer matrix of determinant 1, so that the same grains stand at the same places:
        nothing but the choice of the periodicity vectors changes. Without it a box that is sheared
        on and on becomes lower than two diameters.
        """
        products = product(transposed(self.box), self.box)
        squares = np.diagonal(products, axis1=1, axis2=2)
        skewed = np.abs(products) > TOO_SKEWED * squares[:, None, :]
        skewed[:, range(self.box.shape[1]), range(self.box.shape[1])] = False
        for b in np.flatnonzero(skewed.any((1, 2))):
            A = reduction(self.box[b])
            self.box[b] = product(self.box[b], A)
            position = product(inverse(A).round(), self.position[b])
            self.position[b] = position - np.floor(position)
            self.turns[b] = product(self.turns[b], A)

    def packing(self, b: int) -> Packing:
        """Number b on its own."""
        row = self.row[b].astype(np.int64)
        count = row[-1]
        first = np.repeat(np.arange(self.template.size), np.diff(row))
        contacts = np.column_stack([first, self.second[b, :count]])
        tangential, memory = self.tangential[b, :, :count], self.memory[b, :, :count]
        return self.template.with_contacts(
            contacts, tangential, memory, box=self.box[b], positions=self.position[b].T
        )
