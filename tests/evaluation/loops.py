"""The metrics as plain loops over sorted pairs: slow, and as close to the definitions as code can be."""

from __future__ import annotations

import math


def greedy(distance, limit=math.inf):
    """All pairs by (distance, row, column); take each one whose row and column are free."""
    pairs = [
        (distance[i][j], i, j)
        for i in range(len(distance))
        for j in range(len(distance[i]))
        if not math.isnan(distance[i][j]) and distance[i][j] <= limit and not math.isinf(distance[i][j])
    ]
    rows, columns, taken = set(), set(), []
    for _, i, j in sorted(pairs):
        if i not in rows and j not in columns:
            rows.add(i)
            columns.add(j)
            taken.append((i, j))
    return sorted(taken)


def project(matrix, point):
    """A homography of one point, or None behind the horizon."""
    x, y = float(point[0]), float(point[1])
    u, v, w = (row[0] * x + row[1] * y + row[2] for row in matrix)
    return (u / w, v / w) if w > 1e-12 else None


def is_inside(point, size):
    return point is not None and all(-0.5 <= c < s - 0.5 for c, s in zip(point, size, strict=True))


def rep_and_ms(p1, p2, d1, d2, matrix, inverse, size1, size2, eps):
    """Repeatability and matching score by the paper's section 4.1."""
    keep1 = [i for i, p in enumerate(p1) if is_inside(project(matrix, p), size2)]
    keep2 = [j for j, p in enumerate(p2) if is_inside(project(inverse, p), size1)]
    least = min(len(keep1), len(keep2))
    if least == 0:
        return 0.0, 0.0
    place = [[math.dist(project(matrix, p1[i]), [float(c) for c in p2[j]]) for j in keep2] for i in keep1]
    look = [
        [math.sqrt(sum((float(a) - float(b)) ** 2 for a, b in zip(d1[i], d2[j], strict=True))) for j in keep2]
        for i in keep1
    ]
    in_place, by_descriptor = greedy(place, eps), set(greedy(look))
    both = [pair for pair in in_place if pair in by_descriptor]
    return len(in_place) / least, len(both) / least
