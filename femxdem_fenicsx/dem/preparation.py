"""Random packings: grains thrown into a wide box, which is compressed to a target stress."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import count

import numpy as np

from . import dynamics
from .contacts import ContactLaw, LinearContact
from .dynamics import OK
from .grain_sizes import GivenRadii, GrainSizes, UniformByNumber
from .homogenisation import measure, touching
from .loading import pressure_of
from .neighbours import box_heights, remember
from .packing import PAIRS_PER_GRAIN, Packing
from .reproducible import inner, rounded
from .stability import stable_time_step

#: Local damping (Guo-Zhao eq. 18) while a packing is prepared.
DAMPING = 0.3
#: Steps between two looks at the stress.
BLOCK = 25
#: Growth per block of what is known of how much softer in shear a packing is than its contacts.
SOFTER = 1.05
#: Span of the compaction friction within which void ratio answers to chance, not to friction.
SCATTER = 0.05
#: Fewest grains whose box, as dense as equal grains can be, is two diameters high, by dimension.
FEWEST_GRAINS = {2: 5, 3: 12}
#: Stiffness levels (`Packing.stiffness_level`): below the first a pressure squashes the grains;
#: from the second on a packing is compacted under more pressure first.
SOFTEST, STIFF = 4.0, 2e4
#: Most blocks before a preparation is given up.
MOST_BLOCKS = 40000


#: Contact law of Guo-Zhao table I.
GUO_ZHAO = LinearContact(modulus=6e8, stiffness_ratio=0.8, friction=0.5463024898437905)  # tan 0.5
#: Friction during the compression, by density class. 400 disks at 100 kPa come to void ratios of
#: about 0.175, 0.205 and 0.228 (Guo-Zhao: 0.177, 0.209 and 0.223).
DENSITIES = {"dense": 0.0, "medium": 0.1, "loose": 0.3}


class NotReached(RuntimeError):
    """A stress or a void ratio that the grains did not come to; the message says how far.

    packing: the state that was reached, or None where there is none to show.
    """

    def __init__(self, message: str, packing: Packing | None = None):
        super().__init__(message)
        self.packing = packing


def random_packing(
    grains: int = 400,
    radii: tuple[float, float] | GrainSizes = (3e-3, 7e-3),
    law: ContactLaw | None = None,
    pressure: float | Sequence[float] = 1e5,
    compaction_friction: float = 0.0,
    seed: int = 1,
    density: float = 2650.0,
    thickness: float | None = None,
    dim: int = 2,
    tolerance: float = 1e-3,
    progress: Callable[[float], None] | None = None,
) -> Packing:
    """A periodic packing of random disks or spheres at rest under a pressure.

    Args:
        grains: their number.
        radii: how the radii are distributed, see `grain_sizes`; two values are the bounds of a
            distribution that is uniform by number, m (defaults: Guo-Zhao table I).
        law: contact law of the finished packing; Guo-Zhao's by default. Where it has bonds, all
            grains that touch in the end are cemented.
        pressure: Pa, compression positive; isotropic, or one value per axis (Desrues table 4).
        compaction_friction: friction during the compression, which steers the void ratio: 0 gives
            a dense packing, more a looser one.
        seed: of the random numbers; same seed, same packing.
        density: of the grains, kg/m3.
        thickness: out of plane, m; spheres have none. By default ten times the mean of smallest and
            largest diameter, 0.1 m for the default radii: k_n / (p t) of `LinearContact`, and with
            it all results, then do not depend on the unit of length.
        dim: 2 for disks, 3 for spheres.
        tolerance: on every stress component over the pressure, and on Desrues eq. 19.
        progress: called now and then with the pressure reached over the pressure wanted.

    Raises:
        ValueError: for values that make no packing.
        NotReached: if the target is not reached.
    """
    law = law or GUO_ZHAO
    sizes = UniformByNumber(*radii) if isinstance(radii, tuple | list) else radii
    if grains < 1:
        raise ValueError(f"a packing needs 1 grain or more, got {grains}")
    if seed < 0:
        raise ValueError(f"a seed must be 0 or more, got {seed}")
    if dim not in (2, 3):
        raise ValueError(f"a packing has 2 or 3 dimensions, not {dim}")
    if not 0 < density < np.inf:
        raise ValueError(f"density of the grains: need a positive one (kg/m3), got {density}")
    if grains < FEWEST_GRAINS[dim]:
        raise ValueError(
            f"grains: with {grains} the box is lower than two diameters, and they meet their own"
            f" images; use more grains, {FEWEST_GRAINS[dim]} at least"
        )
    _check_target(pressure, dim, tolerance)
    if thickness is None:
        thickness = 10 * (sizes.smallest + sizes.largest) if dim == 2 else 1.0
    rng = np.random.default_rng(seed)
    compaction_law = replace(
        law, friction=compaction_friction, cohesion=0.0, rolling=None, bonds=None
    )
    dilute = _dilute(grains, dim, sizes, compaction_law, density, thickness, rng)
    # grains without friction could not bear unequal stresses: those come with the law's friction
    compacted = _compact(dilute, float(np.min(pressure)), tolerance, rng, progress)
    settled = settle(compacted.but(law=law), pressure, tolerance)
    return settled if law.bonds is None else cemented(settled)


def packing_of_void_ratio(
    void_ratio: float, tolerance: float = 2e-3, most: int = 30, **preparation
) -> Packing:
    """A random packing of a given void ratio: the compaction friction is searched for.

    Args:
        void_ratio: of the finished packing.
        tolerance: on it.
        most: packings tried at most. One random packing answers to friction with some scatter, so
            that not every value is met by every seed.
        preparation: what `random_packing` takes, but no compaction_friction.

    Raises ValueError for a void ratio that is not positive, and NotReached, with the void ratios
    reached and the packing that came closest, where none is close enough.
    """
    if not 0 < void_ratio < np.inf:
        raise ValueError(f"void ratio: need a positive one, got {void_ratio}")
    low, high = 0.0, 1.0
    tried: dict[float, Packing] = {}

    def error(friction: float) -> float:
        friction = float(friction)
        tried[friction] = random_packing(compaction_friction=friction, **preparation)
        return tried[friction].void_ratio - void_ratio

    def close() -> bool:
        return any(abs(packing.void_ratio - void_ratio) <= tolerance for packing in tried.values())

    error_low, error_high = error(low), error(high)
    if error_low * error_high < 0:
        while not close() and high - low > SCATTER and len(tried) < most:
            middle = 0.5 * (low + high)
            if error(middle) * error_low > 0:
                low = middle
            else:
                high = middle
        around = np.linspace(max(low - SCATTER, 0.0), high + SCATTER, most - len(tried))
        for friction in sorted(around, key=lambda friction: abs(friction - 0.5 * (low + high))):
            if close():
                break
            error(friction)
    best = min(tried.values(), key=lambda packing: abs(packing.void_ratio - void_ratio))
    if abs(best.void_ratio - void_ratio) > tolerance:
        reached = sorted(packing.void_ratio for packing in tried.values())
        raise NotReached(
            f"void ratio {void_ratio} was not reached: compaction friction from 0 to 1 gives"
            f" {reached[0]:.4f} to {reached[-1]:.4f}, {best.void_ratio:.4f} at best; take another"
            " seed or more grains",
            best,
        )
    return best


def library(
    count: int, seed: int = 1, void_ratio: float | None = None, **preparation
) -> Iterator[Packing]:
    """Statistically equal packings for spatial variability (Desrues section 5), one by one.

    All have the same grains, drawn with the first seed, so that they can share a `PackingBatch`;
    where the grains start and how they move differs from seed to seed.

    Args:
        count: packings.
        seed: of the first one; the others take the next ones.
        void_ratio: of each one; see `packing_of_void_ratio`.
        preparation: what `random_packing` takes.
    """
    if count < 1:
        raise ValueError(f"a library needs 1 packing or more, got {count}")
    prepare = random_packing
    if void_ratio is not None:
        prepare = partial(packing_of_void_ratio, void_ratio)
    first = prepare(seed=seed, **preparation)
    yield first
    preparation["radii"] = GivenRadii(tuple(first.radii))
    preparation["thickness"] = first.thickness if first.dim == 2 else None
    for k in range(1, count):
        yield prepare(seed=seed + k, **preparation)


def _dilute(
    grains: int, dim: int, sizes: GrainSizes, law, density: float, thickness: float, rng
) -> Packing:
    """Grains on randomly chosen places of a square lattice that is too wide for any contact."""
    columns = np.full(dim, next(n for n in count(1) if n**dim >= grains))
    columns[-1] = int(np.ceil(grains / np.prod(columns[:-1])))
    places = np.stack(np.meshgrid(*map(np.arange, columns), indexing="ij"), -1)
    places = rng.permutation(places.reshape(-1, dim))[:grains]
    spacing = 2.1 * sizes.largest
    radii = sizes.draw(grains, dim, rng)
    jitter = rng.uniform(-0.02, 0.02, (grains, dim))
    positions = (places + 0.5 + jitter) / columns
    box = np.diag(columns) * spacing
    return Packing(box, positions, radii, law, density, thickness)


def _compact(dilute: Packing, pressure: float, tolerance: float, rng, progress) -> Packing:
    """Compressed from a wide box; where contacts are very stiff, by way of a higher pressure.

    The steps that compacting takes go with the root of the stiffness level k_n / (p d), and grains
    that just jam swing ever more slowly beside them. Under more pressure both are spared, and
    going back from there is a matter of small strains: 100 disks at a level of 1e6 are ready after
    40,000 steps, where 1e6 steps did not do.
    """
    check_stiffness(dilute, pressure)
    level = dilute.stiffness_level(pressure)
    higher = pressure * max(level / STIFF, 1.0)
    packing = compress(dilute, higher, tolerance, rng, progress)
    while higher > pressure:
        higher = max(0.1 * higher, pressure)
        packing = compress(packing, higher, tolerance, progress=progress)
    return packing


def compress(
    packing: Packing,
    pressure: float | Sequence[float],
    tolerance: float = 1e-3,
    rng: np.random.Generator | None = None,
    progress: Callable[[float], None] | None = None,
) -> Packing:
    """Bring a packing to rest under a pressure, isotropic or one per axis, by moving its box.

    The box strains at the rate -(sigma + p) / (K T): K is the affine stiffness of the contacts
    that there are, T the time of `BLOCK` steps twice over; the inertial number never exceeds 0.01.
    Grains that just jam are hundreds of times softer in shear than K says: the deviator's share of
    the rate grows while that stress hardly falls, up to an inertial number of 0.001, and is halved
    where it overshoots.
    With `rng`, the grains start with random velocities, which mix a dilute packing.

    Raises ValueError for a pressure or a tolerance that cannot be reached, and NotReached for a
    pressure that is not.
    """
    _check_target(pressure, packing.dim, tolerance)
    target = np.diag(np.broadcast_to(np.asarray(pressure, dtype=float), packing.dim))
    pressure = float(np.trace(target)) / packing.dim
    material = packing.material
    work = workspace_of(packing)
    speed = np.sqrt(pressure / packing.density)
    if rng is not None:
        work.motion.velocity[:] = 0.3 * speed * rounded(rng.normal(size=work.motion.velocity.shape))
    fastest = 1e-2 * speed / packing.mean_diameter
    dt = 0.5 * stable_time_step(packing, pressure)
    rate, stress, fabric, deviator = np.zeros((4, packing.dim, packing.dim))
    softness, modulus = 1.0, packing.contact_modulus(packing.overlap_under(pressure))
    # a little above what `Packing` refuses, so that the state can be kept
    flattest = 4.4 * packing.radii.max()
    for block in range(MOST_BLOCKS):
        _must(dynamics.advance(BLOCK, dt, rate, DAMPING, material, work, material.inverse_radius))
        contacts, _ = measure(
            work.motion, work.pairs, material.law, material.cohesion, material.bonds,
            packing.thickness, stress, fabric,
        )  # fmt: skip
        net, force = dynamics.unbalance(work)
        excess = stress + target
        if np.abs(excess).max() < tolerance * pressure and net < tolerance * force:
            return packing_of(packing, work)
        mean = np.trace(excess) / packing.dim * np.eye(packing.dim)
        last, deviator = deviator, 0.5 * (excess + excess.T) - mean
        left = inner(deviator, last) / max(inner(last, last), 1e-300)
        softness = np.clip(softness * (0.5 if left < 0 else SOFTER if left > 0.98 else 1.0), 1, 1e3)
        stiffness = max(contacts, 1) / packing.size * modulus
        calm = 0.1 * fastest * 2 * stiffness * 2 * BLOCK * dt / max(np.abs(deviator).max(), 1e-300)
        softness = max(min(softness, calm), 1.0)
        rate = -(mean + softness * deviator) / (2 * stiffness * 2 * BLOCK * dt)
        rate *= min(1.0, fastest / np.abs(rate).max())
        if progress is not None and block % 20 == 0:
            progress(float(pressure_of(stress)) / pressure)
        flat = min(box_heights(work.motion.box)) < flattest
        if flat:
            break
    reached, wanted = (", ".join(f"{x:.4g}" for x in np.diag(s)) for s in (-stress, target))
    why = "; the box has flattened: the grains cannot bear these stresses, or are too few"
    why = why if flat else ""
    raise NotReached(
        f"preparation: reached {pressure_of(stress):.4g} Pa of {pressure:.4g} Pa ({reached} of"
        f" {wanted} along the axes), unbalance {net / max(force, 1e-300):.2g}, after"
        f" {(block + 1) * BLOCK} steps{why}",
        packing_of(packing, work),
    )


def check_stiffness(packing: Packing, pressure: float) -> None:
    """Raise ValueError for a pressure (Pa) under which grains are no grains in contact any more."""
    if packing.stiffness_level(pressure) < SOFTEST:
        overlap = packing.overlap_under(pressure) / packing.mean_diameter
        raise ValueError(
            f"pressure {pressure:.4g} Pa makes contacts overlap by about {overlap:.0%} of their"
            " diameter: they are too soft for it; take stiffer contacts or less pressure"
        )


def _check_target(pressure: float | Sequence[float], dim: int, tolerance: float) -> None:
    """Raise ValueError for a pressure that is not positive and a tolerance out of ]0, 1[."""
    if np.size(pressure) not in (1, dim) or not (
        np.isfinite(pressure).all() and np.min(pressure) > 0
    ):
        raise ValueError(f"pressure: give one positive value (Pa) or {dim} of them, got {pressure}")
    if not 0 < tolerance < 1:
        raise ValueError(
            f"tolerance of a pressure: it must be above 0 and below 1, got {tolerance}"
        )


def settle(packing: Packing, pressure: float | Sequence[float], tolerance: float = 1e-3) -> Packing:
    """The packing under its own contact law, at rest again under that pressure."""
    return compress(packing, pressure, tolerance)


def cemented(packing: Packing) -> Packing:
    """The packing with a bond in every contact; forces stay as they are.

    Raises ValueError where its contact law has no bonds.
    """
    if packing.law.bonds is None:
        raise ValueError(
            f"cemented: the packing's {type(packing.law).__name__} has no bonds; give it"
            " bonds=Bonds(tension=..., shear=...)"
        )
    contacts = touching(packing)
    return packing.but(
        contacts=contacts.pairs,
        tangential=contacts.tangential,
        rolling=contacts.rolling,
        bonded=np.ones(len(contacts.pairs)),
    )


def workspace_of(packing: Packing) -> dynamics.Workspace:
    """A work space with this packing, its contacts and its pair list."""
    material = packing.material
    work = dynamics.workspace(
        packing.size,
        packing.dim,
        4 * PAIRS_PER_GRAIN[packing.dim] * packing.size,
        material.viscosity is not None,
        len(packing.memory),
    )
    work.motion.box[:] = packing.box
    work.motion.position[:] = packing.positions.T
    order = np.lexsort((packing.contacts[:, 1], packing.contacts[:, 0]))
    pairs = packing.contacts[order]
    work.history.first[:] = np.searchsorted(pairs[:, 0], np.arange(packing.size + 1))
    work.history.j[: len(pairs)] = pairs[:, 1]
    work.history.tangential[:, : len(pairs)] = packing.tangential[order].T
    work.history.memory[:, : len(pairs)] = packing.memory[:, order]
    status = dynamics.start(
        work, material.radius, material.inverse_mass, material.law, material.viscosity,
        material.skin,
    )  # fmt: skip
    _must(status)
    return work


def packing_of(packing: Packing, work: dynamics.Workspace) -> Packing:
    """The packing as it now is in the work space; the other way round."""
    remember(work.pairs, work.history)
    row = work.history.first.astype(np.int64)
    contacts = np.column_stack(
        [np.repeat(np.arange(packing.size), np.diff(row)), work.history.j[: row[-1]]]
    )
    positions = work.motion.position.T
    return packing.with_contacts(
        contacts,
        work.history.tangential[:, : row[-1]],
        work.history.memory[:, : row[-1]],
        box=work.motion.box,
        positions=positions - np.floor(positions),
    )


def _must(status: int) -> None:
    if status != OK:
        raise NotReached(
            "preparation: the grains have collapsed onto each other; take stiffer contacts or less"
            " pressure"
        )
