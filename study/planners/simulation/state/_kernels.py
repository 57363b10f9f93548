"""Compiled state of the two simulations kept in step (Siebold, 2.2), and the path they leave."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from study._compiled import inner
from study._records import by_address

PROTECTED, TARGET = 1, 2  # values of `solid`
UNMILLED, BOUNDARY = 1, 2  # values of `modified`; 0 is cleared or never targeted
ROWS, LEFT, DRAWN, FULL = 0, 1, 2, 3  # entries of `counters`
NOTHING = np.int64(0)  # removed; of numpy's type: for a plain number numba would compile `record` twice


@by_address
class LiveBone(NamedTuple):
    """Sums over the unmilled target that the burr overlaps, kept for every voxel it may stand at.

    Whole numbers, so that taking voxels away one by one leaves exactly what counting again would give.
    An array that no term of the fitness asks for has no elements.
    """

    rows: np.ndarray  # int64 (m, 3): layer, depth offset and lateral reach of the burr's rows
    density: np.ndarray  # uint16 [layer, depth, lateral]: thousandths of the bone that counts as 1
    load: np.ndarray  # int32 [layer, depth, lateral]: summed density
    ahead: np.ndarray  # int32 [4, layer, depth, lateral]: voxels; sums of their layers, depths, laterals


@by_address
class Simulation(NamedTuple):
    """Everything that changes while a plan is made, in canonical order ``[layer, depth, lateral]``."""

    solid: np.ndarray  # uint8: 0 air or milled, PROTECTED, TARGET (the unmodified simulation)
    modified: np.ndarray  # uint8: UNMILLED, BOUNDARY or 0 (the modified simulation)
    allowed: np.ndarray  # bool: the burr may stand here
    crowded: np.ndarray  # bool: the supervoxel here holds a voxel the burr may not stand at
    covers: np.ndarray  # uint16: unmilled, non-boundary voxels in the supervoxel centred here
    top: np.ndarray  # uint16: targeted bone in the outer half of the burr centred here
    live: LiveBone
    element: np.ndarray  # int64 (n, 3): offsets of the voxels the burr overlaps
    top_rows: np.ndarray  # int64 (m, 3): layer, depth offset and lateral reach of the outer half's rows
    sweep_first: np.ndarray  # int64 [a, b, c, part]: where the voxels of a swept part start
    sweep_count: np.ndarray
    sweep_offsets: np.ndarray  # int16 (n, 3)
    reach: np.ndarray  # int64 (3,): supervoxel's reach in voxels
    steps: np.ndarray  # float64 (3,) mm
    shaft: tuple  # what bars the shaft: collision's `Shaft` (4 DOF), or `Pointing` (5 DOF)
    min_window: float
    min_overlap: float
    known: np.ndarray  # float64 [..., 3]: window last found by a search or an arrival, and 1; 0 if never
    path: np.ndarray  # float64 (capacity, 6): layer, depth, lateral, tilt, tip, voxels removed on arriving
    counters: np.ndarray  # int64: rows of path used, modified voxels left, random numbers drawn, path full
    left_at_depth: np.ndarray  # int64 [depth]: modified voxels left
    random: np.ndarray  # uint32, drawn in numpy


@inner
def record(sim, layer, depth, lateral, tilt, tip, removed):
    """Append a row to the path; sets the FULL counter instead when there is no room."""
    row = sim.counters[ROWS]
    if row >= sim.path.shape[0]:
        sim.counters[FULL] = 1
        return
    sim.path[row, 0], sim.path[row, 1], sim.path[row, 2] = layer, depth, lateral
    sim.path[row, 3], sim.path[row, 4], sim.path[row, 5] = tilt, tip, removed
    sim.counters[ROWS] += 1


@inner
def draw(sim, n):
    """A random number below n from those drawn in numpy."""
    value = sim.random[sim.counters[DRAWN] % sim.random.size]
    sim.counters[DRAWN] += 1
    return int(value % np.uint32(n))
