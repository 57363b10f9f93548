"""Tables 4.2 and B.1 to B.9 in pictures: volumes, risk against volume, exponents, scatter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

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
_STOP_LOOKS = {"loose": ("o", "-"), "converged": ("^", ":")}
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
    volumes = beside[beside["quantity"] == "margin_volume_mm3"]
    values = volumes[list(titles)].to_numpy(dtype=float)
    edge = 0.5 * values[values > 0].min()
    lines = [
        (f"tumour {tumour}", source, part[source].dropna())
        for tumour, part in volumes.set_index("variant").groupby("tumour")
        for source in titles
        if part[source].notna().any()
    ]
    figure, axes = new_axes(1, 1, (8.2, 1.3 + 0.24 * (len(lines) + len({line[0] for line in lines}))))
    ax, ticks, at, before = axes[0, 0], {}, 0, ""
    for tumour, source, part in lines:
        at += 1 if tumour == before else 2
        ticks[at] = titles[source] if tumour == before else f"{tumour}, {titles[source]}"
        before = tumour
        shown = part.where(part > 0, edge)
        if len(shown) > 1:
            ax.plot(shown, [at] * len(shown), color="0.75", lw=1.2, zorder=1)
        for variant, value in shown.items():
            face = "white" if source == "printed" else COLOURS[variant]
            ax.plot(value, at, "<" if part[variant] == 0 else "o", ms=6, color=COLOURS[variant], mfc=face)
    ax.set(xscale="log", xlabel="volume of the margin (mm³)", ylim=(at + 1, 1))
    marks = [k * 10**p for p in range(1, 7) for k in (1, 2, 5)]
    shown = [mark for mark in marks if 0.8 * edge < mark < 1.2 * values[values > 0].max()]
    ax.set_xticks(shown, [f"{mark:,}".replace(",", " ") for mark in shown])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_yticks(list(ticks), list(ticks.values()))
    _plain(ax)
    handles = [
        Line2D([], [], color=COLOURS[v], marker="o", ls="", mfc=face, label=f"{name}, {source}")
        for v, name in SHAPES.items()
        for source, face in (("printed", "white"), ("ours", COLOURS[v]))
    ]
    if (values == 0).any():
        handles.append(Line2D([], [], color="0.4", marker="<", ls="", label="empty, at the edge"))
    legend_below(figure, handles, 2)
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
    figure, axes = new_axes(len(sources), 2, (9.4, 2.9 * len(sources) + 0.5), sharey=True, sharex="col")
    names = tuple(ERROR_NAMES)
    ticks = {error: sorted(set().union(*(rows[error] for rows in sources.values()))) for error in names}
    for row, (title, rows) in zip(axes, sources.items(), strict=True):
        for k, (ax, error) in enumerate(zip(row, names, strict=True)):
            other = names[1 - k]
            middle = np.exp(np.log(rows[other]).mean())
            for (tumour, variant), part in rows[rows[quantity] > 0].groupby(["tumour", "variant"]):
                colour = _of_tumour(tumour)
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
            ax.set(xscale="log", yscale="log", title=f"{title}: against {'position' if k == 0 else 'tilt'}")
            ax.xaxis.set_minor_locator(NullLocator())
            ax.set_xticks(ticks[error], [f"{v:g}" for v in ticks[error]])
            _plain(ax)
        row[0].set_ylabel(ylabel)
    for ax, error in zip(axes[-1], names, strict=True):
        ax.set_xlabel(ERROR_NAMES[error])
    tumours = sorted(set().union(*(rows["tumour"] for rows in sources.values())))
    handles = [
        Line2D([], [], color="0.3", marker="o", mfc=face, ls=line, ms=4, label=SHAPES[v])
        for v, face, line in (("SV", "0.3", "-"), ("CT", "white", "--"))
    ]
    handles += _tumour_handles(tumours)
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
        Ways to stop, and what to call them.
    """
    figure, axes = new_axes(1, 2, (9.0, 3.6), sharex=True)
    each = rows.drop_duplicates(["stop", "tumour", "pos_std_mm", "rot_std_deg"])
    ticks = sorted(set(rows["pos_std_mm"]))
    for ax, what in zip(axes[0], ("scatter_mm", "bias_mm"), strict=True):
        for (stop, tumour), part in each.groupby(["stop", "tumour"]):
            means = part.groupby("pos_std_mm")[what].mean()
            marker, line = _STOP_LOOKS[stop]
            ax.plot(means.index, means, color=_of_tumour(tumour), marker=marker, ms=4, lw=1.2, ls=line)
        ax.set(xscale="log", title=f"rms {what.removesuffix('_mm')} over the tumour (mm)")
        ax.set_ylim(bottom=0)
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xticks(ticks, [f"{v:g}" for v in ticks])
        ax.set_xlabel(ERROR_NAMES["pos_std_mm"])
        _plain(ax)
    axes[0, 0].set_ylabel("mean over the tilts (mm)")
    handles = [
        Line2D([], [], color="0.3", marker=_STOP_LOOKS[stop][0], ms=4, ls=_STOP_LOOKS[stop][1], label=title)
        for stop, title in titles.items()
    ]
    handles += _tumour_handles(sorted(set(rows["tumour"])))
    legend_below(figure, handles, 6)
    return figure


def _of_tumour(number: int) -> str:
    return TUMOURS[(number - 1) % len(TUMOURS)]


def _tumour_handles(tumours: Sequence[int]) -> list[Line2D]:
    return [Line2D([], [], color=_of_tumour(t), lw=2.5, label=f"tumour {t}") for t in tumours]
