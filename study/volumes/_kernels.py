"""Compiled loops over voxels: distances from voxel centres to voxel boxes."""

from __future__ import annotations

import numba as nb
import numpy as np


@nb.njit(cache=True)
def _pass_along_last_axis(field, weights, out):
    reach = weights.size - 1
    n0, n1, n2 = field.shape
    row = np.empty(n2)
    for i in range(n0):
        for j in range(n1):
            empty = True
            for k in range(n2):
                row[k] = np.inf
                if field[i, j, k] != np.inf:
                    empty = False
            if not empty:
                for k in range(n2):
                    value = field[i, j, k]
                    if value == np.inf:
                        continue
                    for m in range(max(0, k - reach), min(n2, k + reach + 1)):
                        candidate = value + weights[abs(m - k)]
                        if candidate < row[m]:
                            row[m] = candidate
            for k in range(n2):
                out[i, j, k] = row[k]


@nb.njit(cache=True)
def _pass_across_rows(field, weights, out):
    # Along the middle axis, whole rows at a time, so that the inner loop vectorises.
    reach = weights.size - 1
    n0, n1, n2 = field.shape
    for i in range(n0):
        filled = np.zeros(n1, np.bool_)
        for j in range(n1):
            for k in range(n2):
                out[i, j, k] = np.inf
                if field[i, j, k] != np.inf:
                    filled[j] = True
        for j in range(n1):
            if not filled[j]:
                continue
            for m in range(max(0, j - reach), min(n1, j + reach + 1)):
                weight = weights[abs(m - j)]
                for k in range(n2):
                    candidate = field[i, j, k] + weight
                    if candidate < out[i, m, k]:
                        out[i, m, k] = candidate


@nb.njit(cache=True)
def _pass_across_slabs(field, weights, out):
    reach = weights.size - 1
    n0, n1, n2 = field.shape
    for i in range(n0):
        for j in range(n1):
            for k in range(n2):
                out[i, j, k] = np.inf
    for i in range(n0):
        for j in range(n1):
            filled = False
            for k in range(n2):
                if field[i, j, k] != np.inf:
                    filled = True
                    break
            if not filled:
                continue
            for m in range(max(0, i - reach), min(n0, i + reach + 1)):
                weight = weights[abs(m - i)]
                for k in range(n2):
                    candidate = field[i, j, k] + weight
                    if candidate < out[m, j, k]:
                        out[m, j, k] = candidate


@nb.njit(cache=True)
def squared_distance_to_boxes(mask, weights0, weights1, weights2):
    """Squared mm from every voxel centre to the nearest voxel box of `mask`, exact up to the reach.

    ``weights_n[d]`` is the squared distance along axis n from a centre to a box d voxels away; the
    sum over axes is separable, so three passes of a truncated minimum suffice.
    """
    n0, n1, n2 = mask.shape
    first = np.empty((n0, n1, n2))
    second = np.empty((n0, n1, n2))
    for i in range(n0):
        for j in range(n1):
            for k in range(n2):
                first[i, j, k] = 0.0 if mask[i, j, k] else np.inf
    _pass_along_last_axis(first, weights2, second)
    _pass_across_rows(second, weights1, first)
    _pass_across_slabs(first, weights0, second)
    return second
