"""The look of all figures: fonts, sizes, axes in mm, label images and their legends."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from study.plots.palette import style_of

RC = {
    "font.family": "DejaVu Sans",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.labelsize": 9.5,
    "axes.linewidth": 0.8,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "figure.facecolor": "white",
}


class Picture(Figure):
    """A figure that shows itself at the end of a notebook's cell, whether pyplot is in use or not."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", dpi=RC["figure.dpi"], bbox_inches="tight", pad_inches=0.08)
        return buffer.getvalue()


@contextmanager
def styled() -> Iterator[None]:
    """Draw in the package's style, whatever the user's own is."""
    with mpl.rc_context(RC):
        yield


def new_figure(size: tuple[float, float], layout: str | None = "constrained") -> Figure:
    """An empty figure in the package's style, which no global state holds on to."""
    with styled():
        return Picture(figsize=size, layout=layout, dpi=RC["figure.dpi"])


def new_axes(rows: int, columns: int, size: tuple[float, float], **options) -> tuple[Figure, np.ndarray]:
    """A figure with (rows, columns) axes in the package's style."""
    with styled():
        figure = Picture(figsize=size, layout="constrained", dpi=RC["figure.dpi"])
        axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, axes


def label_image(labels: np.ndarray, names: Mapping[int, str]) -> np.ndarray:
    """(n, m, 3) colours of a 2-D array of labels; `names` says what each value is in the palette."""
    image = np.ones((*labels.shape, 3))
    for value, name in names.items():
        image[labels == value] = to_rgb(style_of(name).colour)
    return image


def show_labels(
    axes: Axes,
    labels: np.ndarray,
    names: Mapping[int, str],
    spacing: Sequence[float],
    *,
    title: str = "",
    grid: bool = False,
    origin_mm: Sequence[float] = (0.0, 0.0),
) -> None:
    """Draw a slice of labels with axes in mm.

    Parameters
    ----------
    axes : Axes
    labels : (n, m) array
        Rows go down the picture, columns to the right.
    names : mapping of int to str
        What the values are.
    spacing : (2,) mm
        Between rows and between columns.
    title : str
    grid : bool
        Draw the voxels' edges.
    origin_mm : (2,) mm
        Of the first row's and column's voxel centre.
    """
    n, m = labels.shape
    dy, dx = spacing
    y0, x0 = origin_mm
    extent = (x0 - dx / 2, x0 + (m - 0.5) * dx, y0 + (n - 0.5) * dy, y0 - dy / 2)
    axes.imshow(label_image(labels, names), extent=extent, interpolation="nearest", aspect="equal")
    if grid:
        axes.hlines(y0 + (np.arange(n + 1) - 0.5) * dy, extent[0], extent[1], color="#00000030", lw=0.4)
        axes.vlines(x0 + (np.arange(m + 1) - 0.5) * dx, extent[3], extent[2], color="#00000030", lw=0.4)
    axes.set(xlim=extent[:2], ylim=extent[2:], xlabel="mm", ylabel="mm", title=title)


def patches(*names: str) -> list[Patch]:
    """Legend entries of palette names."""
    return [
        Patch(facecolor=style_of(name).colour, edgecolor="#555555", linewidth=0.5, label=style_of(name).title)
        for name in names
    ]


def legend_below(figure: Figure, handles: Sequence, columns: int = 5) -> None:
    """One legend below all axes."""
    figure.legend(handles=list(handles), loc="outside lower center", ncols=min(columns, len(handles)))
