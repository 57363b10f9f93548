"""Pictures of the findings; each function returns a matplotlib figure that is not registered with pyplot."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from scipy import stats

from study import published
from study.audit import baron, chapter2, chapter2_claims, chapter3, chapter4

_BLUE, _ORANGE, _GREY = "#2a6f97", "#d1603d", "#7a7a7a"


def intervals() -> Figure:
    """Return +- against mean of the 38 columns, printed and correct, with the line of slope 1.96/6 (E1)."""
    table = chapter2.corrected_intervals()
    printed = table["printed_plus_minus"].astype(float)
    shown, right = printed > 0, table["t_half_width"] > 0
    figure, (left, by_ratio) = _panels(2)
    mean = table["mean"]
    ends = np.array([mean[mean > 0].min() / 2, mean.max() * 2])
    left.loglog(ends, ends * 1.96 / 6, color=_GREY, lw=1, label="mean × 1.96/6")
    left.loglog(mean[shown], printed[shown], "o", color=_ORANGE, ms=5, label="printed ±")
    left.loglog(
        mean[right], table["t_half_width"][right], "x", color=_BLUE, ms=6, label="95 % t interval of the rows"
    )
    left.set(xlabel="mean of a column, its own unit", ylabel="±", title="Tables A.1 to A.4: 38 columns")
    left.legend(frameon=False)
    ratio = table["printed_over_t"].dropna()
    by_ratio.hist(np.log10(ratio), bins=20, color=_ORANGE)
    by_ratio.axvline(0, color=_GREY, lw=1)
    ticks = np.array([0.3, 1, 3, 10])
    by_ratio.set_xticks(np.log10(ticks), [f"{t:g}" for t in ticks])
    by_ratio.set(
        xlabel="printed ± / right ±", ylabel="columns", title="Too narrow left of 1, too wide right of it"
    )
    return figure


def length_factor() -> Figure:
    """Return speed x time / length of the 72 rows of A.1 and A.2, and their speeds (E2)."""
    table = chapter2.lengths_are_centimetres().evidence
    figure, (left, right) = _panels(2)
    for name, colour in (("A.1", _BLUE), ("A.2", _ORANGE)):
        rows = table[table["table"] == name]
        left.hist(
            rows["speed_times_time_over_length"],
            bins=np.linspace(9.8, 10.2, 17),
            color=colour,
            alpha=0.7,
            label=f"{name} {'zigzag' if name == 'A.1' else '3-D'}",
        )
        right.hist(
            rows["length_over_time"], bins=np.linspace(0.3, 0.55, 26), color=colour, alpha=0.7, label=name
        )
    left.set(xlabel="printed speed × printed time / printed length", ylabel="rows", title="It should be 1")
    left.legend(frameon=False)
    slowest = published.parameter("burr_speed_min").value
    right.axvline(slowest, color=_GREY, lw=1.5)
    right.annotate("least feed", (slowest, right.get_ylim()[1] * 0.9), (4, 0), textcoords="offset points")
    right.set(
        xlabel="printed length / printed time (mm/s as labelled)", ylabel="rows", title="Slower than the feed"
    )
    return figure


def milling_slopes() -> Figure:
    """Return slopes of milling time over volume with 95 % intervals, by the bones that they rest on (I4)."""
    table = chapter2_claims.slopes()
    figure, axes = _panels(2)
    for axis, (strategy, group) in zip(axes, table.groupby("milled_with", sort=False), strict=True):
        place = np.arange(len(group))[::-1]
        colour = [_ORANGE if over.startswith("experiment") else _BLUE for over in group["over"]]
        axis.errorbar(group["slope_s_per_cm3"], place, xerr=group["half_width_95"], fmt="none", ecolor=_GREY)
        axis.scatter(group["slope_s_per_cm3"], place, c=colour, zorder=3)
        axis.set_yticks(place, [f"{over} ({n})" for over, n in zip(group["over"], group["n"], strict=True)])
        title = {"zigzag": "Zigzag", "3d": "3-D"}[strategy]
        axis.set(xlabel="slope (s/cm³)", title=f"{title}: real orange, predicted blue")
    return figure


def contact_products() -> Figure:
    """Return length x contact share x voxels per step over removed bone, both strategies (I1)."""
    table = chapter2_claims.contact_columns_disagree().evidence
    figure, (axis,) = _panels(1)
    bins = np.linspace(0.5, 2.8, 24)
    axis.hist(table["zigzag_counted_over_removed"], bins=bins, color=_BLUE, alpha=0.7, label="zigzag")
    axis.hist(table["3d_counted_over_removed"], bins=bins, color=_ORANGE, alpha=0.7, label="3-D")
    axis.axvline(1, color=_GREY, lw=1.5)
    axis.set(
        xlabel="bone counted step by step / bone removed", ylabel="bones", title="It should be 1 for both"
    )
    axis.legend(frameon=False)
    return figure


def margin_changes() -> Figure:
    """Return the volume of spatially varying margins against that of thick ones (I10, C4.2)."""
    table = chapter3.pairs(chapter3.VOLUME)
    figure, (left, right) = _panels(2)
    structures = list(dict.fromkeys(table["structure"]))
    place = np.arange(len(structures))
    for size, colour, shift in ((0.4, _ORANGE, -0.2), (0.2, _BLUE, 0.2)):
        rows = table[table["voxel_size_mm"] == size].set_index("structure").loc[structures]
        left.barh(place + shift, rows["change_pct"], 0.38, color=colour, label=f"{size} mm voxels")
    left.axvline(0, color=_GREY, lw=1)
    left.set_yticks(place, [name.replace("_", " ") for name in structures])
    left.set(xlabel="spatially varying against uniform volume (%)", title="Table 3.2")
    left.legend(frameon=False)
    kidneys = chapter4.varying_margins_are_smaller().evidence
    right.hist(kidneys["sv_over_ct"], bins=np.linspace(0.2, 1.1, 19), color=_BLUE)
    right.axvline(1, color=_GREY, lw=1.5)
    right.set(xlabel="spatially varying / constant volume", ylabel="pairs", title="Tables B.1 to B.9")
    return figure


def final_risks() -> Figure:
    """Return the final damage probabilities of appendix B; some cannot be k/5000 (I23, I24)."""
    table = published.appendix_b()
    units = table[chapter4.RISK] * 1e4
    # below 0.01 the printed digits resolve 1e-4
    odd = (table[chapter4.RISK] < 0.01) & (units.round() % 2 == 1)
    figure, (axis,) = _panels(1)
    bins = np.arange(-0.5, 151.5, 1)
    axis.hist(units[~odd], bins=bins, color=_BLUE, label="may be k/5000")
    axis.hist(units[odd], bins=bins, color=_ORANGE, label="cannot be k/5000")
    axis.axvline(1e4 * published.parameter("acceptable_risk").value + 0.5, color=_GREY, lw=1.5, ls="--")
    axis.set(
        xlabel="final damage probability (10⁻⁴)",
        ylabel="margins",
        title="Dashed: the acceptable 0.01; right of it too much",
    )
    axis.legend(frameon=False, loc="upper left")
    return figure


def confidence_regions() -> Figure:
    """Return the printed and the right 99.9 % ellipse of the four drilling experiments, mm (E6)."""
    table = baron.rows()
    figure, axes = _panels(4)
    printed, right = stats.norm.isf((1 - baron.LEVEL) / 2), baron.planar_quantile()
    for axis, (name, row) in zip(axes, table.iterrows(), strict=True):
        mean = (row["mean_x_mm"], row["mean_y_mm"])
        # the sign of the correlation is not printed: axes of the ellipse are drawn along x and y
        spread = (row["std_x_mm"], row["std_y_mm"])
        for factor, colour, text in ((printed, _ORANGE, "as printed"), (right, _BLUE, "99.9 %")):
            size = [2 * factor * s for s in spread]
            axis.add_patch(Ellipse(mean, *size, fill=False, ec=colour, lw=1.5, label=text))
        axis.plot(*mean, "+", color=_GREY)
        axis.add_patch(Ellipse((0, 0), 2, 2, fill=False, ec=_GREY, ls=":"))
        axis.set(
            xlim=(-1.1, 1.1), ylim=(-1.1, 1.1), aspect="equal", title=name.capitalize(), xlabel="Δx (mm)"
        )
    axes[0].set_ylabel("Δy (mm); dotted: 1 mm")
    axes[0].legend(frameon=False, fontsize=8, loc="lower right")
    return figure


ALL = {
    "intervals": intervals,
    "length_factor": length_factor,
    "milling_slopes": milling_slopes,
    "contact_products": contact_products,
    "margin_changes": margin_changes,
    "final_risks": final_risks,
    "confidence_regions": confidence_regions,
}
"""Every picture by the name it is saved under."""


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(5.2 * count if count < 3 else 3.2 * count, 3.6), layout="constrained")
    axes = list(np.ravel(figure.subplots(1, count)))
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    return figure, axes
