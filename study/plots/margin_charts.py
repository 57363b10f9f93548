"""Figure 3.3: how a margin is found, by the printed loop and by one sweep."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Polygon

from study.plots.style import new_axes, styled

_COLOURS = {"do": "#e4eef7", "simulate": "#e6dff2", "end": "#dff0e0"}
_LINE = "#333333"


def _box(axes: Axes, y: float, text: str, kind: str = "do", height: float = 1.1, x: float = 0.0) -> None:
    if kind == "ask":
        ring = [(x, y + 0.95), (x + 2.6, y), (x, y - 0.95), (x - 2.6, y)]
        axes.add_patch(Polygon(ring, facecolor="#fdf1dc", edgecolor=_LINE))
    else:
        axes.add_patch(
            FancyBboxPatch(
                (x - 2.6, y - height / 2), 5.2, height, boxstyle="round,pad=0.02,rounding_size=0.15",
                facecolor=_COLOURS[kind], edgecolor=_LINE,
            )
        )  # fmt: skip
    axes.text(x, y, text, ha="center", va="center", fontsize=9.5)


def _arrow(
    axes: Axes, *points: tuple[float, float], text: str = "", at: tuple[float, float] = (0, 0)
) -> None:
    way = np.array(points, float)
    axes.plot(*way[:-1].T, color=_LINE, lw=1.2)
    head = {"arrowstyle": "-|>", "color": _LINE, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", way[-1], way[-2], arrowprops=head)
    if text:
        axes.text(*at, text, fontsize=9.5, va="center", ha="left")


@styled()
def method_charts() -> Figure:
    """Figure 3.3: the printed loop of 3.2.1, and the order statistic that gives the same kind of margin."""
    figure, axes = new_axes(1, 2, (12, 8.4))
    for ax, title in zip(
        axes[0],
        ("(a) published: grow, simulate, look again", "(b) exact: rank once, simulate once, choose"),
        strict=True,
    ):
        ax.set(xlim=(-4.2, 4.2), ylim=(-10.9, 0.9), title=title)
        ax.set_aspect("equal")
        ax.set_axis_off()
    loop, sweep = axes[0]
    _box(loop, 0, "margin: no voxel\nanalyzed shell: all neighbours of the structure")
    _box(
        loop, -2.0, "simulate N fresh registrations;\noverall damage risk: share that carries\n"
        "a corner of the shell into the structure", "simulate", 1.5,
    )  # fmt: skip
    _box(loop, -4.4, "risk at most the\nacceptable one?", "ask")
    _box(loop, -6.8, "point damage risk of each voxel of the shell\n(smallest Mahalanobis distance)")
    _box(loop, -8.7, "the riskiest per cent of the shell enter the\nmargin; fewer as the risk comes near")
    _box(loop, -10.3, "the margin", "end", 0.7)
    _arrow(loop, (0, -0.57), (0, -1.23))
    _arrow(loop, (0, -2.77), (0, -3.43))
    _arrow(loop, (0, -5.37), (0, -6.23), text="no", at=(0.15, -5.7))
    _arrow(loop, (0, -7.37), (0, -8.13))
    _arrow(loop, (-2.62, -8.7), (-3.6, -8.7), (-3.6, -2.0), (-2.64, -2.0))
    _arrow(loop, (2.6, -4.4), (3.6, -4.4), (3.6, -10.3), (2.64, -10.3), text="yes", at=(2.75, -4.1))
    _box(
        sweep, 0, "rank all voxels near the structure once, by\nsmallest Mahalanobis distance: the order\n"
        "in which they would enter a margin", height=1.5,
    )  # fmt: skip
    _box(sweep, -2.2, "simulate N registrations once", "simulate", 0.8)
    _box(
        sweep, -4.2, "for each registration: the highest rank of a\nvoxel that it carries into the structure"
        "\n= the size of margin that makes it harmless", height=1.5,
    )  # fmt: skip
    _box(sweep, -6.4, "sort the N sizes: the whole curve of\nrisk against margin")
    _box(
        sweep, -8.4, "allow m harmful registrations of N, so that\nthe true risk is acceptable with 95 % "
        "confidence;\nthe margin is the (m + 1)-th largest size", height=1.5,
    )  # fmt: skip
    _box(sweep, -10.3, "the margin; its risk on fresh registrations", "end", 0.7)
    for top, bottom in ((-0.77, -1.77), (-2.62, -3.43), (-4.97, -5.83), (-6.97, -7.63), (-9.17, -9.93)):
        _arrow(sweep, (0, top), (0, bottom))
    return figure
