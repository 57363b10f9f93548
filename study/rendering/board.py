"""Scenes and axes in one figure, each at its place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from study.plots.style import new_figure
from study.rendering.panels import compass, scale_bar
from study.rendering.scene import Scene


class Board:
    """A figure on which scenes and axes are put in inches from the upper left corner."""

    def __init__(self, width: float, height: float):
        self.figure = new_figure((width, height), layout=None)
        self.width, self.height = width, height

    def axes(self, x: float, y: float, width: float, height: float) -> Axes:
        """Empty axes; x and y are where their upper left corner is."""
        rect = (x / self.width, 1 - (y + height) / self.height, width / self.width, height / self.height)
        return self.figure.add_axes(rect)

    def scene(self, scene: Scene, x: float, y: float, width: float, height: float, title: str = "") -> Axes:
        """A rendering with scale bar and directions; pixels are the axes' data."""
        axes = self.axes(x, y, width, height)
        size = (int(130 * width), int(130 * height))
        image = scene.image(size)
        axes.imshow(image, interpolation="antialiased")
        axes.set_axis_off()
        axes.set_title(title)
        view = scene.placed_view(size[0] / size[1])
        scale_bar(axes, view, size)
        compass(axes, view, size, emptiest_corner(image))
        return axes

    def legend(self, handles: Sequence, columns: int = 5) -> Figure:
        """One legend at the bottom; the figure is done."""
        self.figure.legend(
            handles=list(handles), loc="lower center", ncols=min(columns, len(handles)), fontsize=9.5
        )
        return self.figure


def with_room(scene: Scene, times: float, aspect: float = 4 / 3) -> None:
    """Let a scene fill less of its picture, so that scale bar and directions have a place beside it."""
    view = scene.placed_view(aspect)
    scene.view = view.around(view.centre, times * view.half_height)


def emptiest_corner(image: np.ndarray) -> tuple[bool, bool]:
    """(right?, lower?) of the corner of a white picture with least in it, not where the scale bar is."""
    n, m = (2 * side // 5 for side in image.shape[:2])
    drawn = (image < 250).any(axis=2)
    parts = {
        (True, True): drawn[-n:, -m:], (True, False): drawn[:n, -m:], (False, False): drawn[:n, :m]
    }  # fmt: skip
    return min(parts, key=lambda corner: int(parts[corner].sum()))
