"""Verlet pair list of one periodic packing, and the contact history carried over a rebuild.

Pairs (i, j), i < j, are kept in compressed rows: those of grain i are `first[i]:first[i + 1]`. A
pair keeps its image shift, so that a step rounds nothing. The list holds all pairs closer than the
sum of their radii plus a skin, and is valid until grains have moved by the skin (`outdated`).
"""

from typing import NamedTuple

import numpy as np

from .aliasing import kernel
from .contacts import normal_stiffness


class Pairs(NamedTuple):
    """Arrays of a pair list with room for P pairs of N grains; `first[N]` of them are in use."""

    first: np.ndarray  # (N + 1,) row starts
    i: np.ndarray  # (P,)
    j: np.ndarray  # (P,)
    shift: np.ndarray  # (2, P) image of j that is near i, in boxes
    reach: np.ndarray  # (P,) sum of radii, m
    stiffness: np.ndarray  # (P,) k_n, N/m
    dashpot: np.ndarray | None  # (P,) viscous coefficient, N s/m, or None without viscosity
    tangential: np.ndarray  # (P,) tangential force on j along (-n_y, n_x), N
    anchor: np.ndarray  # (2, N) reduced positions when the list was built
    anchor_box: np.ndarray  # (2, 2) box when the list was built


class History(NamedTuple):
    """Tangential forces of touching pairs between two pair lists, in compressed rows."""

    first: np.ndarray  # (N + 1,)
    j: np.ndarray  # (C,)
    tangential: np.ndarray  # (C,) N


class Grid(NamedTuple):
    """Work space of the search: linked lists of the grains of each grid square."""

    head: np.ndarray  # (M,)
    following: np.ndarray  # (N,)
    marker: np.ndarray  # (N,)


def allocate(grains: int, capacity: int, viscous: bool) -> tuple[Pairs, History, Grid]:
    """Empty work space for a packing of that many grains and at most `capacity` pairs."""
    index, real = np.uint32, np.float64
    pairs = Pairs(
        np.zeros(grains + 1, index),
        np.zeros(capacity, index),
        np.zeros(capacity, index),
        np.zeros((2, capacity), real),
        np.zeros(capacity, real),
        np.zeros(capacity, real),
        np.zeros(capacity, real) if viscous else None,
        np.zeros(capacity, real),
        np.zeros((2, grains), real),
        np.zeros((2, 2), real),
    )
    history = History(
        np.zeros(grains + 1, index), np.zeros(capacity, index), np.zeros(capacity, real)
    )
    grid = Grid(
        np.zeros(grains + 16, np.int32), np.zeros(grains, np.int32), np.zeros(grains, np.int32)
    )
    return pairs, history, grid


@kernel
def box_heights(box):
    """Distances between opposite sides of the box, m: (height 0, height 1)."""
    area = abs(box[0, 0] * box[1, 1] - box[0, 1] * box[1, 0])
    return area / np.hypot(box[0, 1], box[1, 1]), area / np.hypot(box[0, 0], box[1, 0])


@kernel
def squares_along(height, reach, most):
    """Number of grid squares across the box, 1 where the 3 x 3 stencil would meet itself."""
    squares = min(int(height / reach), most)
    return squares if squares >= 3 else 1


@kernel
def square_of(coordinate, squares):
    """Grid square of a reduced coordinate, which may lie outside [0, 1[."""
    return min(int((coordinate - np.floor(coordinate)) * squares), squares - 1)


@kernel
def build(box, position, radius, inverse_mass, constant, modulus, viscosity, skin, pairs, grid):
    """Fill the pair list for these positions; tangential forces are zero.

    Returns the number of pairs, or -1 where `pairs` has no room for them.
    """
    grains = radius.size
    reach = 2.0 * radius.max() + skin
    height_0, height_1 = box_heights(box)
    most = int(np.sqrt(grid.head.size))
    nx, ny = squares_along(height_0, reach, most), squares_along(height_1, reach, most)
    grid.head[: nx * ny] = -1
    for i in range(grains - 1, -1, -1):
        square = square_of(position[0, i], nx) * ny + square_of(position[1, i], ny)
        grid.following[i] = grid.head[square]
        grid.head[square] = i
    reach_x, reach_y = (1 if nx > 1 else 0), (1 if ny > 1 else 0)
    count = 0
    for i in range(grains):
        pairs.first[i] = count
        column, row = square_of(position[0, i], nx), square_of(position[1, i], ny)
        for a in range(column - reach_x, column + reach_x + 1):
            for b in range(row - reach_y, row + reach_y + 1):
                j = grid.head[((a + nx) % nx) * ny + (b + ny) % ny]
                while j >= 0:
                    if j > i:
                        if count == pairs.i.size:
                            return -1
                        count += add_pair(i, j, count, box, position, radius, skin, pairs)
                    j = grid.following[j]
    pairs.first[grains] = count
    for c in range(count):
        i, j = pairs.i[c], pairs.j[c]
        pairs.stiffness[c] = normal_stiffness(radius[i], radius[j], constant, modulus)
        if viscosity is not None:
            reduced_mass = 1.0 / (inverse_mass[i] + inverse_mass[j])
            pairs.dashpot[c] = 2.0 * viscosity * np.sqrt(pairs.stiffness[c] * reduced_mass)
    pairs.anchor[:] = position
    pairs.anchor_box[:] = box
    return count


@kernel
def add_pair(i, j, c, box, position, radius, skin, pairs):
    """Write pair (i, j) at place c if its nearest images are close enough; returns 1 or 0."""
    sx, sy = position[0, j] - position[0, i], position[1, j] - position[1, i]
    shift_x, shift_y = -np.rint(sx), -np.rint(sy)
    sx, sy = sx + shift_x, sy + shift_y
    bx, by = box[0, 0] * sx + box[0, 1] * sy, box[1, 0] * sx + box[1, 1] * sy
    reach = radius[i] + radius[j]
    if bx * bx + by * by >= (reach + skin) ** 2:
        return 0
    pairs.i[c], pairs.j[c] = i, j
    pairs.shift[0, c], pairs.shift[1, c] = shift_x, shift_y
    pairs.reach[c] = reach
    pairs.tangential[c] = 0.0
    return 1


@kernel
def outdated(box, position, longest_reach, skin, pairs):
    """Share of the skin that the motion since the last build has used up; 1 means rebuild.

    A pair outside the list was at |b0| >= reach + skin. Its branch is now b = F b0 + h (d_j - d_i),
    with F the box's own deformation and d the reduced displacements, hence no shorter than
    s |b0| - 2 max |h d| with s the smallest singular value of F.
    """
    h00, h01, h10, h11 = box[0, 0], box[0, 1], box[1, 0], box[1, 1]
    largest = 0.0
    for i in range(position.shape[1]):
        sx, sy = position[0, i] - pairs.anchor[0, i], position[1, i] - pairs.anchor[1, i]
        dx, dy = h00 * sx + h01 * sy, h10 * sx + h11 * sy
        largest = max(largest, dx * dx + dy * dy)
    shrinkage = max(1.0 - smallest_stretch(box, pairs.anchor_box), 0.0)
    return (2.0 * np.sqrt(largest) + shrinkage * (longest_reach + skin)) / skin


@kernel
def smallest_stretch(box, anchor_box):
    """Smallest singular value of F = h h0^-1."""
    e, f, g, h = anchor_box[0, 0], anchor_box[0, 1], anchor_box[1, 0], anchor_box[1, 1]
    det = e * h - f * g
    f00 = (box[0, 0] * h - box[0, 1] * g) / det
    f01 = (box[0, 1] * e - box[0, 0] * f) / det
    f10 = (box[1, 0] * h - box[1, 1] * g) / det
    f11 = (box[1, 1] * e - box[1, 0] * f) / det
    return 0.5 * (np.hypot(f00 + f11, f10 - f01) - np.hypot(f00 - f11, f10 + f01))


@kernel
def remember(pairs, history):
    """Store the tangential forces of the pair list, those that are not zero."""
    grains = pairs.first.size - 1
    count = 0
    for i in range(grains):
        history.first[i] = count
        for c in range(pairs.first[i], pairs.first[i + 1]):
            if pairs.tangential[c] != 0.0:
                history.j[count] = pairs.j[c]
                history.tangential[count] = pairs.tangential[c]
                count += 1
    history.first[grains] = count


@kernel
def recall(pairs, history, grid):
    """Give the pairs of the list the tangential forces that the history holds for them."""
    grains = pairs.first.size - 1
    marker = grid.marker
    marker[:] = -1
    for i in range(grains):
        for c in range(history.first[i], history.first[i + 1]):
            marker[history.j[c]] = c
        for c in range(pairs.first[i], pairs.first[i + 1]):
            old = marker[pairs.j[c]]
            pairs.tangential[c] = history.tangential[old] if old >= 0 else 0.0
        for c in range(history.first[i], history.first[i + 1]):
            marker[history.j[c]] = -1
