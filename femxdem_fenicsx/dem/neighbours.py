"""Verlet pair list of one periodic packing, and the contact history carried over a rebuild.

Pairs (i, j), i < j, are kept in compressed rows: those of grain i are `first[i]:first[i + 1]`. A
pair keeps its image shift, so that a step rounds nothing. The list holds all pairs closer than the
sum of their radii plus a skin, and is valid until grains have moved by the skin (`outdated`).
"""

from typing import NamedTuple

import numpy as np

from .aliasing import kernel
from .contacts.interface import coefficient
from .small import inverse, least_stretch, product


class Pairs(NamedTuple):
    """Arrays of a pair list with room for P pairs of N grains in d dimensions.

    `first[N]` of them are in use. A tangential force has q components: one along (-n_y, n_x) in
    two dimensions, three in three.
    """

    first: np.ndarray  # (N + 1,) row starts
    i: np.ndarray  # (P,)
    j: np.ndarray  # (P,)
    shift: np.ndarray  # (d, P) image of j that is near i, in boxes
    reach: np.ndarray  # (P,) sum of radii, m
    coefficient: np.ndarray  # (P,) what the contact law makes of the radii; linear: k_n, N/m
    dashpot: np.ndarray | None  # (P,) viscous coefficient over sqrt(k_n), kg^0.5; or None
    tangential: np.ndarray  # (q, P) tangential force on j, N
    memory: np.ndarray  # (m, P) what else the law remembers (`ContactLaw.memory`)
    normal: np.ndarray | None  # (3, P) n of the last step, of spheres
    anchor: np.ndarray  # (d, N) reduced positions when the list was built
    anchor_box: np.ndarray  # (d, d) box when the list was built


class History(NamedTuple):
    """What contacts remember between two pair lists, in compressed rows."""

    first: np.ndarray  # (N + 1,)
    j: np.ndarray  # (C,)
    tangential: np.ndarray  # (q, C) N
    memory: np.ndarray  # (m, C)


class Grid(NamedTuple):
    """Work space of the search: linked lists of the grains of each cell of a grid."""

    head: np.ndarray  # (M,)
    following: np.ndarray  # (N,)
    cell: np.ndarray  # (d, N)
    place: np.ndarray  # (d, N) wrapped into the box, m
    marker: np.ndarray  # (N,)
    stencil: np.ndarray  # ((3^d + 1) / 2, d) steps to the cell itself and half of its neighbours
    found: np.ndarray  # (3, P) pairs in the order of the search: i, j, step of the stencil


def allocate(
    grains: int, dim: int, capacity: int, viscous: bool, memory: int = 0
) -> tuple[Pairs, History, Grid]:
    """Empty work space for a packing of that many grains and at most `capacity` pairs.

    `memory`: how many values a contact remembers beside its tangential force.
    """
    index, real = np.uint32, np.float64
    components = 1 if dim == 2 else 3
    pairs = Pairs(
        np.zeros(grains + 1, index),
        np.zeros(capacity, index),
        np.zeros(capacity, index),
        np.zeros((dim, capacity), real),
        np.zeros(capacity, real),
        np.zeros(capacity, real),
        np.zeros(capacity, real) if viscous else None,
        np.zeros((components, capacity), real),
        np.zeros((memory, capacity), real),
        np.zeros((3, capacity), real) if dim == 3 else None,
        np.zeros((dim, grains), real),
        np.zeros((dim, dim), real),
    )
    history = History(
        np.zeros(grains + 1, index),
        np.zeros(capacity, index),
        np.zeros((components, capacity), real),
        np.zeros((memory, capacity), real),
    )
    grid = Grid(
        np.zeros(grains + 16, np.int32),
        np.zeros(grains, np.int32),
        np.zeros((dim, grains), np.int32),
        np.zeros((dim, grains), real),
        np.zeros(grains, np.int32),
        np.array([step for step in np.ndindex(*[3] * dim) if step >= (1,) * dim]) - 1,
        np.zeros((3, capacity), np.int32),
    )
    return pairs, history, grid


@kernel
def box_heights(box):
    """Distances between opposite sides of the box (d,), m."""
    rows = inverse(box)
    heights = np.empty(len(box))
    for a in range(len(box)):
        squared = 0.0
        for b in range(len(box)):
            squared += rows[a, b] ** 2
        heights[a] = 1.0 / np.sqrt(squared)
    return heights


@kernel
def build(box, position, radius, inverse_mass, law, viscosity, skin, pairs, grid):
    """Fill the pair list for these positions; contacts remember nothing.

    Returns the number of pairs, or -1 where `pairs` has no room for them.
    """
    cells = fill_grid(box, position, 2.0 * radius.max() + skin, grid)
    count = search(box, position, radius, skin, cells, pairs, grid)
    if count < 0:
        return count
    pairs.tangential[:, :count] = 0.0
    pairs.memory[:, :count] = 0.0
    for c in range(count):
        i, j = pairs.i[c], pairs.j[c]
        pairs.reach[c] = radius[i] + radius[j]
        pairs.coefficient[c] = coefficient(law, radius[i], radius[j])
        if viscosity is not None:
            reduced_mass = 1.0 / (inverse_mass[i] + inverse_mass[j])
            pairs.dashpot[c] = 2.0 * viscosity * np.sqrt(reduced_mass)
    point_along_branches(count, box, position, pairs, pairs.normal)
    pairs.anchor[:] = position
    pairs.anchor_box[:] = box
    return count


@kernel
def point_along_branches(count, box, position, pairs, normal):
    """Set the normals that turn the tangential forces of spheres in the first step to come."""
    if normal is not None:
        for c in range(count):
            i, j = pairs.i[c], pairs.j[c]
            squared = 0.0
            for a in range(3):
                normal[a, c] = 0.0
                for b in range(3):
                    normal[a, c] += box[a, b] * (
                        position[b, j] - position[b, i] + pairs.shift[b, c]
                    )
                squared += normal[a, c] ** 2
            for a in range(3):
                normal[a, c] /= np.sqrt(squared)


@kernel
def fill_grid(box, position, reach, grid):
    """Sort the grains into cells no narrower than `reach`; numbers of cells along the box (d,)."""
    dim, grains = position.shape
    heights = box_heights(box)
    most = 1
    while (most + 1) ** dim <= grid.head.size:
        most += 1
    cells = np.empty(dim, np.int64)
    total = 1
    for a in range(dim):
        cells[a] = max(1, min(most, int(heights[a] / reach)))
        total *= cells[a]
    grid.head[:total] = -1
    for i in range(grains - 1, -1, -1):
        number = 0
        for a in range(dim):
            wrapped = position[a, i] - np.floor(position[a, i])
            grid.cell[a, i] = min(int(wrapped * cells[a]), cells[a] - 1)
            number = number * cells[a] + grid.cell[a, i]
        for a in range(dim):
            grid.place[a, i] = 0.0
            for b in range(dim):
                grid.place[a, i] += box[a, b] * (position[b, i] - np.floor(position[b, i]))
        grid.following[i] = grid.head[number]
        grid.head[number] = i
    return cells


@kernel
def search(box, position, radius, skin, cells, pairs, grid):
    """Find all close pairs and sort them into rows; the number of pairs, or -1: no room."""
    count = find_pairs(box, radius, skin, cells, grid)
    if count < 0:
        return count
    first, found = pairs.first, grid.found
    first[:] = 0
    for c in range(count):
        first[found[0, c] + 1] += 1
    for i in range(radius.size):
        first[i + 1] += first[i]
    grid.marker[:] = 0  # pairs of the row so far
    for c in range(count):
        i, j = found[0, c], found[1, c]
        place = first[i] + grid.marker[i]
        grid.marker[i] += 1
        pairs.i[place], pairs.j[place] = i, j
        for a in range(position.shape[0]):
            wraps = np.floor(position[a, i]) - np.floor(position[a, j])
            pairs.shift[a, place] = wraps + image_of(found[2, c], a, i, cells, grid)
    return count


@kernel
def image_of(step, axis, grain, cells, grid):
    """-1, 0 or 1 boxes: where a grain's neighbour cell lies; steps count from 1, back from -1."""
    way = grid.stencil[abs(step) - 1, axis] * (1 if step > 0 else -1)
    cell = grid.cell[axis, grain] + way
    return -1.0 if cell < 0 else (1.0 if cell >= cells[axis] else 0.0)


@kernel
def find_pairs(box, radius, skin, cells, grid):
    """Pairs of grains of a cell, and of a cell and half of its neighbours, into `grid.found`.

    A neighbour beyond the border is an image of the cell on the other side, so that few cells
    along the box, or one, need no special care. Returns their number, or -1: no room.
    """
    dim, total = len(cells), 1
    for a in range(dim):
        total *= cells[a]
    place, following, found = grid.place, grid.following, grid.found
    offset = np.zeros(3)
    count = 0
    for number in range(total):
        head = grid.head[number]
        if head < 0:
            continue
        for step in range(len(grid.stencil)):
            other = 0
            offset[:] = 0.0
            for a in range(dim):
                cell = grid.cell[a, head] + grid.stencil[step, a]
                image = 0
                if cell < 0:
                    image = -1
                elif cell >= cells[a]:
                    image = 1
                if image != 0:
                    cell -= image * cells[a]
                    for b in range(dim):
                        offset[b] += box[b, a] * image
                other = other * cells[a] + cell
            i = head
            while i >= 0:
                j = following[i] if step == 0 else grid.head[other]
                x, y = offset[0] - place[0, i], offset[1] - place[1, i]
                z = offset[2] - place[2, i] if dim == 3 else 0.0
                while j >= 0:
                    squared = (place[0, j] + x) ** 2 + (place[1, j] + y) ** 2
                    if dim == 3:
                        squared += (place[2, j] + z) ** 2
                    if squared < (radius[i] + radius[j] + skin) ** 2 and i != j:
                        if count == found.shape[1]:
                            return -1
                        found[0, count], found[1, count] = min(i, j), max(i, j)
                        found[2, count] = step + 1 if i < j else -step - 1
                        count += 1
                    j = following[j]
                i = following[i]
    return count


@kernel
def outdated(box, position, longest_reach, skin, pairs):
    """Share of the skin that the motion since the last build has used up; 1 means rebuild.

    A pair outside the list was at |b0| >= reach + skin. Its branch is now b = F b0 + h (d_j - d_i),
    with F the box's own deformation and d the reduced displacements, hence no shorter than
    s |b0| - 2 max |h d| with s the least stretch of F.
    """
    anchor = pairs.anchor
    largest = 0.0
    for i in range(position.shape[1]):
        x, y, z = position[0, i] - anchor[0, i], position[1, i] - anchor[1, i], 0.0
        dx, dy, dz = box[0, 0] * x + box[0, 1] * y, box[1, 0] * x + box[1, 1] * y, 0.0
        if position.shape[0] == 3:
            z = position[2, i] - anchor[2, i]
            dx, dy = dx + box[0, 2] * z, dy + box[1, 2] * z
            dz = box[2, 0] * x + box[2, 1] * y + box[2, 2] * z
        largest = max(largest, dx * dx + dy * dy + dz * dz)
    shrinkage = max(1.0 - least_stretch(product(box, inverse(pairs.anchor_box))), 0.0)
    return (2.0 * np.sqrt(largest) + shrinkage * (longest_reach + skin)) / skin


@kernel
def any_in(values, column):
    """Whether a column of an array (rows, n) holds anything but zeros."""
    for a in range(values.shape[0]):
        if values[a, column] != 0.0:
            return True
    return False


@kernel
def copy(source, column, target, place):
    """Column of one array (rows, n) into a column of another."""
    for a in range(source.shape[0]):
        target[a, place] = source[a, column]


@kernel
def remember(pairs, history):
    """Store what the contacts of the pair list remember, those that remember anything."""
    grains = pairs.first.size - 1
    count = 0
    for i in range(grains):
        history.first[i] = count
        for c in range(pairs.first[i], pairs.first[i + 1]):
            if any_in(pairs.tangential, c) or any_in(pairs.memory, c):
                history.j[count] = pairs.j[c]
                copy(pairs.tangential, c, history.tangential, count)
                copy(pairs.memory, c, history.memory, count)
                count += 1
    history.first[grains] = count


@kernel
def recall(pairs, history, grid):
    """Give the pairs of the list what the history holds for them."""
    grains = pairs.first.size - 1
    marker = grid.marker
    marker[:] = -1
    for i in range(grains):
        for c in range(history.first[i], history.first[i + 1]):
            marker[history.j[c]] = c
        for c in range(pairs.first[i], pairs.first[i + 1]):
            old = marker[pairs.j[c]]
            if old >= 0:
                copy(history.tangential, old, pairs.tangential, c)
                copy(history.memory, old, pairs.memory, c)
        for c in range(history.first[i], history.first[i + 1]):
            marker[history.j[c]] = -1
