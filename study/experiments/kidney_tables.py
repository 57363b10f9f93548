"""Tables 4.2 and B.1 to B.9 laid out as printed, with ours below each printed number."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from study.experiments.kidney_claims import QUANTITIES, printed_rows
from study.experiments.kidney_margins import RUNS, STOPS, VARIANTS
from study.tables import heading, with_unit

_HEADINGS = {
    "mahalanobis_mean": "mean M-distance (SD)",
    "mahalanobis_std": "SD of M-distances (SD)",
    "tumour": "tumour",
    "run": "run",
    "variant": "shape",
    "converged_pct": "fits converged (%)",
    "iterations_mean": "mean iterations",
    "scatter_mm": "rms scatter over the tumour (mm)",
    "bias_mm": "rms bias over the tumour (mm)",
    "healthy_kidney_mm3": "healthy kidney in the margin (mm³)",
    "tumour_mm3": "tumour (mm³)",
    "pos_std_mm": "position SD of the start (mm)",
    "rot_std_deg": "tilt SD of the start (°)",
}
#: Runs as rows of a table are called.
_SOURCES = {"printed": "printed"} | {name: f"ours, {run.title}" for name, run in RUNS.items()}


def kidney_heading(column: str) -> str:
    """A column's name in words, its unit in brackets."""
    return _HEADINGS.get(column) or heading(column)


def printed_beside_ours(rows: pd.DataFrame, table: str, runs: Sequence[str]) -> pd.DataFrame:
    """One printed table in long form, with ours of the same start and the same number of tumour.

    Tumours of the same number are different tumours: what compares is the size of the numbers.

    Parameters
    ----------
    rows : DataFrame
        Of `study.experiments.kidney_margins.run_kidney_margins`.
    table : str
        ``"4.2"`` or ``"B.1"`` to ``"B.9"``.
    runs : sequence of str
        Columns to make; NaN where the rows have none.

    Returns
    -------
    DataFrame
        ``table, tumour, variant, pos_std_mm, rot_std_deg, quantity, printed`` and a column a run.
    """
    printed = printed_rows(table)
    start = printed[["pos_std_mm", "rot_std_deg"]].iloc[0]
    ours = rows[(rows["pos_std_mm"] == start.iloc[0]) & (rows["rot_std_deg"] == start.iloc[1])]
    which = ["tumour", "variant"]
    sides = {"printed": printed, **{run: ours[ours["run"] == run] for run in runs}}
    long = [
        side.melt(which, list(QUANTITIES), "quantity", name).set_index([*which, "quantity"])
        for name, side in sides.items()
    ]
    joined = pd.concat(long, axis=1, join="outer").reset_index()
    shapes = joined["variant"].map(list(VARIANTS).index)
    joined = joined.iloc[np.lexsort([shapes, joined["tumour"]])]
    joined.insert(0, "table", table)
    joined.insert(3, "pos_std_mm", start.iloc[0])
    joined.insert(4, "rot_std_deg", start.iloc[1])
    return joined.reset_index(drop=True)


def as_printed(beside: pd.DataFrame) -> pd.DataFrame:
    """`printed_beside_ours` as text in the printed layout, a column a margin; unmeasured runs left out."""
    sources = [name for name in _SOURCES if name in beside and beside[name].notna().any()]
    beside = beside.assign(
        column=[f"tumour {t} {v}" for t, v in zip(beside["tumour"], beside["variant"], strict=True)]
    )
    columns = beside["column"].drop_duplicates()
    out = {}
    for quantity in QUANTITIES:
        part = beside[beside["quantity"] == quantity].set_index("column")
        for source in sources:
            out[kidney_heading(quantity), _SOURCES[source]] = part[source].map(_number)
    frame = pd.DataFrame(out).T.reindex(columns=columns)
    frame.index = pd.MultiIndex.from_tuples(frame.index, names=["quantity", ""])
    return frame.rename_axis(columns=None)


def _number(value: float) -> str:
    if np.isnan(value):
        return "–"
    return with_unit(value, digits=2 if abs(value) < 0.1 else 3)


def beyond_print(rows: pd.DataFrame) -> pd.DataFrame:
    """What the printed table does not tell: a row a margin, in words and units, as text."""
    shown = rows[["tumour", "kidney"]].copy()
    if len(rows[["pos_std_mm", "rot_std_deg"]].drop_duplicates()) > 1:
        starts = rows[["pos_std_mm", "rot_std_deg"]].to_numpy()
        shown["start"] = [f"{position:g} mm, {tilt:g}°" for position, tilt in starts]
    shown["run"] = rows["run"].map({name: run.title for name, run in RUNS.items()})
    shown["variant"] = rows["variant"]
    shown["risk on fresh registrations (95 % interval)"] = [
        f"{risk:.4f} ({low:.4f} to {high:.4f})" if risk == risk else "–"
        for risk, low, high in rows[["validated_risk", "validated_low", "validated_high"]].to_numpy()
    ]
    for column, pattern in {
        "tumour_mm3": "{:.0f}",
        "healthy_kidney_mm3": "{:.0f}",
        "converged_pct": "{:.0f}",
        "iterations_mean": "{:.0f}",
        "scatter_mm": "{:.3f}",
        "bias_mm": "{:.3f}",
    }.items():
        shown[kidney_heading(column)] = rows[column].map(pattern.format)
    return shown.rename(columns={"variant": "shape"}).reset_index(drop=True)


def starts_and_scatter(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean over the tumours of scatter and bias in mm, a row a start and a column a way to stop."""
    starts = ["pos_std_mm", "rot_std_deg"]
    each = rows.drop_duplicates(["tumour", *starts, "stop"])
    table = each.pivot_table(["scatter_mm", "bias_mm"], starts, "stop", sort=False)
    table.columns = [f"{kidney_heading(what)}, {STOPS[stop]}" for what, stop in table.columns]
    return table.rename_axis(index=[kidney_heading(name) for name in table.index.names])
