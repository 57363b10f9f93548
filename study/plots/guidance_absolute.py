"""Figure 12 of Baron: planned and drilled axes in the acrylic block."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from study.guidance import DrilledHole, acrylic_block
from study.plots.style import legend_below, new_axes, styled

_HOLE, _PLAN, _DRILLED, _SPHERE = "#8cc5e3", "#c8322d", "#0055a4", "#4a4f57"


@styled()
def planned_and_drilled(holes: Sequence[DrilledHole], diameter_mm: float, shown: int = 0) -> Figure:
    """The block from two sides with all holes, and one of them with its deviations enlarged.

    Parameters
    ----------
    holes : sequence of DrilledHole
        Of `study.guidance.acrylic_block`.
    diameter_mm : float
        Of the drilled tube.
    shown : int
        Hole of the third picture.
    """
    spheres = acrylic_block().spheres
    figure, axes = new_axes(1, 3, (12.4, 4.3), width_ratios=(1.3, 1.0, 1.0))
    middles = []
    for hole in holes:
        depths = np.append(np.arange(0.0, hole.length - 0.9, 1.0), hole.length - 1.0)
        middles.append((depths, np.array([hole.centre(depth) for depth in depths])))
    for ax, axis, name in ((axes[0, 0], 0, "x"), (axes[0, 1], 1, "y")):
        for hole, (_, middle) in zip(holes, middles, strict=True):
            ends = np.stack([hole.entry, hole.entry + hole.length * hole.direction])
            way = np.vstack([middle, hole.bottom])
            for side in (-1, 1):
                ax.plot(way[:, axis] + side * diameter_mm / 2, way[:, 2], color=_HOLE, lw=0.8)
            low, high = way[:, axis] - diameter_mm / 2, way[:, axis] + diameter_mm / 2
            ax.fill_betweenx(way[:, 2], low, high, color=_HOLE, alpha=0.7)
            ax.plot(way[:, axis], way[:, 2], color=_DRILLED, lw=1.0)
            ax.plot(ends[:, axis], ends[:, 2], color=_PLAN, lw=1.0, ls="--")
        ax.plot(spheres[:, axis], spheres[:, 2], "o", ms=8, color=_SPHERE)
        ax.set(
            xlabel=f"{name} (mm)", ylabel="depth (mm)", title=f"({'ab'[axis]}) all holes along {'yx'[axis]}"
        )
        ax.set_aspect("equal")
        ax.invert_yaxis()
    ax = axes[0, 2]
    hole, (depths, middle) = holes[shown], middles[shown]
    off = middle - (hole.entry + depths[:, None] * hole.direction)
    for axis, line in ((0, "-"), (1, "--")):
        ax.plot(off[:, axis], depths, color=_DRILLED, ls=line)
    ax.axvline(0, color=_PLAN, lw=1.2)
    end = hole.bottom - (hole.entry + hole.length * hole.direction)
    ax.plot(end[:2], [hole.length + end @ hole.direction] * 2, "o", ms=4, color=_DRILLED)
    ax.axhline(hole.length, color="#00000040", lw=0.8)
    ax.set(xlabel="off the plan (mm)", ylabel="along the plan (mm)", title=f"(c) hole {shown + 1}, enlarged")
    ax.invert_yaxis()
    handles = [
        Line2D([], [], color=_PLAN, ls="--", label="planned axis"),
        Line2D([], [], color=_DRILLED, label="drilled axis"),
        Patch(color=_HOLE, label="drilled hole"),
        Line2D([], [], marker="o", ls="", ms=8, color=_SPHERE, label="sphere"),
        Line2D([], [], color=_DRILLED, label="(c) off in x"),
        Line2D([], [], color=_DRILLED, ls="--", label="(c) off in y"),
    ]
    legend_below(figure, handles, 6)
    return figure
