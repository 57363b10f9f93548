"""Section 6.4 of Baron: six holes in an acrylic block, from scan to scan."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from study import published
from study.experiments.guidance_bands import SUSPECTED_FORCE_N, compare, conditions
from study.experiments.guidance_variants import Variant, absolute_runs, jackknife, upper_bound
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
    """Of each condition: experiments, printed numbers inside of 4, and how often a target is missed by 1 mm.

    Returns
    -------
    pandas.DataFrame
        A row a condition: ``experiments``, ``aborted``, ``coverage_pct`` of a band, ``inside_of_4``,
        ``all_inside_pct`` and ``as_unusual_pct`` (see `Comparison`), ``targets_beyond_1_mm_pct`` of the holes
        with the 95 % half width, for which whole blocks are left out: the holes of one share their errors.
    """
    rows = []
    for one in conditions("vanderbilt", force_n):
        run = runs[one.name]
        found = compare(printed(), distance_statistics(run.values))
        far, half = _share_beyond(run.values[:, 0]), jackknife(_share_beyond, run.values[:, 0])[1]
        half = half if far else np.nan  # none at all says nothing of the interval
        rows.append(
            {
                "condition": one.title,
                "experiments": len(run.values),
                "aborted": len(run.aborted),
                "coverage_pct": 100 * found.coverage,
                "inside_of_4": int(found.inside.sum()),
                "all_inside_pct": 100 * found.all_inside,
                "as_unusual_pct": 100 * found.as_unusual,
                "targets_beyond_1_mm_pct": 100 * far,
                "plus_minus_pct": 100 * half,
            }
        )
    return pd.DataFrame(rows)


def in_words(counted: pd.DataFrame) -> str:
    """The rows of `counts`, and what the printed six holes say of 99.9 %, as sentences."""
    mean, std = printed()[:2]
    reach = mean + stats.norm.ppf(0.999) * std
    text = [
        f"The text calls the accuracy submillimetric, which the mean is. Mean and standard deviation of six "
        f"holes ({mean:g} and {std:g} mm) reach to {reach:.2f} mm at 99.9 %, if distances were normal."
    ]
    for row in counted.itertuples():
        said = f"**{row.condition}**: {row.inside_of_4} of 4 printed numbers inside (bands hold "
        said += (
            f"{row.coverage_pct:.0f} %); {row.targets_beyond_1_mm_pct:.2g} % of targets are missed by more "
        )
        known = f"half width {row.plus_minus_pct:.2g} %" if np.isfinite(row.plus_minus_pct) else "no interval"
        if not row.targets_beyond_1_mm_pct:  # whose half width would be 0
            known = f"at most {100 * upper_bound(0, row.experiments):.2g} % of blocks have one, with 95 %"
        said += f"than 1 mm ({known}, from {row.experiments} blocks)."
        text.append(said)
    return "\n\n".join(text)


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


def _share_beyond(distances: np.ndarray) -> float:
    return float((distances > 1.0).mean())


def _share(everything: np.ndarray, without: np.ndarray) -> float:
    return 100.0 * (1.0 - (without**2).mean() / (everything**2).mean())
