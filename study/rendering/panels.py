"""Pictures of scenes side by side, with scale bar, body directions and legend."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from study.plots.style import new_figure
from study.rendering.scene import Scene
from study.rendering.views import View

_HALO = [withStroke(linewidth=2.5, foreground="white")]


def nice_length(mm: float) -> float:
    """The largest of 1, 2, 5 x 10^n mm that is not longer."""
    power = 10.0 ** np.floor(np.log10(mm))
    return float(power * max(step for step in (1, 2, 5) if step * power <= mm * (1 + 1e-9)))


def panels(
    scenes: Sequence[Scene],
    titles: Sequence[str] = (),
    *,
    columns: int = 0,
    width: float = 12.0,
    legend: bool = True,
    extra: Sequence[Patch | Line2D] = (),
    pixels: int = 1200,
) -> Figure:
    """Draw scenes side by side.

    Parameters
    ----------
    scenes : sequence of Scene
    titles : sequence of str
        One a panel.
    columns : int
        Panels in a row; 0 takes one row up to three, two rows beyond.
    width : float
        Of the figure in inches at 100 dots an inch.
    legend : bool
        One below for all panels, of everything that is in any of them.
    extra : sequence of matplotlib artists
        Further entries of the legend.
    pixels : int
        Width of the whole figure's renderings.

    Returns
    -------
    matplotlib.figure.Figure
    """
    n = len(scenes)
    columns = columns or (n if n <= 3 else (n + 1) // 2)
    rows = -(-n // columns)
    cell = width / columns
    entries = _entries(scenes, extra) if legend else []
    below = 0.32 * -(-len(entries) // 4) + 0.12 if entries else 0.0
    above = 0.3 if titles else 0.05
    height = rows * (cell * 0.75 + above) + below
    figure = new_figure((width, height), layout=None)
    size = (int(pixels / columns), int(pixels / columns * 0.75))
    size = (size[0] * 3 // 2, size[1] * 3 // 2) if columns > 1 else size
    for number, scene in enumerate(scenes):
        row, column = divmod(number, columns)
        bottom = 1 - (row + 1) * (cell * 0.75 + above) / height
        axes = figure.add_axes((column / columns + 0.003, bottom, 1 / columns - 0.006, cell * 0.75 / height))
        axes.imshow(scene.image(size), interpolation="antialiased")
        axes.set_axis_off()
        if titles:
            axes.set_title(titles[number], fontsize=10.5, loc="left", pad=4)
        view = scene.placed_view(size[0] / size[1])
        scale_bar(axes, view, size)
        compass(axes, view, size)
    if entries:
        figure.legend(
            handles=entries, loc="lower center", ncols=min(4, len(entries)), frameon=False, fontsize=9.5
        )
    return figure


def _entries(scenes: Sequence[Scene], extra) -> list[Patch | Line2D]:
    found: dict[str, Patch] = {}
    for scene in scenes:
        for title, colour, _ in scene.legend():
            found.setdefault(title, Patch(facecolor=colour, edgecolor="#555555", linewidth=0.5, label=title))
    return [*found.values(), *extra]


def scale_bar(axes: Axes, view: View, size: Sequence[int]) -> None:
    """A bar of a round number of mm at the lower left of a picture of `size` pixels."""
    per_mm = size[1] / (2 * view.half_height)
    length = nice_length(0.28 * size[0] / per_mm)
    x, y = 0.04 * size[0], 0.94 * size[1]
    axes.plot(
        [x, x + length * per_mm], [y, y], color="black", lw=2.5, solid_capstyle="butt", path_effects=_HALO
    )
    axes.text(
        x + length * per_mm / 2, y - 0.015 * size[1], f"{length:g} mm",
        ha="center", va="bottom", fontsize=8.5, path_effects=_HALO,
    )  # fmt: skip


def _shrink(axes: Axes) -> float:
    """How much larger a thing must be for its letters, in a panel that is smaller than the figure."""
    return max(1.4, 12.0 / axes.get_position().width / axes.figure.get_figwidth() * 0.85)


def compass(axes: Axes, view: View, size: Sequence[int], corner: tuple[bool, bool] = (True, True)) -> None:
    """Crossed lines with the letters of the body's directions, in the corner (right?, lower?)."""
    reach = 0.032 * size[1] * _shrink(axes)
    middle = np.array([n - 2.4 * reach if far else 2.4 * reach for n, far in zip(size, corner, strict=True)])
    for negative, positive, flat in view.compass():
        step = reach * flat * [1, -1]
        ends = np.array([middle - step, middle + step])
        axes.plot(*ends.T, color="black", lw=1.2, path_effects=_HALO)
        for letter, end in ((negative, middle - 1.45 * step), (positive, middle + 1.45 * step)):
            axes.text(*end, letter, ha="center", va="center", fontsize=8.5, path_effects=_HALO)
