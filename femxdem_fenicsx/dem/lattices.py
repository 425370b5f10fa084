"""Regular packings: disks on a triangular lattice, spheres on the densest one."""

from collections.abc import Sequence
from itertools import count

import numpy as np

from .contacts import ContactLaw
from .packing import Packing
from .preparation import GUO_ZHAO, cemented, compress

#: Overlap that the compression starts from, as a share of the diameter.
TOUCHING = 1e-6


def hexagonal_packing(
    grains: int = 400,
    radius: float = 5e-3,
    law: ContactLaw | None = None,
    pressure: float | Sequence[float] = 1e5,
    density: float = 2650.0,
    thickness: float | None = None,
    dim: int = 2,
    tolerance: float = 1e-3,
) -> Packing:
    """Equal grains, every one with 6 neighbours (disks, Guo-Zhao section 4.1.4) or 12 (spheres).

    Rows of disks lie along x. Spheres stand on a face-centred cubic lattice whose cube is the
    axes'. The box is as close to a square or a cube as `grains` allows.

    Args:
        grains: at least; the lattice has the next number of them that fills its box.
        radius: m.
        law: contact law; Guo-Zhao's by default. Where it has bonds, all contacts are cemented.
        pressure: Pa, compression positive; isotropic, or one value per axis.
        density: kg/m3.
        thickness: m; 20 radii by default for disks, spheres have none.
        dim: 2 or 3.
        tolerance: on every stress component over the pressure.

    Raises:
        ValueError: for values that make no packing.
        NotReached: if the pressure is not reached, e.g. since the lattice gives way under unequal
            pressures.
    """
    if grains < 1:
        raise ValueError(f"a packing needs 1 grain or more, got {grains}")
    if not 0 < radius < np.inf:
        raise ValueError(f"radius: need a positive one (m), got {radius}")
    if dim not in (2, 3):
        raise ValueError(f"a packing has 2 or 3 dimensions, not {dim}")
    places, box = _triangular(grains) if dim == 2 else _face_centred(grains)
    if thickness is None:
        thickness = 20 * radius if dim == 2 else 1.0
    law = law or GUO_ZHAO
    packing = Packing(
        np.diag(box) * 2 * radius * (1 - TOUCHING), places, np.full(len(places), radius),
        law, density, thickness,
    )  # fmt: skip
    at_rest = compress(packing, pressure, tolerance)
    return at_rest if law.bonds is None else cemented(at_rest)


def _triangular(grains: int) -> tuple[np.ndarray, np.ndarray]:
    """Reduced places (N, 2) and sides of the box over the diameter; an even number of rows."""
    rows = max(2 * round(np.sqrt(grains / np.sqrt(0.75)) / 2), 2)
    columns = int(np.ceil(grains / rows))
    i, j = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    places = np.stack([(i + 0.5 * (j % 2)) / columns, j / rows], -1).reshape(-1, 2)
    return places, np.array([columns, rows * np.sqrt(0.75)])


def _face_centred(grains: int) -> tuple[np.ndarray, np.ndarray]:
    """Reduced places (N, 3) and sides of the box over the diameter; 4 spheres per cube."""
    cubes = next(n for n in count(1) if 4 * n**3 >= grains)
    corner = np.array([[0, 0, 0], [0.5, 0.5, 0], [0.5, 0, 0.5], [0, 0.5, 0.5]])
    cells = np.array(list(np.ndindex(cubes, cubes, cubes)))
    places = (cells[:, None] + corner).reshape(-1, 3) / cubes
    return places, np.full(3, cubes * np.sqrt(2.0))
