"""Triangles that cross each other, and the voxels that a mesh encloses, in numpy alone; for `anatomy.py`."""

import numpy as np

# Of the sum of the magnitudes of a determinant's products: below it, the sign is found in whole numbers.
ROUNDING = 1e-14
# Coordinates are float32 of some metres: in these parts of a metre they are whole numbers. Smaller parts are cut off.
PARTS = 2.0**60


def determinants(rows):
    a, b, c = rows
    plus = (a[:, 0] * b[:, 1] * c[:, 2], a[:, 1] * b[:, 2] * c[:, 0], a[:, 2] * b[:, 0] * c[:, 1])
    minus = (a[:, 2] * b[:, 1] * c[:, 0], a[:, 0] * b[:, 2] * c[:, 1], a[:, 1] * b[:, 0] * c[:, 2])
    return sum(plus) - sum(minus), sum(map(abs, plus)) + sum(map(abs, minus))


def sides(a, b, c, p):
    """On which side of the plane through a, b and c each p lies, exactly: -1, 0 or 1."""
    value, size = determinants((b - a, c - a, p - a))
    signs = np.sign(value).astype(int)
    unsure = np.abs(value) <= ROUNDING * size
    if unsure.any():
        whole = np.vectorize(int, otypes=[object])
        a, b, c, p = (whole(points[unsure] * PARTS) for points in (a, b, c, p))
        exact, _ = determinants((b - a, c - a, p - a))
        signs[unsure] = [(value > 0) - (value < 0) for value in exact]
    return signs


def pierced(first, second):
    """Whether an edge of a triangle of `first`, (n, 3, 3), runs through the inside of its triangle of `second`."""
    a, b, c = (second[:, k] for k in range(3))
    ends = [sides(a, b, c, first[:, k]) for k in range(3)]
    found = np.zeros(len(first), dtype=bool)
    for k in range(3):
        after = (k + 1) % 3
        at = np.flatnonzero(~found & (ends[k] * ends[after] < 0))
        if len(at):
            p, q = first[at, k], first[at, after]
            turns = np.array([sides(p, q, x[at], y[at]) for x, y in ((a, b), (b, c), (c, a))])
            found[at] = np.abs(turns.sum(axis=0)) == 3
    return found


def near_pairs(corners, low, high, start, count):
    """Pairs (i, j), i < j, whose boxes overlap, with i in [start, start + count)."""
    some = slice(start, start + count)
    overlap = np.arange(len(corners))[None, :] > np.arange(len(corners))[some, None]
    for axis in range(3):
        overlap &= low[some, None, axis] <= high[None, :, axis]
        overlap &= high[some, None, axis] >= low[None, :, axis]
    i, j = np.nonzero(overlap)
    return i + start, j


def crossings(vertices, faces, at_once=256):
    """Pairs of triangles of a mesh that cross, and how many were looked at: all whose boxes overlap and that have no edge in common. An
    edge of the one runs through the inside of the other; what touches without crossing does not count."""
    corners = np.asarray(vertices, dtype=float)[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    found, looked_at = [], 0
    for start in range(0, len(faces), at_once):
        i, j = near_pairs(corners, low, high, start, at_once)
        apart = (faces[i][:, :, None] == faces[j][:, None, :]).sum(axis=(1, 2)) < 2
        i, j = i[apart], j[apart]
        looked_at += len(i)
        cross = pierced(corners[i], corners[j]) | pierced(corners[j], corners[i])
        found.extend(zip(i[cross].tolist(), j[cross].tolist()))
    return found, looked_at


def voxelised(vertices, faces, shape):
    """Which voxels' middles lie inside a closed mesh that is given in voxel coordinates: by rays along the last axis."""
    flips = np.zeros((*shape[:2], shape[2] + 1), dtype=np.int32)
    # Beside the middles, so that no ray meets a vertex.
    aside = np.array([1.3e-7, 2.9e-7])
    for a, b, c in np.asarray(vertices, dtype=float)[faces]:
        low = np.maximum(np.ceil(np.min([a, b, c], axis=0)[:2] - 1e-6), 0).astype(int)
        high = np.minimum(np.floor(np.max([a, b, c], axis=0)[:2] + 1e-6), np.array(shape[:2]) - 1).astype(int)
        if (low > high).any():
            continue
        x, y = np.mgrid[low[0] : high[0] + 1, low[1] : high[1] + 1]
        px, py = x + aside[0], y + aside[1]

        def turn(p, q):
            sign = 1.0 if (p[0], p[1]) < (q[0], q[1]) else -1.0
            p, q = (p, q) if sign > 0 else (q, p)
            return sign * ((q[0] - p[0]) * (py - p[1]) - (q[1] - p[1]) * (px - p[0]))

        u, v, w = turn(b, c), turn(c, a), turn(a, b)
        hit = ((u > 0) & (v > 0) & (w > 0)) | ((u < 0) & (v < 0) & (w < 0))
        if hit.any():
            z = (u[hit] * a[2] + v[hit] * b[2] + w[hit] * c[2]) / (u + v + w)[hit]
            np.add.at(flips, (x[hit], y[hit], np.clip(np.ceil(z), 0, shape[2]).astype(int)), 1)
    return np.cumsum(flips, axis=2)[:, :, :-1] % 2 == 1


def dice(one, other):
    return 2.0 * np.count_nonzero(one & other) / (np.count_nonzero(one) + np.count_nonzero(other))
