"""Table 1 of Baron: 24 holes in an aluminium block, by each system, once and many times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import stats

from study import published
from study.audit.baron import planar_quantile, prediction_quantile
from study.errors import InputError
from study.experiments.guidance_bands import (
    LEVEL,
    SUSPECTED_FORCE_N,
    Comparison,
    Condition,
    compare,
    conditions,
    prediction_band,
)
from study.guidance import (
    SYSTEMS,
    LateralResult,
    Repeated,
    causes,
    lateral_experiment,
    repeat_lateral,
    system,
)

SIDES = ("top", "bottom")
#: Columns of Table 1.
QUANTITIES = (
    "mean_x_mm",
    "mean_y_mm",
    "std_x_mm",
    "std_y_mm",
    "std_major_axis_mm",
    "std_minor_axis_mm",
    "confidence_999_major_axis_mm",
    "mean_plus_confidence_max_mm",
)
#: Of the regions.
REGION = 0.999


def factors(holes: int = 24) -> dict[str, float]:
    """Half axes of a 99.9 % region, in standard deviations, by what the region is meant to hold.

    Parameters
    ----------
    holes : int
        From which mean and covariance are estimated.

    Returns
    -------
    dict
        ``"one dimension"`` as printed; ``"two dimensions"``, of a planar normal that is known;
        ``"one hole more"``, Hotelling's region for a normal known from so many holes only.
    """
    return {
        "one dimension": float(stats.norm.ppf(0.5 + REGION / 2.0)),
        "two dimensions": planar_quantile(REGION),
        "one hole more": prediction_quantile(holes, REGION),
    }


def hole_statistics(deviations: ArrayLike) -> np.ndarray:
    """(..., 8) numbers of a row of Table 1, `QUANTITIES`, as the text computes them.

    Parameters
    ----------
    deviations : (..., n, 2) array
        Of n holes in x and y, mm.

    Returns
    -------
    (..., 8) array
        mm; standard deviations with n - 1, the region with the printed one-dimensional factor, and its
        half axis added to the length of the mean.

    Raises
    ------
    InputError
        If there are fewer than three holes or a number is not finite.
    """
    d = np.asarray(deviations, dtype=float)
    if d.ndim < 2 or d.shape[-1] != 2 or d.shape[-2] < 3 or not np.isfinite(d).all():
        raise InputError(f"deviations: expected (..., 3 or more, 2) finite numbers in mm, got {d.shape}")
    mean = d.mean(axis=-2)
    rest = d - mean[..., None, :]
    covariance = np.einsum("...ni,...nj->...ij", rest, rest) / (d.shape[-2] - 1)
    variances = np.clip(np.linalg.eigvalsh(covariance), 0.0, None)
    minor, major = np.sqrt(variances[..., 0]), np.sqrt(variances[..., 1])
    region = factors()["one dimension"] * major
    std = np.sqrt(np.einsum("...ii->...i", covariance))
    total = np.linalg.norm(mean, axis=-1) + region
    return np.stack(
        [*np.moveaxis(mean, -1, 0), *np.moveaxis(std, -1, 0), major, minor, region, total], axis=-1
    )


def printed(name: str) -> np.ndarray:
    """(2, 8) printed numbers of a system, top and bottom, mm."""
    table = published.table("Baron 1")
    table = table[table["system"] == name].set_index("side")
    return table.loc[list(SIDES), list(QUANTITIES)].to_numpy(float)


def cause_table() -> pd.DataFrame:
    """The causes of both systems, ready to be shown."""
    table = causes().reset_index()
    table["cause"] = [
        cause_title(name, unit) for name, unit in zip(table["cause"], table["unit"], strict=True)
    ]
    return table


def cause_title(name: str, unit: str) -> str:
    """A cause in words, without the unit that its name ends with."""
    ending = "_" + unit.lower().replace("/", "_")
    return name.removesuffix(ending).replace("_", " ")


@dataclass(frozen=True, eq=False)
class Bands:
    """Many blocks of each system under each condition.

    Attributes
    ----------
    conditions : dict of str to tuple of Condition
        By system.
    runs : dict of (str, str) to Repeated
        By system and condition; values (n, 2, 24, 2), mm.
    """

    conditions: dict[str, tuple[Condition, ...]]
    runs: dict[tuple[str, str], Repeated]

    def numbers(self, name: str, condition: str) -> np.ndarray:
        """(n, 2, 8) Table 1 of each experiment, mm."""
        return hole_statistics(self.runs[name, condition].values)

    def comparison(self, name: str, condition: str) -> Comparison:
        """The 16 printed numbers of a system among the simulated ones."""
        simulated = self.numbers(name, condition)
        return compare(printed(name).ravel(), simulated.reshape(len(simulated), -1))


def one_block(name: str, seed: int = 0) -> LateralResult:
    """One block of a system with its causes as stated."""
    return lateral_experiment(system(name), seed)


def many_blocks(
    experiments: int, seed: int = 1, force_n: float = SUSPECTED_FORCE_N, names: Sequence[str] = SYSTEMS
) -> Bands:
    """Drill many blocks of each system under each of its conditions, with the same seeds.

    Parameters
    ----------
    experiments : int
        Of each condition.
    seed : int
    force_n : float
        See `conditions`.
    names : sequence of str
    """
    of = {name: conditions(name, force_n) for name in names}
    runs = {
        (name, one.name): repeat_lateral(one.system, experiments, seed, drawn=one.drawn)
        for name, some in of.items()
        for one in some
    }
    return Bands(of, runs)


def table_1(blocks: Mapping[str, LateralResult], bands: Bands) -> pd.DataFrame:
    """Table 1: printed, one virtual block, and the bands with whether the print is inside.

    Returns
    -------
    pandas.DataFrame
        A row a number: ``system``, ``side``, ``quantity``, ``printed_mm``, ``one_block_mm``, and for each
        condition ``<name>_low_mm``, ``<name>_high_mm``, ``<name>_inside`` ("yes", "no"; empty where a system
        has no such condition).
    """
    parts = []
    for name, block in blocks.items():
        part = pd.DataFrame(
            {
                "system": name,
                "side": np.repeat(SIDES, len(QUANTITIES)),
                "quantity": QUANTITIES * 2,
                "printed_mm": printed(name).ravel(),
                "one_block_mm": hole_statistics([block.top, block.bottom]).ravel(),
            }
        )
        for one in bands.conditions[name]:
            found = bands.comparison(name, one.name)
            part[f"{one.name}_low_mm"], part[f"{one.name}_high_mm"] = found.low, found.high
            part[f"{one.name}_inside"] = np.where(found.inside, "yes", "no")
        parts.append(part)
    table = pd.concat(parts, ignore_index=True)
    words = [column for column in table if column.endswith("_inside")]
    table[words] = table[words].fillna("")
    return table


def agreement(bands: Bands) -> pd.DataFrame:
    """How many of the 16 printed numbers of a system are inside, and how unusual that is.

    Returns
    -------
    pandas.DataFrame
        A row a system and condition: ``experiments``, ``aborted``, ``coverage_pct`` of a band, ``inside``,
        ``expected_inside``, ``all_inside_pct``, ``as_unusual_pct`` (see `Comparison`) and ``outside``, which.
    """
    rows = []
    for name, some in bands.conditions.items():
        for one in some:
            run, found = bands.runs[name, one.name], bands.comparison(name, one.name)
            of = [f"{side} {quantity.removesuffix('_mm')}" for side in SIDES for quantity in QUANTITIES]
            rows.append(
                {
                    "system": name,
                    "condition": one.title,
                    "experiments": len(run.values),
                    "aborted": len(run.aborted),
                    "coverage_pct": 100 * found.coverage,
                    "inside": int(found.inside.sum()),
                    "expected_inside": found.coverage * found.inside.size,
                    "all_inside_pct": 100 * found.all_inside,
                    "as_unusual_pct": 100 * found.as_unusual,
                    "outside": ", ".join(
                        w for w, inside in zip(of, found.inside, strict=True) if not inside
                    ).replace("_", " "),
                }
            )
    return pd.DataFrame(rows)


def agreement_in_words(table: pd.DataFrame) -> str:
    """The rows of `agreement` as sentences."""
    text = []
    for row in table.itertuples():
        said = f"**{row.system.title()}, {row.condition}**: {row.inside} of 16 printed numbers inside"
        said += f" (a right model has {row.expected_inside:.1f} on average); all 16 are inside in "
        said += (
            f"{row.all_inside_pct:.0f} % of the simulated experiments, and {row.as_unusual_pct:.1f} % have "
        )
        said += "as many outside as the print." if row.outside else "none outside or more, as the print."
        said += f" Outside: {row.outside}." if row.outside else ""
        if row.aborted:
            said += f" {row.aborted} experiments more were given up, because the robot stopped by itself."
        if row.coverage_pct < 100 * LEVEL - 0.1:
            said += (
                f" With {row.experiments} experiments the bands hold {row.coverage_pct:.0f} %, not 95 %: "
                "they are least and largest."
            )
        text.append(said)
    return "\n\n".join(text)


def corrected_sums(bands: Bands) -> pd.DataFrame:
    """Mean plus 99.9 % region: printed, as it should be, and where the simulated experiments have it.

    Returns
    -------
    pandas.DataFrame
        A row a system, side and factor: ``factor``, ``printed_mm`` (with the first factor what is printed),
        and for each condition the ends of its band.
    """
    rows = []
    for name, some in bands.conditions.items():
        for side, row in zip(range(2), printed(name), strict=True):
            for meant, factor in factors().items():
                found = {
                    "system": name,
                    "side": SIDES[side],
                    "region": meant,
                    "factor": factor,
                    "printed_mm": np.hypot(row[0], row[1]) + factor * row[4],
                }
                for one in some:
                    numbers = bands.numbers(name, one.name)[:, side]
                    sums = np.hypot(numbers[:, 0], numbers[:, 1]) + factor * numbers[:, 4]
                    found[f"{one.name}_low_mm"], found[f"{one.name}_high_mm"], _ = prediction_band(sums)
                rows.append(found)
    return pd.DataFrame(rows)
