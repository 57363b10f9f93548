"""Zheng's figures 1 and 2, and what Algorithm 1 and the exact method do at the same places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, PathPatch
from matplotlib.path import Path

from study.experiments.fixture_algorithm import HILL, METHODS, VALLEY, Decision, Place
from study.plots.style import legend_below, new_axes, new_figure, styled

TITLES = {
    "published": "Algorithm 1",
    "exact": "exact",
    "all planes": "every triangle's plane",
    "none": "none",
}
COLOURS = {"none": "#8c8c8c", "all planes": "#e69f00", "published": "#d55e00", "exact": "#0072b2"}
ANATOMY, ALLOWED, FORBIDDEN, INK = "#cfe3f1", "#b7dfb0", "#c8322d", "#23262b"
#: Edge of the square that everything is cut from, mm.
FAR = 40.0


def half_plane(normal: np.ndarray, point: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """The part of a convex polygon (n, 2) for which n.(y - p) >= 0; empty where there is none."""
    heights = (polygon - point) @ normal
    kept = []
    for a, b, ha, hb in zip(polygon, np.roll(polygon, -1, 0), heights, np.roll(heights, -1), strict=True):
        if ha >= 0:
            kept.append(a)
        if (ha >= 0) != (hb >= 0):
            kept.append(a + ha / (ha - hb) * (b - a))
    return np.array(kept).reshape(-1, 2)


def _square() -> np.ndarray:
    return FAR * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])


def _disc(centre: np.ndarray, radius: float) -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi, 181)[:-1]
    return centre + radius * np.c_[np.cos(angles), np.sin(angles)]


def allowed_part(normals: np.ndarray, points: np.ndarray, radius: float, polygon: np.ndarray) -> np.ndarray:
    """The part of a convex polygon where a tip's centre keeps its radius from all planes; (n, 2) mm."""
    for normal, point in zip(normals, points, strict=True):
        polygon = half_plane(normal, point + radius * normal, polygon) if len(polygon) else polygon
    return polygon


def _fill(axes: Axes, polygon: np.ndarray, **style) -> None:
    if len(polygon) > 2:
        axes.fill(*polygon.T, **style)


def _forbid(axes: Axes, normals: np.ndarray, points: np.ndarray, hatch: str = "xxx") -> None:
    """Hatch what lies behind any of the planes, once."""
    codes, corners = [], []
    for normal, point in zip(normals, points, strict=True):
        behind = half_plane(-normal, point, _square())
        if len(behind) < 3:
            continue
        corners += [*behind, behind[0]]
        codes += [Path.MOVETO, *[Path.LINETO] * (len(behind) - 1), Path.CLOSEPOLY]
    if corners:
        # Same sense of all parts, so that what lies behind two planes is not taken out again.
        axes.add_patch(
            PathPatch(
                Path(corners, codes), facecolor="none", edgecolor=FORBIDDEN, hatch=hatch, lw=0, zorder=1.5
            )
        )


def _arrow(axes: Axes, start: np.ndarray, way: np.ndarray, colour: str, **style) -> None:
    axes.annotate(
        "", start + way, start, zorder=6,
        arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.6, "shrinkA": 0, "shrinkB": 0} | style,
    )  # fmt: skip


def _anatomy(axes: Axes, profile: np.ndarray, bottom: float) -> None:
    outline = np.vstack([profile, [profile[-1, 0], bottom], [profile[0, 0], bottom]])
    axes.fill(*outline.T, color=ANATOMY, lw=0, zorder=1)
    axes.plot(*profile.T, color=INK, lw=1.6, zorder=4, marker="o", ms=3)


def _normals(profile: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals of a profile's segments, upwards, and their middles; (n - 1, 2)."""
    along = np.diff(profile, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.c_[-along[:, 1], along[:, 0]], (profile[1:] + profile[:-1]) / 2


def _bare(axes: Axes, x: tuple[float, float], y: tuple[float, float], title: str) -> None:
    axes.set(xlim=x, ylim=y, aspect="equal", xticks=[], yticks=[], title=title)
    for spine in axes.spines.values():
        spine.set_color("0.7")


@styled()
def plane_figure(radius: float = 0.0) -> Figure:
    """Figure 1: a plane, the motion sphere, what a cycle may reach; with a desired and the nearest motion.

    Parameters
    ----------
    radius : float
        Of the tip (feature 1), in radii of the motion sphere.
    """
    figure = new_figure((6.2, 4.4))
    axes = figure.subplots()
    normal = np.array([np.sin(0.35), np.cos(0.35)])
    point, x = np.array([0.25, -0.45]), np.zeros(2)
    desired = np.array([0.42, -0.82])
    sphere = _disc(x, 1.0)
    _fill(axes, half_plane(normal, point + radius * normal, sphere), color=ALLOWED, lw=0)
    behind = half_plane(-normal, point + radius * normal, sphere)
    _fill(axes, behind, facecolor="none", edgecolor=FORBIDDEN, hatch="xxx", lw=0)
    axes.plot(*_disc(x, 1.0)[np.r_[0:180, 0]].T, color=INK, lw=1.2)
    along = np.array([normal[1], -normal[0]])
    axes.plot(*np.array([point - 1.7 * along, point + 1.3 * along]).T, color=INK, lw=2)
    short = max(0.0, radius - normal @ (x - point) - normal @ desired)
    _arrow(axes, x, desired, "0.45", linestyle="--")
    _arrow(axes, x, desired + short * normal, COLOURS["exact"])
    _arrow(axes, point, 0.5 * normal, INK)
    axes.plot(*point, "o", color=INK, ms=5)
    axes.plot(*x, "o", color=COLOURS["exact"], ms=6, zorder=7)
    if radius:
        axes.add_patch(Circle(x, radius, fill=False, color=COLOURS["exact"], lw=1.2))
    given = desired + short * normal
    for text, at, offset, colour in (
        (r"$\mathbf{x}$", x, (-0.11, 0.05), INK),
        (r"$\mathbf{p}$", point, (-0.02, -0.16), INK),
        (r"$\mathbf{n}$", point + 0.5 * normal, (0.05, 0.0), INK),
        (r"$\Delta\mathbf{x}_d$", desired, (0.04, -0.1), "0.35"),
        (r"$\Delta\mathbf{x}$", given, (0.05, 0.0), COLOURS["exact"]),
    ):
        axes.text(*(at + offset), text, color=colour, fontsize=12)
    handles = [
        Patch(facecolor=ALLOWED, label="allowed"),
        Patch(facecolor="none", edgecolor=FORBIDDEN, hatch="xxx", lw=0, label="forbidden"),
        Line2D([], [], color=INK, marker="o", mfc="none", ms=10, lw=0, label="longest motion of a cycle"),
    ]
    _bare(axes, (-1.75, 1.75), (-1.2, 1.15), "")
    legend_below(figure, handles, 3)
    return figure


@styled()
def convexity_figure() -> Figure:
    """Figure 2: a concave and a convex surface with their normals, and all triangles taken as planes."""
    figure, axes = new_axes(2, 2, (10.5, 7.0))
    for row, (profile, word, y) in enumerate(
        ((VALLEY, "concave", (-0.9, 3.0)), (HILL, "convex", (-2.3, 1.6)))
    ):
        normals, middles = _normals(profile)
        plain, naive = axes[row]
        for ax in (plain, naive):
            _anatomy(ax, profile, y[0] - 1)
        for normal, middle in zip(normals, middles, strict=True):
            _arrow(plain, middle, 0.55 * normal, INK)
        _fill(naive, allowed_part(normals, middles, 0.0, _square()), color=ALLOWED, lw=0, zorder=0.5)
        _forbid(naive, normals, middles)
        for normal, middle in zip(normals, middles, strict=True):
            along = np.array([normal[1], -normal[0]])
            naive.plot(
                *np.array([middle - 9 * along, middle + 9 * along]).T, color=FORBIDDEN, lw=0.8, zorder=2
            )
        _bare(plain, (-3.2, 3.2), y, f"({'ac'[row]}) locally {word}")
        _bare(naive, (-3.2, 3.2), y, f"({'bd'[row]}) every triangle's plane at once")
    handles = [
        Patch(facecolor=ANATOMY, label="anatomy"),
        Patch(facecolor=ALLOWED, label="allowed to a point"),
        Patch(facecolor="none", edgecolor=FORBIDDEN, hatch="xxx", lw=0, label="forbidden"),
    ]
    legend_below(figure, handles, 3)
    return figure


@styled()
def decisions_figure(places: Sequence[Place], decisions: Sequence[Sequence[Decision]]) -> Figure:
    """What methods make of places, drawn from what the code answered.

    Parameters
    ----------
    places : sequence of Place
        A column each.
    decisions : sequence of sequences of Decision
        A row for each method, in it one for each place.
    """
    figure, axes = new_axes(len(decisions), len(places), (3.4 * len(places), 3.45 * len(decisions)))
    for row, line in enumerate(decisions):
        for place, decision, ax in zip(places, line, axes[row], strict=True):
            _decision(ax, place, decision)
            if row == 0:
                ax.set_title(place.title)
        axes[row, 0].set_ylabel(TITLES[line[0].method], fontsize=11)
    handles = [
        Patch(facecolor=ANATOMY, label="anatomy"),
        Patch(facecolor=ALLOWED, label="left to the centre by these planes"),
        Patch(facecolor="none", edgecolor=FORBIDDEN, hatch="xx", lw=0, label="behind a plane"),
        Line2D([], [], color="#cc79a7", lw=3.5, label="turned round"),
        Line2D([], [], color="0.45", ls="--", lw=1.6, label="desired motion"),
        Line2D([], [], color=COLOURS["exact"], lw=1.6, label="motion given"),
    ]
    legend_below(figure, handles, 6)
    return figure


def _decision(ax: Axes, place: Place, decision: Decision) -> None:
    x, profile = place.position, place.profile
    colour = COLOURS[decision.method]
    low = min(profile[:, 1].min(), -1.0) - 3
    _anatomy(ax, profile, low)
    segments = np.stack([profile[:-1], profile[1:]], axis=1)
    for k in place.turned:
        ax.plot(*segments[k].T, color="#cc79a7", lw=3.5, zorder=4.5)
    _forbid(ax, decision.normals, decision.points, "xx")
    for normal, point in zip(decision.normals, decision.points, strict=True):
        along = np.array([normal[1], -normal[0]])
        ax.plot(*np.array([point - 9 * along, point + 9 * along]).T, color=FORBIDDEN, lw=0.9, zorder=3)
        ax.plot(*point, "o", color=FORBIDDEN, ms=4, zorder=5)
    reach = allowed_part(decision.normals, decision.points, place.radius, _disc(x, place.max_step))
    _fill(ax, reach, color=ALLOWED, lw=0, alpha=0.9, zorder=2)
    ax.add_patch(Circle(x, place.max_step, fill=False, color="0.5", lw=0.8, ls=":", zorder=3))
    ax.add_patch(Circle(x, place.radius, fill=False, color=colour, lw=1.3, ls="--", zorder=5))
    ax.add_patch(Circle(x + decision.motion, place.radius, color=colour, alpha=0.25, lw=0, zorder=3.5))
    ax.add_patch(Circle(x + decision.motion, place.radius, fill=False, color=colour, lw=1.5, zorder=5))
    _arrow(ax, x, place.desired, "0.45", linestyle="--")
    if decision.motion.any():
        _arrow(ax, x, decision.motion, colour)
    ax.plot(*x, "o", color=colour, ms=4, zorder=7)
    told = (
        "stops" if decision.stopped else f"{len(decision.normals)} plane{'s' * (len(decision.normals) != 1)}"
    )
    if decision.distance < -1e-6:
        told += f", {-decision.distance:.2f} mm too near"
    ax.text(
        0.03, 0.97, told, transform=ax.transAxes, va="top", fontsize=9, zorder=9,
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 2},
    )  # fmt: skip
    _bare(ax, (x[0] - 2.1, x[0] + 2.1), (x[1] - 2.1, x[1] + 1.9), "")


@styled()
def comparison_figure(table: pd.DataFrame) -> Figure:
    """Pushes that entered, pushes that got stuck and progress, by surface and method.

    Parameters
    ----------
    table : DataFrame
        Of `study.experiments.fixture_pushes.comparison`.
    """
    names = list(dict.fromkeys(table["surface"]))
    figure, axes = new_axes(1, 3, (12.5, 0.62 * len(names) + 1.5), sharey=True)
    columns = (
        ("entered_pct", "pushes that entered (%)"),
        ("stuck_pct", "pushes that ended in a stop (%)"),
        ("progress_ratio", "length made of what was asked"),
    )
    for ax, (column, label) in zip(axes[0], columns, strict=True):
        for k, method in enumerate(METHODS):
            rows = table[table["method"] == method].set_index("surface").loc[names]
            y = np.arange(len(names)) + 0.2 * (k - 1.5)
            ax.barh(y, rows[column], height=0.18, color=COLOURS[method])
            ax.plot(rows[column], y, "|", color=COLOURS[method], ms=6, mew=1.8)
        ax.set(xlabel=label, xlim=(0, None))
        ax.grid(axis="x", color="0.92")
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_yticks(range(len(names)), names)
    axes[0, 0].invert_yaxis()
    legend_below(figure, [Patch(color=COLOURS[method], label=TITLES[method]) for method in METHODS], 4)
    return figure
