"""Tables 4.2 and B.1 to B.9 in pictures: volumes, risk against volume, exponents, scatter."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from study.plots.style import legend_below, new_axes, styled

COLOURS = {"SV": "#0072b2", "CT": "#d55e00"}
SHAPES = {"SV": "spatially varying", "CT": "constant thickness"}
RUN_MARKERS = {"published": "s", "loose": "o", "converged": "^"}
TUMOURS = ("#332288", "#117733", "#aa4499", "#997700", "#44aa99", "#882255")
ERROR_NAMES = {
    "pos_std_mm": "position error of the start, SD (mm)",
    "rot_std_deg": "tilt of the start, SD (°)",
}
QUANTITY_NAMES = {"margin_volume_mm3": "volume", "scatter_mm": "scatter"}
_SHORT = {"pos_std_mm": "exponent of the position error", "rot_std_deg": "exponent of the rotation error"}


def _plain(axes: Axes) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.92")
    axes.set_axisbelow(True)


@styled()
def kidney_volumes(beside: pd.DataFrame, titles: Mapping[str, str]) -> Figure:
    """Volumes of one table, a row a tumour and source; empty margins at the left edge.

    Parameters
    ----------
    beside : DataFrame
        Of `study.experiments.kidney_tables.printed_beside_ours`.
    titles : mapping of str to str
        Columns of it to draw (``printed`` and runs) and what to call them.
    """
    rows = beside[beside["quantity"] == "margin_volume_mm3"]
    tumours = list(rows["tumour"].drop_duplicates())
    values = rows[list(titles)].to_numpy(dtype=float)
    edge = 0.5 * values[values > 0].min()
    figure, axes = new_axes(1, 1, (8.2, 0.8 + 0.22 * len(tumours) * (len(titles) + 1)))
    ax, ticks = axes[0, 0], {}
    for number, tumour in enumerate(tumours):
        for k, (source, title) in enumerate(titles.items()):
            at = number * (len(titles) + 1) + k
            ticks[at] = f"tumour {tumour}, {title}" if k == 0 else title
            part = rows[rows["tumour"] == tumour].set_index("variant")[source].dropna()
            shown = part.where(part > 0, edge)
            if len(shown) > 1:
                ax.plot(shown, [at] * len(shown), color="0.75", lw=1.2, zorder=1)
            for variant, value in shown.items():
                face = "white" if source == "printed" else COLOURS[variant]
                marker = "<" if part[variant] == 0 else "o"
                ax.plot(value, at, marker, ms=6, color=COLOURS[variant], mfc=face)
    ax.set(xscale="log", xlabel="volume of the margin (mm³); empty at the left edge")
    ax.set_yticks(list(ticks), list(ticks.values()))
    ax.invert_yaxis()
    _plain(ax)
    handles = [
        Line2D([], [], color=COLOURS[v], marker="o", ls="", mfc=face, label=f"{name}, {source}")
        for v, name in SHAPES.items()
        for source, face in (("printed", "white"), ("ours", COLOURS[v]))
    ]
    handles.append(Line2D([], [], color="0.4", marker="<", ls="", label="empty"))
    legend_below(figure, handles, 3)
    return figure


@styled()
def kidney_risk_curves(
    curves: Mapping[tuple[str, str, float, float, str], pd.DataFrame],
    rows: pd.DataFrame,
    acceptable_risk: float,
    titles: Mapping[str, str],
) -> Figure:
    """Overall damage risk against volume at one start: exact growth as lines, ends of all runs as marks.

    Parameters
    ----------
    curves : mapping
        Of `study.experiments.kidney_margins.KidneyMargins`.
    rows : DataFrame
        Of the same, of one start. The filled mark is at the risk that stopped growth, the open one at that on
        fresh registrations.
    acceptable_risk : float
    titles : mapping of str to str
        Runs to draw and what to call them.
    """
    kidneys = list(rows["kidney"].drop_duplicates())
    figure, axes = new_axes(1, len(kidneys), (max(3.3 * len(kidneys), 6.5), 3.9), sharey=True)
    floor = acceptable_risk / 20
    for ax, kidney in zip(axes[0], kidneys, strict=True):
        part = rows[(rows["kidney"] == kidney) & rows["run"].isin(list(titles))]
        for row in part.itertuples():
            colour, run = COLOURS[row.variant], row.run
            volume = row.margin_volume_mm3 / 1000
            if run != "published":
                curve = curves[kidney, run, row.pos_std_mm, row.rot_std_deg, row.variant]
                curve = curve[curve["risk"] > floor]
                ax.step(
                    curve["volume_mm3"] / 1000, curve["risk"], where="post", color=colour, lw=1.2,
                    ls="-" if run == "loose" else ":",
                )  # fmt: skip
            ends = np.maximum([row.final_damage_probability, row.validated_risk], floor)
            ax.plot([volume] * 2, ends, color=colour, lw=0.9)
            ax.plot(volume, ends[0], RUN_MARKERS[run], color=colour, ms=5)
            if np.isfinite(ends[1]):
                ax.plot(volume, ends[1], RUN_MARKERS[run], color=colour, mfc="white", ms=5)
        ax.axhline(acceptable_risk, color="0.35", lw=0.9, ls="--")
        ax.set(yscale="log", ylim=(0.8 * floor, 1.3), title=kidney, xlabel="volume of the margin (cm³)")
        ax.set_xlim(left=-0.03 * max(part["margin_volume_mm3"].max(), 1.0) / 1000)
        _plain(ax)
    axes[0, 0].set_ylabel("overall damage risk")
    handles = [Line2D([], [], color=c, label=SHAPES[v]) for v, c in COLOURS.items()]
    handles += [
        Line2D([], [], color="0.35", marker=RUN_MARKERS[run], ms=5, label=title,
               ls={"published": "", "loose": "-", "converged": ":"}[run])
        for run, title in titles.items()
    ]  # fmt: skip
    handles.append(Line2D([], [], color="0.35", lw=0.9, ls="--", label="acceptable"))
    handles.append(
        Line2D([], [], color="0.35", marker="o", mfc="white", ls="", label="on fresh registrations")
    )
    legend_below(figure, handles, 4)
    return figure


@styled()
def against_errors(
    sources: Mapping[str, pd.DataFrame], laws: Mapping[tuple[str, str], object], quantity: str, ylabel: str
) -> Figure:
    """A quantity of every margin against both errors of the start, with the fitted power laws.

    Parameters
    ----------
    sources : mapping of str to DataFrame
        A row of panels each, by its title: rows with ``tumour, variant``, the two errors and `quantity`.
    laws : mapping of (title, variant) to PowerLaw
        Of `study.experiments.kidney_scaling`; drawn at the middle of the other error.
    quantity, ylabel : str
    """
    figure, axes = new_axes(len(sources), 2, (9.4, 3.1 * len(sources) + 0.5), sharey="row", sharex="col")
    names = tuple(ERROR_NAMES)
    for row, (title, rows) in zip(axes, sources.items(), strict=True):
        tumours = list(rows["tumour"].drop_duplicates())
        for k, (ax, error) in enumerate(zip(row, names, strict=True)):
            other = names[1 - k]
            middle = np.exp(np.log(rows[other]).mean())
            for (tumour, variant), part in rows[rows[quantity] > 0].groupby(["tumour", "variant"]):
                colour = TUMOURS[tumours.index(tumour) % len(TUMOURS)]
                shift = 1 + 0.03 * (np.log(part[other] / middle) / np.log(2))
                face = colour if variant == "SV" else "white"
                ax.plot(part[error] * shift, part[quantity], "o", ms=4, color=colour, mfc=face, mew=0.9)
                law = laws.get((title, variant))
                if law is not None and tumour in law.levels:
                    ends = np.array([rows[error].min(), rows[error].max()])
                    value = law.levels[tumour] * np.ones(2)
                    for name, at in ((error, ends), (other, middle)):
                        if name in law.exponents:
                            value = value * at ** law.exponents[name].mean
                    ax.plot(ends, value, color=colour, lw=1.1, ls="-" if variant == "SV" else "--")
            values = sorted(set(rows[error]))
            ax.set(xscale="log", yscale="log", title=f"{title}: against {'position' if k == 0 else 'tilt'}")
            ax.xaxis.set_minor_locator(NullLocator())
            ax.set_xticks(values, [f"{v:g}" for v in values])
            _plain(ax)
        row[0].set_ylabel(ylabel)
    for ax, error in zip(axes[-1], names, strict=True):
        ax.set_xlabel(ERROR_NAMES[error])
    most = max((rows["tumour"].nunique() for rows in sources.values()), default=1)
    handles = [
        Line2D([], [], color="0.3", marker="o", mfc=face, ls=line, ms=4, label=SHAPES[v])
        for v, face, line in (("SV", "0.3", "-"), ("CT", "white", "--"))
    ]
    handles += [
        Line2D([], [], color=TUMOURS[k], lw=2.5, label=f"tumour {k + 1}")
        for k in range(min(most, len(TUMOURS)))
    ]
    legend_below(figure, handles, 6)
    return figure


@styled()
def exponent_intervals(table: pd.DataFrame) -> Figure:
    """Exponents of both errors with their 95 % intervals; what has none says why.

    Parameters
    ----------
    table : DataFrame
        Of `study.experiments.kidney_words.exponents_of`.
    """
    which = ["whose", "variant", "quantity"]
    lines = table[which].drop_duplicates().reset_index(drop=True)
    figure, axes = new_axes(1, 2, (9.6, 0.9 + 0.3 * len(lines)), sharey=True)
    for ax, error in zip(axes[0], _SHORT, strict=True):
        rows = lines.merge(table[table["error"] == error], on=which, how="left")
        for row in rows.itertuples():
            if np.isnan(row.exponent):
                at = {"xy": (0.02, row.Index), "xycoords": ("axes fraction", "data")}
                ax.annotate(row.note, **at, va="center", fontsize=8, color="0.4")
                continue
            ax.errorbar(
                row.exponent, row.Index, xerr=np.nan_to_num(row.half_width_95), fmt="o", ms=5,
                color=COLOURS.get(row.variant, "0.3"), capsize=3, lw=1.2,
            )  # fmt: skip
        ax.axvline(0, color="0.35", lw=0.9, ls="--")
        ax.set_xlabel(_SHORT[error] + " (95 % interval)")
        _plain(ax)
    names = [
        f"{row.whose}: {QUANTITY_NAMES[row.quantity]}{'' if row.variant == 'both' else ', ' + row.variant}"
        for row in lines.itertuples()
    ]
    axes[0, 0].set_yticks(range(len(lines)), names)
    axes[0, 0].set_ylim(len(lines) - 0.5, -0.5)
    return figure


@styled()
def scatter_against_start(rows: pd.DataFrame, titles: Mapping[str, str]) -> Figure:
    """Scatter and bias of registrations over each tumour against the start's position error.

    Parameters
    ----------
    rows : DataFrame
        Of `study.experiments.kidney_margins.run_kidney_margins`.
    titles : mapping of str to str
        Runs to draw, one for each way to stop, and what to call them.
    """
    figure, axes = new_axes(1, 2, (9.0, 3.6), sharey=True, sharex=True)
    tumours = list(rows["tumour"].drop_duplicates())
    for ax, what in zip(axes[0], ("scatter_mm", "bias_mm"), strict=True):
        for run in titles:
            part = rows[(rows["run"] == run) & (rows["variant"] == rows["variant"].iloc[0])]
            for tumour, of_tumour in part.groupby("tumour"):
                colour = TUMOURS[tumours.index(tumour) % len(TUMOURS)]
                means = of_tumour.groupby("pos_std_mm")[what].mean()
                marker = RUN_MARKERS[run]
                line = "-" if run == "loose" else ":"
                ax.plot(means.index, means, color=colour, marker=marker, ms=4, lw=1.2, ls=line)
        values = sorted(set(rows["pos_std_mm"]))
        ax.set(xscale="log", yscale="log", title=f"rms {what.removesuffix('_mm')} over the tumour")
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xticks(values, [f"{v:g}" for v in values])
        ax.set_xlabel(ERROR_NAMES["pos_std_mm"])
        _plain(ax)
    axes[0, 0].set_ylabel("mm, mean over the tilts")
    handles = [
        Line2D(
            [], [], color="0.3", marker=RUN_MARKERS[run], ms=4, ls="-" if run == "loose" else ":", label=title
        )
        for run, title in titles.items()
    ]
    handles += [
        Line2D([], [], color=TUMOURS[k % len(TUMOURS)], lw=2.5, label=f"tumour {t}")
        for k, t in enumerate(tumours)
    ]
    legend_below(figure, handles, 6)
    return figure
