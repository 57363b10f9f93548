"""Table 3.2 and what follows from it in pictures: volumes, risk against volume, stopping rules."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from study.margins import ACCEPTABLE_RISKS
from study.plots.style import legend_below, new_axes, styled

COLOURS = {"SV": "#0072b2", "UT": "#d55e00"}
SHAPE_NAMES = {"SV": "spatially varying", "UT": "uniformly thick"}


def _name(structure: str) -> str:
    return structure.replace("_", " ")


def _structures(found: pd.Series) -> list[str]:
    present = set(found)
    return [name for name in ACCEPTABLE_RISKS if name in present]


@styled()
def margin_volumes(table: pd.DataFrame) -> Figure:
    """Mean volumes of margins with their intervals, printed and ours, a panel a voxel size.

    Parameters
    ----------
    table : DataFrame
        Of `study.experiments.margin_table.measured_table`.
    """
    table = table[table["quantity"] == "safety_margin_volume_mm3"]
    sizes = sorted(table.loc[table["n"] > 0, "voxel_size_mm"].unique(), reverse=True)
    structures = _structures(table["structure"])
    figure, axes = new_axes(1, len(sizes), (5.2 * len(sizes), 4.6), sharey=True, sharex=True)
    for ax, size in zip(axes[0], sizes, strict=True):
        for variant, shift in (("SV", -0.16), ("UT", 0.16)):
            rows = table[(table["voxel_size_mm"] == size) & (table["variant"] == variant)]
            rows = rows.set_index("structure").loc[structures]
            at = np.arange(len(structures)) + shift
            for source, aside, filled in (
                ("printed", -0.055, "white"),
                ("measured", 0.055, COLOURS[variant]),
            ):
                half = rows[f"{source}_plus_minus"].to_numpy()
                # a logarithmic axis has no place for what an interval holds below a fiftieth of its mean
                low = np.minimum(half, 0.98 * rows[source].to_numpy())
                ax.errorbar(
                    rows[source], at + aside, xerr=np.nan_to_num(np.stack([low, half])), fmt="o", ms=5,
                    color=COLOURS[variant], mfc=filled, lw=1.1, capsize=2.5,
                )  # fmt: skip
        ax.set(title=f"{size:g} mm voxels", xlabel="volume of the margin (mm³)", xscale="log")
        ax.set_yticks(range(len(structures)), [_name(s) for s in structures])
        ax.set_xticks([20, 50, 100, 200, 500, 1000], ["20", "50", "100", "200", "500", "1000"])
        ax.minorticks_off()
        ax.grid(axis="x", color="0.9")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].invert_yaxis()
    handles = [
        Line2D([], [], color=COLOURS[v], marker="o", ls="", mfc=face, label=f"{SHAPE_NAMES[v]}, {source}")
        for v in COLOURS
        for source, face in (("printed", "white"), ("ours", COLOURS[v]))
    ]
    legend_below(figure, handles, 4)
    return figure


@styled()
def risk_curves(curves: Mapping[tuple[str, str, float], pd.DataFrame], rows: pd.DataFrame) -> Figure:
    """Overall damage risk against the margin's volume, both shapes, all voxel sizes of one bone.

    Parameters
    ----------
    curves : mapping of (structure, variant, voxel size) to DataFrame
        Of `study.experiments.margin_table.run_margin_table`.
    rows : DataFrame
        Rows of the same bone: where each margin stopped.
    """
    sizes = sorted({size for *_, size in curves}, reverse=True)
    structures = _structures(pd.Series([structure for structure, *_ in curves]))
    figure, axes = new_axes(len(sizes), len(structures), (3.1 * len(structures), 2.9 * len(sizes)))
    ends = rows.set_index(["structure", "variant", "voxel_size_mm"])
    for row, size in enumerate(sizes):
        for ax, structure in zip(axes[row], structures, strict=True):
            acceptable = ACCEPTABLE_RISKS[structure]
            most, least = 0.0, acceptable / 10
            for variant, colour in COLOURS.items():
                curve = curves.get((structure, variant, size))
                if curve is None:
                    continue
                shown = curve[curve["risk"] > 0]
                ax.step(shown["volume_mm3"], shown["risk"], where="post", color=colour, lw=1.3)
                end = ends.loc[(structure, variant, size)]
                ax.plot(
                    end["safety_margin_volume_mm3"], end["final_damage_probability"], "o", color=colour, ms=5
                )
                most = max(most, end["safety_margin_volume_mm3"])
                least = min(least, end["final_damage_probability"] or least)
            ax.axhline(acceptable, color="0.35", lw=0.9, ls="--")
            ax.set(yscale="log", xlim=(0, 1.25 * most), ylim=(0.7 * least, 1.3))
            if row == 0:
                ax.set_title(_name(structure))
            if row == len(sizes) - 1:
                ax.set_xlabel("volume (mm³)")
            ax.spines[["top", "right"]].set_visible(False)
        axes[row, 0].set_ylabel(f"overall damage risk\n{size:g} mm voxels")
    handles = [Line2D([], [], color=c, marker="o", ms=5, label=SHAPE_NAMES[v]) for v, c in COLOURS.items()]
    handles.append(Line2D([], [], color="0.35", lw=0.9, ls="--", label="acceptable"))
    legend_below(figure, handles, 3)
    return figure


RULE_COLOURS = ("#b2182b", "#f4a261", "#2166ac")


@styled()
def stopping_rules(rows: pd.DataFrame) -> Figure:
    """True risk over the tolerance of every margin, rule by rule; a panel a structure.

    Parameters
    ----------
    rows : DataFrame
        Of `study.experiments.margin_confidence.run_rules`.
    """
    structures = _structures(rows["structure"])
    rules = list(dict.fromkeys(rows["rule"]))
    size = (5.0 * len(structures) + 1.4, 1.2 + 0.85 * len(rules))
    figure, axes = new_axes(1, len(structures), size, sharey=True, sharex=True)
    low, high = rows["true_over_tolerance"].min(), rows["true_over_tolerance"].max()
    for ax, structure in zip(axes[0], structures, strict=True):
        ax.axvspan(1, 10, color="#fbeaea", lw=0)
        ax.axvline(1, color="0.35", lw=0.9, ls="--")
        for at, rule in enumerate(rules):
            group = rows[(rows["structure"] == structure) & (rows["rule"] == rule)]
            # margins that came out alike lie on top of each other: spread over the height by run
            height = at + np.linspace(-0.24, 0.24, len(group)) * (len(group) > 1)
            values = group["true_over_tolerance"]
            colour = RULE_COLOURS[at % len(RULE_COLOURS)]
            ends = values - group["true_low"] / group["tolerance"], group["true_high"] / group["tolerance"]
            errors = np.stack([ends[0], ends[1] - values])
            ax.errorbar(values, height, xerr=errors, fmt="o", ms=4, color=colour, lw=0.7, alpha=0.85)
            ax.plot([values.median()] * 2, [at - 0.38, at + 0.38], color="black", lw=1.6)
        tolerance = rows.loc[rows["structure"] == structure, "tolerance"].iloc[0]
        ax.set(title=f"{_name(structure)}, tolerance {tolerance:g}", xlabel="true risk / tolerance")
        ax.set(xlim=(min(0.5, 0.9 * low), 1.1 * max(high, 1.2)))
        ax.set_yticks(range(len(rules)), rules)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].invert_yaxis()
    dot = {"marker": "o", "ls": "", "color": "0.4"}
    handles = [
        Line2D([], [], **dot, label="a margin, with the 95 % interval of its true risk"),
        Line2D([], [], color="black", lw=1.6, label="median"),
    ]
    legend_below(figure, handles, 2)
    return figure
