"""Section 6.4 of Baron: six holes in an acrylic block, from scan to scan."""

from __future__ import annotations

import numpy as np
import pandas as pd

from study import published
from study.experiments.guidance_bands import SUSPECTED_FORCE_N, compare, conditions
from study.experiments.guidance_variants import Variant, absolute_runs, jackknife
from study.guidance import (
    DrilledHole,
    LoopSettings,
    Repeated,
    absolute_experiment,
    acrylic_block,
    drill_holes,
    repeat_absolute,
    set_up,
    system,
)

QUANTITIES = ("target_mean_mm", "target_std_mm", "axis_mean_mm", "axis_std_mm")
#: Causes that are taken away together; a tracker without any noise would count as frozen, so some is left.
GROUPS = {
    "spheres in the scan": {"image_fle_mm": 0.0},
    "pointer and touches": {"pointer_tip_error_mm": 0.0, "pointer_seating_mm": 0.0},
    "tracker's distortion": {"tracker_distortion_mm": 0.0},
    "tracker's jitter": {"tracker_jitter_mm": 0.001, "tracker_quantum_mm": 0.0001},
    "drill's axis in calibration": {"tool_axis_error_mrad": 0.0},
    "arm": {
        "robot_repeatability_mm": 0.0,
        "joint_bias_mrad": 0.0,
        "link_error_mm": 0.0,
        "axis_error_mrad": 0.0,
    },
    "bending and slipping": {"lateral_force_n": 0.0, "force_variation_n": 0.0, "entry_slip_mm": 0.0},
    "reading of the second scan": {"scan_reading_mm": 0.0},
}


def distance_statistics(distances: np.ndarray) -> np.ndarray:
    """(..., 4) means and standard deviations (n - 1) of (..., 2, holes) distances, `QUANTITIES`, mm."""
    mean, std = distances.mean(axis=-1), distances.std(axis=-1, ddof=1)
    return np.stack([mean[..., 0], std[..., 0], mean[..., 1], std[..., 1]], axis=-1)


def printed() -> np.ndarray:
    """(4,) printed numbers, mm."""
    table = published.table("Baron absolute accuracy")
    return table[["mean_mm", "std_mm"]].to_numpy(float).ravel()


def one_block(seed: int = 0) -> list[DrilledHole]:
    """The six holes of one block, by the Vanderbilt system."""
    rng = np.random.default_rng(seed)
    return drill_holes(set_up(system("vanderbilt"), acrylic_block(), rng, imaged=True), rng)


def absolute_table(
    experiments: int, seed: int = 1, force_n: float = SUSPECTED_FORCE_N
) -> tuple[pd.DataFrame, dict[str, Repeated]]:
    """Printed, one virtual block, and the bands of many; and the experiments by condition."""
    some = conditions("vanderbilt", force_n)
    runs = {one.name: repeat_absolute(one.system, experiments, seed, drawn=one.drawn) for one in some}
    block = absolute_experiment(system("vanderbilt"), seed)
    table = pd.DataFrame(
        {
            "system": "vanderbilt",
            "quantity": QUANTITIES,
            "printed_mm": printed(),
            "one_block_mm": distance_statistics(np.stack([block.target_distance, block.axis_distance])),
        }
    )
    for one in some:
        found = compare(printed(), distance_statistics(runs[one.name].values))
        table[f"{one.name}_low_mm"], table[f"{one.name}_high_mm"] = found.low, found.high
        table[f"{one.name}_inside"] = np.where(found.inside, "yes", "no")
    return table, runs


def counts(runs: dict[str, Repeated], force_n: float = SUSPECTED_FORCE_N) -> pd.DataFrame:
    """Of each condition: experiments, given up, printed numbers inside of 4, how unusual that is."""
    rows = []
    for one in conditions("vanderbilt", force_n):
        run = runs[one.name]
        found = compare(printed(), distance_statistics(run.values))
        rows.append(
            {
                "condition": one.title,
                "experiments": len(run.values),
                "aborted": len(run.aborted),
                "coverage_pct": 100 * found.coverage,
                "inside_of_4": int(found.inside.sum()),
                "all_inside_pct": 100 * found.all_inside,
                "as_unusual_pct": 100 * found.as_unusual,
            }
        )
    return pd.DataFrame(rows)


def shares(experiments: int, seed: int = 2) -> pd.DataFrame:
    """By how much the mean square falls when a group of causes is taken away, in per cent of all.

    The groups do not add up to 100: the mean square has a part from drill and axis together, and a tracker's
    distortion enters calibration, registration and guidance and partly cancels.

    Returns
    -------
    pandas.DataFrame
        A row a group: ``target_pct`` and ``axis_pct`` with their 95 % half widths ``..._plus_minus``.
    """
    variants = [Variant("all"), *(Variant(name, changes) for name, changes in GROUPS.items())]
    runs = absolute_runs(system("vanderbilt"), variants, experiments, seed)
    good = ~np.isnan(runs.values).any(axis=(1, 2, 3))
    values = runs.values[good]
    rows = []
    for k, variant in enumerate(variants[1:], start=1):
        row = {"without": variant.name}
        for axis, kind in enumerate(("target", "axis")):
            share, half = jackknife(_share, values[:, 0, axis], values[:, k, axis])
            row |= {f"{kind}_pct": share, f"{kind}_plus_minus": half}
        rows.append({**row, "experiments": int(good.sum()), "aborted": runs.aborted(k)})
    return pd.DataFrame(rows)


def overruns(experiments: int, seed: int = 2) -> pd.DataFrame:
    """Both distances with and without the speed of insertion told in advance, the same blocks.

    Returns
    -------
    pandas.DataFrame
        A row a way: ``control``, ``target_rms_mm``, ``axis_rms_mm``, ``experiments``.
    """
    rows = []
    for share, title in ((1.0, "PI, and the speed told in advance"), (0.0, "PI alone, as the text has it")):
        run = repeat_absolute(
            system("vanderbilt"), experiments, seed, settings=LoopSettings(feed_forward=share)
        )
        target, axis = np.sqrt((run.values**2).mean(axis=(0, 2)))
        rows.append(
            {"control": title, "target_rms_mm": target, "axis_rms_mm": axis, "experiments": len(run.values)}
        )
    return pd.DataFrame(rows)


def _share(everything: np.ndarray, without: np.ndarray) -> float:
    return 100.0 * (1.0 - (without**2).mean() / (everything**2).mean())
