"""What iterative closest point fits make of their starts, stop by stop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from study.plots.style import legend_below, new_axes, styled

_LINE, _MIDDLE, _TAIL = "#8a97a8", "#0055a4", "#d1372c"
#: Fits whose way is drawn one by one, of many.
_DRAWN = 80


@styled()
def fits_figure(
    stops: Sequence[int],
    errors: np.ndarray,
    residual: np.ndarray,
    iterations: np.ndarray,
    published: int = 20,
) -> Figure:
    """Error at the tumour and distance from the surface against iterations.

    Parameters
    ----------
    stops : (k,) ints
        Iterations; the first is 0, the last stands for the end.
    errors, residual : (k, n) arrays
        Root mean squared error over the tumour, and distance of the patch from the vertices, mm.
    iterations : (k, n) int array
        Made at each stop.
    published : int
        Iterations at which the text's fits seem to have been stopped.
    """
    end = int(iterations[-1].max())
    x = np.array([*stops[:-1], max(end, stops[-2] + 1)], float)
    place = np.sqrt(x)  # shows 0 and spreads the first iterations
    figure, axes = new_axes(1, 2, (12, 4.6))
    pairs = zip(axes[0], (errors, residual), strict=True)
    for ax, values in pairs:
        some = values[:, :: max(1, values.shape[1] // _DRAWN)]
        known = np.isfinite(values).all(axis=1)
        ax.plot(place[known], some[known], color=_LINE, lw=0.6, alpha=0.5)
        for share, colour, width in ((0.5, _MIDDLE, 2.4), (0.99, _TAIL, 2.4)):
            ax.plot(
                place[known], np.quantile(values[known], share, axis=1), "o-", color=colour, lw=width, ms=4
            )
        ax.axvline(np.sqrt(published), color="black", lw=0.9, ls=":")
        ticks = [0, 1, 5, 10, 20, 50, 100, 200, 400]
        shown = [t for t in ticks if t <= x[-1]]
        ax.set_xticks(np.sqrt(shown), labels=[str(t) for t in shown])
        ax.set(xlabel="iterations (root scale); the last point is the end", yscale="log")
        ax.set_yticks(
            [0.1, 0.2, 0.5, 1, 2, 5, 10, 20], labels=["0.1", "0.2", "0.5", "1", "2", "5", "10", "20"]
        )
        ax.minorticks_off()
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="#00000015", lw=0.6)
    axes[0, 0].set(ylabel="error at the tumour, rms (mm)", title="(a) where it matters")
    axes[0, 0].set_ylim(max(0.05, 0.7 * np.quantile(errors, 0.02)), 1.2 * errors.max())
    axes[0, 1].set(ylabel="swab to nearest vertices, rms (mm)", title="(b) what the fit makes small")
    low, high = 0.8 * np.nanmin(residual), 1.2 * np.nanmax(residual)
    axes[0, 1].set_ylim(min(low, 0.48), max(high, 1.05))  # so that there are two numbers on the axis
    handles = [
        Line2D([], [], color=_LINE, lw=1, label=f"one of {errors.shape[1]} starts"),
        Line2D([], [], color=_MIDDLE, lw=2.4, label="median"),
        Line2D([], [], color=_TAIL, lw=2.4, label="99 % are below"),
        Line2D([], [], color="black", lw=0.9, ls=":", label=f"loose stop, {published} iterations at most"),
    ]
    legend_below(figure, handles, 4)
    return figure


@styled()
def scatter_figure(shown: Mapping[str, np.ndarray], volume_mm3: float) -> Figure:
    """Where registrations show the tumour's middle, from the front and from the side, one column a stop.

    Parameters
    ----------
    shown : mapping of str to (n, 3) array
        Stop, and from the true place to where the registrations show it, mm, LPS.
    volume_mm3 : float
        Of the tumour: a ball of that size is drawn as a circle.
    """
    views = ((0, 2, "left (mm)", "superior (mm)"), (1, 2, "posterior (mm)", "superior (mm)"))
    radius = float(np.cbrt(0.75 * volume_mm3 / np.pi))
    half = 1.05 * max(radius, *(np.quantile(np.abs(part), 0.999) for part in shown.values()))
    figure, axes = new_axes(2, len(shown), (2.75 * len(shown) + 0.4, 6.1), sharex=True, sharey=True)
    for number, (row, (across, up, below, beside)) in enumerate(zip(axes, views, strict=True)):
        for ax, (stop, part) in zip(row, shown.items(), strict=True):
            _cloud(ax, part[:, [across, up]], radius)
            ax.set(xlim=(-half, half), ylim=(-half, half), xlabel=below)
            ax.set_title(_title(stop) if number == 0 else "")
        row[0].set_ylabel(beside)
    handles = [
        Line2D([], [], marker="o", ls="", ms=5, color=_MIDDLE, label="tumour's middle by one registration"),
        Line2D([], [], marker="+", ls="", ms=10, mew=1.5, color="black", label="true place"),
        Line2D([], [], color="#a8860f", lw=1.4, label="outline of a ball as large as the tumour"),
    ]
    legend_below(figure, handles, 3)
    return figure


def _cloud(ax: Axes, points: np.ndarray, radius: float) -> None:
    ax.add_patch(Circle((0, 0), radius, fc="#f6e7b0", ec="#a8860f", lw=1.2, zorder=0))
    ax.plot(*points.T, "o", ms=2.6, mew=0, color=_MIDDLE, alpha=0.55)
    ax.plot(0, 0, "+", ms=11, mew=1.6, color="black")
    ax.set_aspect("equal")
    ax.grid(color="#00000015", lw=0.6)


def _title(stop: str) -> str:
    return f"{stop} iterations" if stop.startswith("after") else stop
