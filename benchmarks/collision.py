"""How fast shafts are checked against bone, one thread: the dissertation's octree and GJK, and ours.

The octree goes through `coal`. Both answer for the same poses in the same run, and their answers are
compared. Run with ``python benchmarks/collision.py [volume files]``; without files the real bones are
used when they are there, else two of the procedural specimens. The bone is half milled, the burr stands
at positions that the plan goes to next, and the windows are those of 2.3.3: 18 x 18 directions within
2.5 degrees of a shaft. Seconds are the process's own, so that others on the machine count for neither.
At the end stands an estimate of what the windows of a 5-DOF plan would take with `coal`.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks.planning import cases
from study._compiled import kernel
from study.collision import Drill
from study.collision.directions import DirectionCheck
from study.collision.directions.field._kernels import WINDOWS
from study.collision.directions.search import _kernels as fast
from study.collision.exact._kernels import drill_overlaps_voxels
from study.collision.octree import OctreeCheck, surface_voxels
from study.errors import IncompletePlanWarning
from study.planners import PlannerSettings, plan_path, planning
from study.published import summary
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
    """Least seconds of processor time of a call; the first one warms up."""
    work()
    least = np.inf
    for _ in range(runs):
        clock = time.process_time()
        work()
        least = min(least, time.process_time() - clock)
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


@kernel
def _look_at_windows(space, voxels, tilts, tips, free):
    for n in range(len(voxels)):
        i, j, k = voxels[n]
        fast.window_of_directions(space, i, j, k, tilts[n], tips[n], free[n])


@kernel
def _look_at_directions(space, voxels, axes, free):
    for n in range(len(voxels)):
        i, j, k = voxels[n]
        fast.directions_free(space, i, j, k, axes[n], free[n])


def fast_rates(windows: Windows) -> tuple[pd.Series, np.ndarray]:
    """Rates of `DirectionCheck`, and its answers; like `octree_rates`.

    "Inside" is a compiled loop over all positions, without Python around each. Windows are looked at
    as windows, single directions one by one.
    """
    check = DirectionCheck(windows.solid, windows.spacing, windows.drill)
    axes, voxels = windows.axes, windows.positions / windows.spacing
    n, directions = axes.shape[:2]
    each = list(zip(windows.positions, windows.tilts, windows.tips, strict=True))
    free = np.array([check.window(*window).ravel() for window in each])
    grid, singles = np.empty((n, SIDE, SIDE), np.int8), np.empty((n, directions), np.bool_)
    whole = seconds_of(lambda: [check.window(*window) for window in each], 10)
    alone = seconds_of(lambda: [check.is_free(p, a[0]) for p, a in zip(windows.positions, axes, strict=True)])
    inside = seconds_of(lambda: _look_at_windows(check.space, voxels, windows.tilts, windows.tips, grid), 10)
    one_by_one = seconds_of(lambda: _look_at_directions(check.space, voxels, axes, singles), 10)
    if not (np.array_equal(singles, free) and np.array_equal(grid.reshape(n, -1), free)):
        raise AssertionError("a window differs from its directions looked at one by one")
    rates = {
        "build_s": seconds_of(lambda: DirectionCheck(windows.solid, windows.spacing, windows.drill)),
        "single_calls_per_s": n / alone,
        "windows_per_s": n / whole,
        "directions_per_s": n * directions / whole,
        "windows_per_s_inside": n / inside,
        "directions_per_s_inside": n * directions / inside,
        "directions_one_by_one_per_s_inside": n * directions / one_by_one,
    }
    return pd.Series(rates), free


def differences(windows: Windows, ours: np.ndarray, theirs: np.ndarray) -> pd.Series:
    """How many answers differ, and how many of those are no matter of the octree's safety gap.

    The octree may refuse a shaft up to its `gap_mm` from the bone. A difference counts as real when the
    plain exact kernel, for a shaft grown by that gap, does not explain it.
    """
    gap = OctreeCheck(windows.solid, windows.spacing, windows.drill).gap_mm
    cylinders = np.array(windows.drill.cylinders) + gap * np.array([1.0, -1.0, 1.0])
    hit = np.zeros(3, np.int64)
    at = np.argwhere(ours != theirs)
    axes = windows.axes
    explained = [
        ours[n, m] and drill_overlaps_voxels(
            windows.solid, windows.spacing, windows.positions[n], axes[n, m], cylinders, hit
        )
        for n, m in at
    ]  # fmt: skip
    return pd.Series(
        {"answers": ours.size, "differ": len(at), "differ_beyond_gap": len(at) - int(np.sum(explained))}
    )


def compared(windows: Windows) -> pd.DataFrame:
    """Reference, fast and ratio of every rate, one column each."""
    reference, theirs = octree_rates(windows)
    fast_ones, ours = fast_rates(windows)
    reference = reference.rename(index=lambda name: name.removesuffix("_coal").removesuffix("_inside") + (
        "_inside" if "_inside" in name else ""
    ))  # fmt: skip
    reference["directions_one_by_one_per_s_inside"] = reference[
        "directions_per_s_inside"
    ]  # it has no other way
    shares = reference[[name for name in reference.index if name not in fast_ones.index]]
    table = pd.DataFrame({"coal": reference[fast_ones.index], "fast": fast_ones})
    table["ratio"] = table["fast"] / table["coal"]
    table.loc["build_s", "ratio"] = table.loc["build_s", "coal"] / table.loc["build_s", "fast"]
    found = pd.concat([shares, differences(windows, ours, theirs)])
    return pd.concat([table, pd.DataFrame({"coal": found})])


def windows_of_a_plan(volume: LabelVolume, strategy: str) -> tuple[int, float]:
    """How many windows the printed method looks at for one plan, and the plan's seconds."""
    kept = []
    build = planning._build

    def keeping(*arguments):
        kept.append(build(*arguments))
        return kept[-1]

    planning._build = keeping
    try:
        plan = plan_path(volume, strategy, 5, settings=PlannerSettings(method="published"))
    finally:
        planning._build = build
    return int(kept[0][0].shaft.space.counts[WINDOWS]), plan.planning_time_s


def main(files: list[str]) -> None:
    warnings.simplefilter("ignore", IncompletePlanWarning)  # the printed method leaves what it leaves
    estimates = []
    for name, volume in cases(files):
        for spread in SPREADS_DEG:
            table = compared(half_milled_windows(volume, spread_deg=spread))
            print(f"{name}, windows within {spread:g} degrees of the shaft")
            print(table.to_string(float_format=lambda x: f"{x:.4g}", na_rep=""), end="\n\n")
            if spread == 0.0:
                rate = table.loc["windows_per_s_inside", "coal"]
        for strategy, printed in (("3d", "A.4"), ("zigzag", "A.3")):
            looked, seconds = windows_of_a_plan(volume, strategy)
            estimates.append(
                {
                    "volume": name,
                    "strategy": strategy,
                    "windows": looked,
                    "plan_s": seconds,
                    "windows_by_coal_s": looked / rate,
                    "printed_s": summary(printed).loc["mean", "simulation_time_s"],
                }
            )
    print("The windows that 5-DOF plans by the printed method look at. What they would take with coal is an")
    print("ESTIMATE: their number over its rate above, without rebuilding the octree as bone goes.")
    print(pd.DataFrame(estimates).to_string(index=False, float_format=lambda x: f"{x:.4g}"))


if __name__ == "__main__":
    main(sys.argv[1:])
