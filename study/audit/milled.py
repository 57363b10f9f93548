"""The fifteen milled bones of Table 2.3: what resistance adds to predicted times, and pictures of it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy import stats

from study import published
from study.audit.chapter2 import CONTACT, LEFT, PREDICTED_TIME, TIME, TRUE_TIME, VOLUME, rows
from study.errors import FileFormatError, InputError
from study.robots.resistance import Resistance, fit_resistance
from study.tables import symmetric_percent_difference, t_interval

STRATEGIES = {"zigzag": "A.1", "3d": "A.2"}
MODELS = {
    "no resistance": (),
    "share of the time": ("predicted_time_s",),
    "contact": ("contact_length_mm",),
    "volume": ("removed_cm3",),
    "start and volume": ("start", "removed_cm3"),
}
"""Models of the excess and their terms, from the simplest up."""
_COLOURS = {"zigzag": "#2a6f97", "3d": "#d1603d"}
_WORDS = {"zigzag": "zigzag", "3d": "3-D"}


def milled_bones() -> pd.DataFrame:
    """Return a row per milled bone, indexed by specimen.

    Columns: ``milled_with``, ``predicted_time_s`` (of the strategy it was milled with), ``true_time_s``,
    ``excess_s``, ``modified_initial_target_cm3`` (with the digits of A.1), ``removed_cm3``,
    ``contact_length_mm`` (true mm; not comparable between strategies, finding I1), ``difference_pct``
    (symmetric, I8) and ``printed_difference_pct``.
    """
    printed = rows("2.3")
    found = pd.DataFrame(index=printed.index)
    found["milled_with"] = printed["milled_with"]
    for strategy, name in STRATEGIES.items():
        bones = printed.index[printed["milled_with"] == strategy]
        of_plan = published.corrected(name).set_index("specimen").loc[bones]
        found.loc[bones, "predicted_time_s"] = printed.loc[bones, PREDICTED_TIME[strategy]].astype(float)
        found.loc[bones, VOLUME] = of_plan[VOLUME]
        found.loc[bones, "removed_cm3"] = of_plan[VOLUME] * (1 - of_plan[LEFT])
        found.loc[bones, "contact_length_mm"] = of_plan["milling_path_length_mm"] * of_plan[CONTACT]
    found["true_time_s"] = printed[TRUE_TIME].astype(float)
    found["excess_s"] = found["true_time_s"] - found["predicted_time_s"]
    found["difference_pct"] = symmetric_percent_difference(found["true_time_s"], found["predicted_time_s"])
    found["printed_difference_pct"] = printed["pct_diff_predicted_actual_pct"]
    return found


def fitted(bones: pd.DataFrame, model: str, on: str = "zigzag") -> Resistance:
    """Return a model of `MODELS` fitted to the bones that were milled with one strategy.

    Raises
    ------
    InputError
        If there is no such model or no bone was milled that way.
    """
    if model not in MODELS:
        raise InputError(f"no model {model!r}; there are: {', '.join(MODELS)}")
    sample = bones[bones["milled_with"] == on]
    if sample.empty:
        raise InputError(
            f"no bone was milled with {on!r}; there are: {', '.join(bones['milled_with'].unique())}"
        )
    return fit_resistance(sample["excess_s"], sample, MODELS[model])


def compare_models(bones: pd.DataFrame, on: str = "zigzag") -> pd.DataFrame:
    """Fit every model on one strategy and let it foresee the bones milled with the other.

    Parameters
    ----------
    bones : pandas.DataFrame
        As of `milled_bones`.
    on : {"zigzag", "3d"}
        The strategy to fit on.

    Returns
    -------
    pandas.DataFrame
        A row per model: ``coefficients``, ``fitted_rmse_s``, and of the bones it never saw ``mean_error_s``
        (real less foreseen) with its 95 % t half-width ``plus_minus_s``, ``rmse_s``, ``mean_error_pct`` and
        ``plus_minus_pct`` of the real time, ``inside``, how many of ``of`` fall in their 95 % prediction
        interval, and ``interval_s``, the mean half-width of these.
    """
    other = bones[bones["milled_with"] != on]
    sample = bones[bones["milled_with"] == on]
    found = []
    for name in MODELS:
        model = fitted(bones, name, on)
        error = (other["excess_s"] - model.excess(other)).to_numpy()
        seconds, percent = t_interval(error), t_interval(100 * error / other["true_time_s"].to_numpy())
        values = zip(model.terms, model.coefficients, model.intervals(), strict=True)
        found.append(
            {
                "model": name,
                "coefficients": ", ".join(f"{term} {value:.4g} ± {half:.2g}" for term, value, half in values),
                "fitted_rmse_s": np.sqrt(np.mean((sample["excess_s"] - model.excess(sample)) ** 2)),
                "mean_error_s": seconds.mean,
                "plus_minus_s": seconds.half_width,
                "rmse_s": np.sqrt(np.mean(error**2)),
                "mean_error_pct": percent.mean,
                "plus_minus_pct": percent.half_width,
                "inside": int(np.sum(abs(error) <= model.half_width(other))),
                "of": len(error),
                "interval_s": model.half_width(other).mean(),
            }
        )
    return pd.DataFrame(found)


def strategies_compared(bones: pd.DataFrame) -> pd.DataFrame:
    """Return start and volume coefficients of either strategy and the difference between the two.

    Columns: ``quantity, zigzag, zigzag_plus_minus, 3d, 3d_plus_minus, difference, difference_plus_minus,
    p_value``: 95 % t intervals; the difference by Welch's approximation, 3-D less zigzag.
    """
    models = {strategy: fitted(bones, "start and volume", strategy) for strategy in STRATEGIES}
    found = []
    for k, quantity in enumerate(("start (s)", "per volume (s/cm³)")):
        value = {s: m.coefficients[k] for s, m in models.items()}
        half = {s: m.intervals()[k] for s, m in models.items()}
        variance = {s: m.covariance[k, k] for s, m in models.items()}
        total = sum(variance.values())
        freedom = total**2 / sum(variance[s] ** 2 / m.freedom for s, m in models.items())
        difference = value["3d"] - value["zigzag"]
        found.append(
            {
                "quantity": quantity,
                "zigzag": value["zigzag"],
                "zigzag_plus_minus": half["zigzag"],
                "3d": value["3d"],
                "3d_plus_minus": half["3d"],
                "difference": difference,
                "difference_plus_minus": stats.t.ppf(0.975, freedom) * np.sqrt(total),
                "p_value": 2 * stats.t.sf(abs(difference) / np.sqrt(total), freedom),
            }
        )
    return pd.DataFrame(found)


def measured_rows(folder: str | os.PathLike[str]) -> dict[str, pd.DataFrame]:
    """Return our own rows of appendix A, as far as they have been made.

    Parameters
    ----------
    folder : path-like
        Where ``appendix_a_zigzag_4dof.csv`` and ``appendix_a_3d_4dof.csv`` are looked for.

    Returns
    -------
    dict of str to pandas.DataFrame
        Rows indexed by specimen for each strategy whose file exists.

    Raises
    ------
    FileFormatError
        If a file lacks a column that is needed.
    """
    found = {}
    for strategy in STRATEGIES:
        path = Path(folder) / f"appendix_a_{strategy}_4dof.csv"
        if not path.exists():
            continue
        table = pd.read_csv(path)
        missing = [column for column in ("specimen", VOLUME, TIME) if column not in table]
        if missing:
            raise FileFormatError(
                f"{path}: expected the columns {', '.join(missing)}, got {', '.join(table)}"
            )
        found[strategy] = table.set_index("specimen")
    return found


def predicted_beside_measured(measured: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Return printed and our predicted milling times of the milled bones, s.

    Columns: ``specimen, zigzag_printed_s, zigzag_measured_s, 3d_printed_s, 3d_measured_s``; NaN where a
    bone or a strategy was not run. Our specimens carry the printed names but are other bones.
    """
    milled, found = rows("2.3"), {}
    for strategy, column in PREDICTED_TIME.items():
        found[f"{strategy}_printed_s"] = milled[column].astype(float)
        ours = measured.get(strategy)
        times = pd.Series(np.nan, index=milled.index) if ours is None else ours[TIME].reindex(milled.index)
        found[f"{strategy}_measured_s"] = times
    return pd.DataFrame(found).reset_index()


def figure_2_20(measured: dict[str, pd.DataFrame] | None = None) -> Figure:
    """Return predicted milling time over target volume with fitted lines, as Figure 2.20.

    Parameters
    ----------
    measured : dict of str to pandas.DataFrame, optional
        Our rows for ``"zigzag"`` and ``"3d"`` with the columns of A.1 and A.2, for a second panel.
    """
    printed = {strategy: rows(name) for strategy, name in STRATEGIES.items()}
    panels = {"Printed, 36 scans": printed} | ({"Measured here": measured} if measured else {})
    figure = Figure(figsize=(5.4 * len(panels), 3.8), layout="constrained")
    axes = np.ravel(figure.subplots(1, len(panels), sharex=True, sharey=True))
    for axis, (title, samples) in zip(axes, panels.items(), strict=True):
        for strategy, sample in samples.items():
            _line(axis, sample[VOLUME], sample[TIME], strategy, f"{_WORDS[strategy]}")
        axis.set(xlabel="modified target (cm³)", ylabel="predicted milling time (s)", title=title)
        axis.legend(frameon=False)
        axis.spines[["top", "right"]].set_visible(False)
    return figure


def figure_2_21(bones: pd.DataFrame) -> Figure:
    """Return real milling times over target volume, as Figure 2.21, and the excess beside it."""
    figure = Figure(figsize=(10.8, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    for strategy in STRATEGIES:
        sample = bones[bones["milled_with"] == strategy]
        _line(left, sample[VOLUME], sample["true_time_s"], strategy, _WORDS[strategy])
        left.plot(sample[VOLUME], sample["predicted_time_s"], "x", color=_COLOURS[strategy], ms=5)
        right.plot(
            sample["removed_cm3"], sample["excess_s"], "o", color=_COLOURS[strategy], label=_WORDS[strategy]
        )
    model = fitted(bones, "start and volume")
    volume = np.linspace(bones["removed_cm3"].min(), bones["removed_cm3"].max(), 50)
    at = {"removed_cm3": volume}
    excess, half = model.excess(at), model.half_width(at)
    right.plot(volume, excess, color=_COLOURS["zigzag"], lw=1.2, label="start and volume, fitted on zigzag")
    right.fill_between(volume, excess - half, excess + half, color=_COLOURS["zigzag"], alpha=0.15, lw=0)
    left.set(
        xlabel="modified target (cm³)",
        ylabel="milling time (s)",
        title="Milled (dots) and predicted (crosses)",
    )
    right.set(
        xlabel="removed bone (cm³)", ylabel="real less predicted time (s)", title="What resistance adds"
    )
    for axis in (left, right):
        axis.legend(frameon=False)
        axis.spines[["top", "right"]].set_visible(False)
    return figure


def _line(axis, volume: pd.Series, time: pd.Series, strategy: str, label: str) -> None:
    fit = stats.linregress(volume, time)
    ends = np.array([volume.min(), volume.max()])
    axis.plot(volume, time, "o", color=_COLOURS[strategy], ms=4)
    axis.plot(
        ends,
        fit.intercept + fit.slope * ends,
        color=_COLOURS[strategy],
        label=f"{label}: {fit.slope:.0f} s/cm³",
    )
