"""A hole to the cochlea in figures: what lies around it in the facial recess, and risk against accuracy."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Ellipse
from scipy import stats

from study.errors import InputError
from study.guidance.access import AccessPlan, drill_axes
from study.plots.palette import colour_of, style_of
from study.plots.style import label_image, legend_below, new_axes, patches, styled

#: Shares of drills whose axes lie in the ellipses drawn.
LEVELS = (0.5, 0.999)
_MISS, _HIT = "#2b2b2b", "#d1372c"
_RINGS = 40  # more hide what they are drawn on
_STEP = 0.05  # mm between samples of a section


def recess_depth(plan: AccessPlan) -> float:
    """How far from the entry the drill passes nearest to the facial nerve, as a share of its way."""
    voxels = plan.around.surfaces["facial_nerve"]
    line = plan.target - plan.entry
    share = np.clip((voxels - plan.entry) @ line / (line @ line), 0.0, 1.0)
    distance = np.linalg.norm(voxels - plan.entry - share[:, None] * line, axis=1)
    return float(share[np.argmin(distance)])


def section_across(plan: AccessPlan, share: float, half_width: float) -> tuple[np.ndarray, np.ndarray]:
    """Labels (n, n) on a square across the drill, rows upwards, and (n,) mm along both axes.

    Parameters
    ----------
    plan : AccessPlan
    share : float
        Where along the drill: 0 at the entry, 1 at the target.
    half_width : float
        mm.
    """
    axes = drill_axes(plan.entry, plan.target)
    middle = plan.entry + share * (plan.target - plan.entry)
    steps = np.arange(-half_width, half_width + _STEP / 2, _STEP)
    points = middle + steps[:, None, None] * axes[:, 1] + steps[None, :, None] * axes[:, 0]
    places = np.rint(plan.anatomy.indices(points.reshape(-1, 3))).astype(int)
    inside = ((places >= 0) & (places < plan.anatomy.shape)).all(axis=1)
    labels = np.zeros(len(places), np.uint8)
    labels[inside] = plan.anatomy.labels[tuple(places[inside].T)]
    return labels.reshape(len(steps), len(steps)), steps


def axes_at(plan: AccessPlan, share: float) -> np.ndarray:
    """(n, 2) mm across the drill by which the axes of erring drills miss the planned one at a depth."""
    errors = plan.risks.errors @ drill_axes(plan.entry, plan.target)
    return ((1 - share) * errors[:, 0] + share * errors[:, 1])[:, :2]


def ellipse(points: np.ndarray, level: float, **style) -> Ellipse:
    """Where a plane normal distribution with the points' moments has this share (chi-squared, two)."""
    values, vectors = np.linalg.eigh(np.cov(points.T))
    size = 2 * np.sqrt(stats.chi2.ppf(level, 2) * np.maximum(values, 0.0))
    angle = np.rad2deg(np.arctan2(vectors[1, 1], vectors[0, 1]))
    return Ellipse(points.mean(axis=0), size[1], size[0], angle=angle, fill=False, **style)


@styled()
def recess_sections(plans: Mapping[str, AccessPlan], half_width: float = 4.0, drills: int = 200) -> Figure:
    """The facial recess across the drill, one panel an error: planned drill, erring axes, ellipses.

    Parameters
    ----------
    plans : mapping of str to AccessPlan
        Title -> the same hole or others; each is cut where it passes nearest to the facial nerve.
    half_width : float
        mm shown to each side.
    drills : int
        Erring axes drawn as points; some of the drills that touch the facial nerve are outlined.

    Raises
    ------
    InputError
        If there is no plan.
    """
    if not plans:
        raise InputError("plans: expected at least one, got none")
    figure, grid = new_axes(1, len(plans), (4.1 * len(plans), 4.9))
    shown: dict[str, None] = {}
    for axes, (title, plan) in zip(grid[0], plans.items(), strict=True):
        share = recess_depth(plan)
        labels, steps = section_across(plan, share, half_width)
        names = {value: name for name, value in plan.anatomy.names.items()}
        extent = (steps[0], steps[-1], steps[0], steps[-1])
        axes.imshow(label_image(labels, names), extent=extent, origin="lower", interpolation="nearest")
        shown |= dict.fromkeys(names[value] for value in np.unique(labels))
        found = axes_at(plan, share)
        hit = plan.risks.clearances[:, plan.risks.column("facial_nerve")] <= 0
        rings = [Circle(centre, plan.settings.drill_radius) for centre in found[hit][:_RINGS]]
        axes.add_collection(
            PatchCollection(rings, facecolors="none", edgecolors=_HIT, linewidths=0.5, alpha=0.6)
        )
        axes.plot(*found[:drills].T, ".", ms=1.6, color=_MISS, alpha=0.6)
        axes.add_patch(Circle((0, 0), plan.settings.drill_radius, fill=False, lw=1.8, color="black"))
        for level, line in zip(LEVELS, ("--", "-"), strict=True):
            axes.add_patch(ellipse(found, level, lw=1.6, ls=line, color="#0b3c8c", zorder=4))
        depth = (1 - share) * plan.length_mm
        touched = plan.risks.risk("facial_nerve")
        axes.set_title(
            f"{title}: nerve touched in {100 * touched.risk:.2g} %\n{depth:.1f} mm before the target"
        )
        axes.set(xlabel=f"{_across_name(plan)}, mm", ylabel="superior, mm", xlim=extent[:2], ylim=extent[:2])
    grouped = dict.fromkeys(sorted(shown, key=lambda name: style_of(name).title))
    handles = [
        *patches(*grouped),
        Line2D([], [], color="black", lw=1.8, marker="o", ms=9, mfc="none", ls="none", label="planned drill"),
        Line2D([], [], color=_MISS, marker=".", ls="none", label="erring axis"),
        Line2D([], [], color="#0b3c8c", ls="--", label="50 % of axes"),
        Line2D([], [], color="#0b3c8c", ls="-", label="99.9 % of axes"),
        Line2D(
            [], [], color=_HIT, marker="o", ms=9, mfc="none", ls="none", label="drill that touches the nerve"
        ),
    ]
    legend_below(figure, handles, columns=6)
    return figure


def _across_name(plan: AccessPlan) -> str:
    """What the drill's first axis points at."""
    return "posterior" if drill_axes(plan.entry, plan.target)[1, 0] > 0 else "anterior"


@styled()
def risk_against_accuracy(
    curve: pd.DataFrame, robots: pd.DataFrame, accepted: Mapping[str, float], required: float | None = None
) -> Figure:
    """Probability to touch structures against the robot's accuracy, with robots on it.

    Parameters
    ----------
    curve : pandas.DataFrame
        Of `study.guidance.access.risk_curve`.
    robots : pandas.DataFrame
        One row a robot and structure: robot, structure, target_std_mm, probability, low, high.
    accepted : mapping of str to float
        Structure -> accepted probability.
    required : float, optional
        mm at which the facial nerve's is met.
    """
    figure, grid = new_axes(1, 1, (8.6, 5.2))
    axes: Axes = grid[0, 0]
    floor = 0.5 * float(curve.loc[curve["high"] > 0, "high"].min())
    for structure, rows in curve.groupby("structure", sort=False):
        colour = _dark(structure)
        seen = rows[rows["probability"] > 0]
        axes.plot(
            seen["target_std_mm"], seen["probability"], color=colour, lw=2, label=style_of(structure).title
        )
        axes.fill_between(
            rows["target_std_mm"],
            np.maximum(rows["low"], floor),
            rows["high"],
            color=colour,
            alpha=0.18,
            lw=0,
        )
        axes.plot(
            rows["target_std_mm"], np.maximum(rows["normal_theory"], floor / 10), color=colour, lw=1, ls="--"
        )
        axes.axhline(accepted[structure], color=colour, lw=0.9, ls=":")
        axes.text(
            0.995, accepted[structure], f"accepted: {100 * accepted[structure]:g} %",
            transform=axes.get_yaxis_transform(), ha="right", va="bottom", fontsize=8.5, color=colour,
        )  # fmt: skip
    markers = "osD^vP*X"
    for number, (_, rows) in enumerate(robots.groupby("robot", sort=False)):
        for _, row in rows.iterrows():
            value = max(row["probability"], floor)
            error = [[max(value - max(row["low"], floor), 0)], [max(row["high"] - value, 0)]]
            axes.errorbar(
                row["target_std_mm"], value, error, fmt=markers[number % len(markers)], ms=6,
                color=_dark(row["structure"]), mec="black", mew=0.6, capsize=2, lw=1,
            )  # fmt: skip
    if required is not None:
        axes.axvline(required, color="black", lw=0.9, ls="-.")
        axes.text(
            required,
            0.97,
            f" {required:.2f} mm needed",
            transform=axes.get_xaxis_transform(),
            va="top",
            fontsize=8.5,
        )
    axes.set_yscale("log")
    axes.set(
        ylim=(floor, 1.0), xlim=(0, float(curve["target_std_mm"].max())),
        xlabel="error of the axis at the target, root mean square per direction across, mm",
        ylabel="probability to be touched",
    )  # fmt: skip
    handles, _ = axes.get_legend_handles_labels()
    handles = handles[: curve["structure"].nunique()]
    handles.append(Line2D([], [], color="black", ls="--", lw=1, label="normal theory, flat structures"))
    handles += [
        Line2D(
            [],
            [],
            color="white",
            marker=markers[n % len(markers)],
            mec="black",
            mfc="#bbbbbb",
            ls="none",
            label=name,
        )
        for n, name in enumerate(robots["robot"].unique())
    ]
    legend_below(figure, handles, columns=3)
    return figure


def _dark(structure: str) -> str:
    """The structure's colour, dark enough for a line on white."""
    return {"facial_nerve": "#b59b00"}.get(structure, colour_of(structure))
