"""How fast shafts are checked against bone: octree and GJK of the dissertation, through `coal`, one thread.

Run with ``python benchmarks/collision.py [volume files]``; without files the real bones are used when
they are there, else one of the procedural specimens. The bone is half milled, the burr stands at
positions that the plan goes to next, and the windows are those of 2.3.3: 18 x 18 directions within 2.5
degrees of a shaft.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.planning import cases
from study.collision import Drill
from study.collision.octree import OctreeCheck, surface_voxels
from study.planners import plan_path
from study.rendering import milling_frames
from study.volumes import LabelVolume, ball_element

SIDE, HALF_DEG = 18, 2.5
#: How far the windows' middles are turned from the plan's shaft: the text's windows, and any.
SPREADS_DEG = (0.0, 20.0)


@dataclass(frozen=True, eq=False)
class Windows:
    """Half milled bone, burr positions in it, and a window of directions at each.

    The index frame is canonical: axis 1 goes into the bone. Direction (a, b) of window n is
    (sin tip, -cos tip cos tilt, cos tip sin tilt) with tilt ``tilts[n, a]`` and tip ``tips[n, b]``.

    Attributes
    ----------
    solid : (nx, ny, nz) uint8 array
        Bone left; the burr overlaps none of it at any of the positions.
    spacing : (3,) array
        mm; cubes of the bone's mean voxel size.
    drill : Drill
    positions : (n, 3) array
        mm of the index frame.
    tilts, tips : (n, 18) arrays
        Radians.
    """

    solid: np.ndarray
    spacing: np.ndarray
    drill: Drill
    positions: np.ndarray
    tilts: np.ndarray
    tips: np.ndarray

    @property
    def axes(self) -> np.ndarray:
        """(n, 324, 3) unit vectors from the burr towards the drill's body."""
        tilt, tip = self.tilts[:, :, None], self.tips[:, None, :]
        vectors = [np.sin(tip) + 0 * tilt, -np.cos(tip) * np.cos(tilt), np.cos(tip) * np.sin(tilt)]
        return np.stack(vectors, axis=-1).reshape(len(self.positions), -1, 3)


def half_milled_windows(volume: LabelVolume, n: int = 100, spread_deg: float = 20.0, rng=0) -> Windows:
    """Windows at `n` positions that a 4-DOF plan goes to after half of its bone has been milled.

    They are aimed along the plan's shaft, turned by up to `spread_deg` both ways, so that some are free,
    some blocked and some in between.
    """
    rng = np.random.default_rng(rng)
    plan = plan_path(volume, "3d")
    frame = milling_frames(plan, 2)[0]
    rows = frame.row + 1 + np.flatnonzero(plan.removed[frame.row + 1 :])
    rows = np.sort(rng.choice(rows, min(n, len(rows)), replace=False))
    into = plan.approach @ volume.directions
    depth = int(np.argmax(np.abs(into)))
    order = [plan.rotation_axis, depth, 3 - depth - plan.rotation_axis]
    solid = np.transpose(~frame.remaining.mask("air"), order).astype(np.uint8)
    at = np.round(volume.indices(plan.points[rows])).astype(int)[:, order]
    axes = (plan.axes[rows] @ volume.directions)[:, order]
    if into[depth] < 0:
        solid = solid[:, ::-1]
        at[:, 1] = solid.shape[1] - 1 - at[:, 1]
        axes[:, 1] *= -1
    solid = np.ascontiguousarray(solid)
    spacing = np.full(3, volume.spacing.mean())
    ball = ball_element(plan.drill.burr_radius, spacing)
    reached = at[:, None] + np.argwhere(ball) - np.array(ball.shape) // 2
    reached = reached[((reached >= 0) & (reached < solid.shape)).all(axis=-1)]
    solid[tuple(reached.T)] = 0
    grid = np.deg2rad(HALF_DEG) * (2 * np.arange(SIDE) + 1 - SIDE) / SIDE
    aside = np.deg2rad(rng.uniform(-spread_deg, spread_deg, (2, len(rows))))
    tilts = np.arctan2(axes[:, 2], -axes[:, 1]) + aside[0]
    return Windows(solid, spacing, plan.drill, at * spacing, tilts[:, None] + grid, aside[1][:, None] + grid)


def seconds_of(work: Callable[[], object], runs: int = 3) -> float:
    """Least seconds of a call; the first one warms up."""
    work()
    least = np.inf
    for _ in range(runs):
        clock = time.perf_counter()
        work()
        least = min(least, time.perf_counter() - clock)
    return least


def octree_rates(windows: Windows) -> tuple[pd.Series, np.ndarray]:
    """Rates of the reference, and its answers.

    Returns
    -------
    pandas.Series
        Seconds to build the octree; windows and single directions a second, as called from Python and
        counting only the time inside `coal`.
    (n, 324) bool array
        Which directions are free.
    """
    check = OctreeCheck(windows.solid, windows.spacing, windows.drill)
    axes = windows.axes
    free = np.array([check.free(p, a) for p, a in zip(windows.positions, axes, strict=True)])
    whole = seconds_of(lambda: [check.free(p, a) for p, a in zip(windows.positions, axes, strict=True)])
    singles = seconds_of(
        lambda: [check.is_free(p, a[0]) for p, a in zip(windows.positions, axes, strict=True)]
    )
    timed = OctreeCheck(windows.solid, windows.spacing, windows.drill, timed=True)
    inside = []
    for _ in range(3):
        timed.seconds = 0.0
        for p, a in zip(windows.positions, axes, strict=True):
            timed.free(p, a)
        inside.append(timed.seconds)
    n, directions = free.shape
    rates = {
        "surface_voxels": len(surface_voxels(windows.solid)),
        "free_share": free.mean(),
        "windows_all_free_share": free.all(axis=1).mean(),
        "windows_none_free_share": (~free.any(axis=1)).mean(),
        "build_s": seconds_of(lambda: check.update(windows.solid)),
        "single_calls_per_s": n / singles,
        "windows_per_s": n / whole,
        "directions_per_s": n * directions / whole,
        "windows_per_s_inside_coal": n / min(inside),
        "directions_per_s_inside_coal": n * directions / min(inside),
    }
    return pd.Series(rates), free


def main(files: list[str]) -> None:
    table = {}
    for name, volume in cases(files):
        for spread in SPREADS_DEG:
            windows = half_milled_windows(volume, spread_deg=spread)
            table[f"{name}, {spread:g} deg"], _ = octree_rates(windows)
    print(pd.DataFrame(table).to_string(float_format=lambda x: f"{x:.4g}"))


if __name__ == "__main__":
    main(sys.argv[1:])
