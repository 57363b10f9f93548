"""Compiled loops over voxels: dilation by an element made of centred rows."""

from __future__ import annotations

import numpy as np

from study._compiled import inner, kernel


@inner
def _widened_rows(mask, reach, out):
    """``out[w]`` is `mask` dilated by w voxels along its last axis, for w = 0..reach."""
    n0, n1, n2 = mask.shape
    distance = np.empty(n2, np.int64)
    for i in range(n0):
        for j in range(n1):
            since = reach + 1
            for k in range(n2):
                since = 0 if mask[i, j, k] else since + 1
                distance[k] = since
            since = reach + 1
            for k in range(n2 - 1, -1, -1):
                since = 0 if mask[i, j, k] else since + 1
                distance[k] = min(distance[k], since)
            for w in range(reach + 1):
                for k in range(n2):
                    out[w, i, j, k] = distance[k] <= w


@kernel
def dilate_by_rows(mask, rows, reach):
    """Dilate a uint8 mask by the element whose rows are (offset, offset, reach along the last axis).

    Bytes, not booleans: only then does the innermost loop vectorise.
    """
    n0, n1, n2 = mask.shape
    widened = np.empty((reach + 1, n0, n1, n2), np.uint8)
    _widened_rows(mask, reach, widened)
    out = np.zeros((n0, n1, n2), np.uint8)
    filled = np.zeros((n0, n1), np.bool_)
    for i in range(n0):
        for j in range(n1):
            for k in range(n2):
                if mask[i, j, k]:
                    filled[i, j] = True
                    break
    for i in range(n0):
        for j in range(n1):
            for r in range(rows.shape[0]):
                p, q = i - rows[r, 0], j - rows[r, 1]
                if 0 <= p < n0 and 0 <= q < n1 and filled[p, q]:
                    row = widened[rows[r, 2], p, q]
                    for k in range(n2):
                        out[i, j, k] |= row[k]
    return out
