"""L D L^T of a sparse symmetric matrix of small dense blocks, one block row per grain.

The order is that of least degree: the elimination graph of a few hundred grains is small enough to
be held as it is, and gives the structure of L as it goes. Each block column of L is then computed
once, from those before it that reach into its row. Nothing is pivoted but inside the m x m
blocks. `unit` is a tuple of length m, which tells the compiler how long the inner loops are.
"""

import numpy as np

from ..aliasing import kernel


@kernel
def eliminate(size, i, j):
    """Order of least degree of the graph with the edges (i, j), and the structure of L.

    Returns (place, first, row): `place[g]` is the block row of g; block column k has diagonal and
    the rows `row[first[k]:first[k + 1]]`, rising.
    """
    linked = np.zeros((size, size), np.bool_)
    degree = np.zeros(size, np.int64)
    for c in range(len(i)):
        if not linked[i[c], j[c]]:
            linked[i[c], j[c]] = linked[j[c], i[c]] = True
            degree[i[c]] += 1
            degree[j[c]] += 1
    place = np.full(size, -1)
    first = np.zeros(size + 1, np.int64)
    row = np.empty(size * (size - 1) // 2 + 1, np.int32)
    for k in range(size):
        least, best = size + 1, -1
        for g in range(size):
            if place[g] < 0 and degree[g] < least:
                least, best = degree[g], g
        place[best] = k
        start = end = first[k]
        for g in range(size):
            if linked[best, g]:
                row[end] = g
                end += 1
        first[k + 1] = end
        for a in range(start, end):
            linked[row[a], best] = False
            degree[row[a]] -= 1
        for a in range(start, end):
            g = row[a]
            for b in range(a + 1, end):
                h = row[b]
                if not linked[g, h]:
                    linked[g, h] = linked[h, g] = True
                    degree[g] += 1
                    degree[h] += 1
    for k in range(size):
        for a in range(first[k], first[k + 1]):
            row[a] = place[row[a]]
        row[first[k] : first[k + 1]].sort()
    return place, first, row[: first[size]]


@kernel
def invert(a, unit, result):
    """result = a^-1 for an m x m block, by Gauss-Jordan elimination with pivots in each column."""
    m = len(unit)
    for p in range(m):
        for q in range(m):
            result[p, q] = 1.0 if p == q else 0.0
    for p in range(m):
        pivot = p
        for q in range(p + 1, m):
            if abs(a[q, p]) > abs(a[pivot, p]):
                pivot = q
        for r in range(m):
            a[p, r], a[pivot, r] = a[pivot, r], a[p, r]
            result[p, r], result[pivot, r] = result[pivot, r], result[p, r]
        scale = 1.0 / a[p, p]
        for r in range(m):
            a[p, r] *= scale
            result[p, r] *= scale
        for q in range(m):
            if q != p:
                times = a[q, p]
                for r in range(m):
                    a[q, r] -= times * a[p, r]
                    result[q, r] -= times * result[p, r]


@kernel
def factorise(diagonal, column, value, following, first, row, unit, below, pivot):
    """Blocks of L D below the diagonal into `below` (nnz, m, m), D^-1 into `pivot` (n, m, m).

    The matrix: `diagonal` (n, m, m), and off the diagonal the blocks `value[c]` that belong to the
    block row `column[c] = (k, i)`, i > k, linked by column in `following` (n + C,): first of
    column k at k, the one after c at n + c, -1 at the end.
    """
    n, m = len(diagonal), len(unit)
    where = np.zeros(n, np.int64)
    next_row = first.copy()  # of each column, the first entry not used yet
    reaching = np.full(n, -1)  # columns whose next row is this one, linked through `after`
    after = np.full(n, -1)
    block, times = np.empty((m, m)), np.empty((m, m))
    for k in range(n):
        start, end = first[k], first[k + 1]
        for a in range(start, end):
            where[row[a]] = a
            for p in range(m):
                for q in range(m):
                    below[a, p, q] = 0.0
        c = following[k]
        while c >= 0:
            a = where[column[c, 1]]
            for p in range(m):
                for q in range(m):
                    below[a, p, q] += value[c, p, q]
            c = following[n + c]
        for p in range(m):
            for q in range(m):
                block[p, q] = diagonal[k, p, q]
        other = reaching[k]
        while other >= 0:
            upcoming = after[other]
            here, stop = next_row[other], first[other + 1]
            for p in range(m):  # D^-1 (L D)_k^T of the other column
                for q in range(m):
                    total = 0.0
                    for r in range(m):
                        total += pivot[other, p, r] * below[here, q, r]
                    times[p, q] = total
            for p in range(m):
                for q in range(m):
                    for r in range(m):
                        block[p, q] -= below[here, p, r] * times[r, q]
            for b in range(here + 1, stop):
                a = where[row[b]]
                for p in range(m):
                    for q in range(m):
                        total = below[a, p, q]
                        for r in range(m):
                            total -= below[b, p, r] * times[r, q]
                        below[a, p, q] = total
            next_row[other] = here + 1
            if here + 1 < stop:
                target = row[here + 1]
                after[other] = reaching[target]
                reaching[target] = other
            other = upcoming
        invert(block, unit, pivot[k])
        if start < end:
            target = row[start]
            after[k] = reaching[target]
            reaching[target] = k


@kernel
def solve(first, row, below, pivot, unit, x):
    """x (n, m, s) <- (L D L^T)^-1 x."""
    n, m, s = len(pivot), len(unit), x.shape[2]
    scaled = np.empty((m, s))
    for k in range(n):
        for p in range(m):
            for v in range(s):
                total = 0.0
                for q in range(m):
                    total += pivot[k, p, q] * x[k, q, v]
                scaled[p, v] = total
        for a in range(first[k], first[k + 1]):
            i = row[a]
            for p in range(m):
                for q in range(m):
                    for v in range(s):
                        x[i, p, v] -= below[a, p, q] * scaled[q, v]
    for k in range(n - 1, -1, -1):
        scaled[:] = x[k]
        for a in range(first[k], first[k + 1]):
            i = row[a]
            for p in range(m):
                for q in range(m):
                    for v in range(s):
                        scaled[q, v] -= below[a, p, q] * x[i, p, v]
        for p in range(m):
            for v in range(s):
                total = 0.0
                for q in range(m):
                    total += pivot[k, p, q] * scaled[q, v]
                x[k, p, v] = total
