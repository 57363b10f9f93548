"""A cone of shaft directions as a map: which are free, and what a small window sees of them."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from study.plots.style import legend_below, new_axes, styled
from study.plots.windows import BLOCKED, FREE


def _map(directions: np.ndarray, pole: np.ndarray) -> np.ndarray:
    """(n, 2) degrees from the pole, so that distances from it are true."""
    pole = pole / np.linalg.norm(pole)
    # The longest of the grid's axes across the pole points right, whatever the pole.
    right = np.eye(3)[np.argmin(np.abs(pole))]
    right = right - (right @ pole) * pole
    right /= np.linalg.norm(right)
    up = np.cross(pole, right)
    along = directions @ pole
    aside = np.column_stack([directions @ right, directions @ up])
    polar = np.degrees(np.arctan2(np.linalg.norm(aside, axis=1), along))
    length = np.maximum(np.linalg.norm(aside, axis=1), 1e-12)
    return aside / length[:, None] * polar[:, None]


def _dots(ax: Axes, at: np.ndarray, free: np.ndarray, size: float) -> None:
    for flag, colour in ((True, FREE), (False, BLOCKED)):
        ax.scatter(*at[free == flag].T, s=size, color=colour, linewidths=0)


@styled()
def cone_map(
    cone: np.ndarray,
    free: np.ndarray,
    window: np.ndarray,
    window_free: np.ndarray,
    pole: np.ndarray,
    axis: np.ndarray,
) -> Figure:
    """Free and blocked directions of a cone, and the window about the present shaft, close up.

    Parameters
    ----------
    cone, window : (n, 3) and (m, 3) arrays
        Unit vectors from the burr towards the drill body.
    free, window_free : (n,) and (m,) bool arrays
    pole : (3,) array
        The cone's axis, the middle of the map.
    axis : (3,) array
        The present shaft.
    """
    figure, axes = new_axes(1, 2, (9.6, 5.2))
    shaft = _map(np.asarray(axis, float)[None], pole)[0]
    inside = _map(window, pole)
    _dots(axes[0, 0], _map(cone, pole), np.asarray(free, bool), 22)
    _dots(axes[0, 1], inside, np.asarray(window_free, bool), 34)
    low, high = inside.min(axis=0), inside.max(axis=0)
    axes[0, 0].plot(
        [low[0], high[0], high[0], low[0], low[0]],
        [low[1], low[1], high[1], high[1], low[1]],
        color="black",
        lw=1.5,
    )
    for ax in axes[0]:
        ax.plot(*shaft, marker="+", ms=12, mew=2, color="black")
        ax.set(xlabel="degrees from the approach", ylabel="degrees from the approach", aspect="equal")
    axes[0, 0].set_title(f"(a) the robot's cone: {np.count_nonzero(free)} of {len(free)} free")
    axes[0, 1].set_title(
        f"(b) the window in the frame: {np.count_nonzero(window_free)} of {len(window_free)} free"
    )
    marks = {"ls": "", "ms": 7}
    legend_below(
        figure,
        [
            Line2D([], [], marker="o", color=FREE, label="free", **marks),
            Line2D([], [], marker="o", color=BLOCKED, label="in collision", **marks),
            Line2D([], [], marker="+", color="black", mew=2, label="present shaft", **marks),
        ],
    )
    return figure
