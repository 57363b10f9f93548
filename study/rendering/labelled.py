"""Figure 3.1: an anatomy whose structures are named in the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from study.plots.palette import structure_of, style_of
from study.plots.style import patches, styled
from study.rendering.board import Board, with_room
from study.rendering.chapter2 import HOLLOW
from study.rendering.scene import Scene
from study.rendering.views import View, approach_view, posterior_on_right
from study.volumes import LabelVolume

#: Structures that others would be hidden behind: they are drawn translucent.
WIDE = {"dura", "sigmoid_sinus_and_dura"}


def _structures(volume: LabelVolume) -> list[str]:
    return [
        name
        for name in volume.names
        if structure_of(name) not in HOLLOW | {"target", "protected"} and volume.mask(name).any()
    ]


@styled()
def labelled_anatomy(volume: LabelVolume, planning: LabelVolume, approach: np.ndarray) -> Figure:
    """Figure 3.1: the bone with the target from outside, and the structures around it by name.

    Parameters
    ----------
    volume : LabelVolume
        Anatomical labels.
    planning : LabelVolume
        With the target, on the same grid.
    approach : (3,) array
        Outside -> bone.
    """
    outside = Scene(approach_view(approach, oblique=True))
    inside = Scene(approach_view(approach).turned(38 * posterior_on_right(approach), 24))
    target = planning.mask("target")
    for name in (n for n in volume.names if structure_of(n) == "bone"):
        outside.mask(volume.mask(name) & ~target, volume.affine, name)
    solid: dict[str, list[np.ndarray]] = {}
    for name in _structures(volume):
        mask, kind = volume.mask(name), structure_of(name)
        outside.mask(mask, volume.affine, name)
        if kind != "temporomandibular_joint":
            inside.items.append(replace(outside.items[-1], opacity=0.35 if kind in WIDE else 1.0))
            solid.setdefault(kind, []).append(volume.points(np.argwhere(mask)))
    outside.mask(target, planning.affine, "target", opacity=1.0)
    inside.items.append(replace(outside.items[-1], opacity=0.2))
    board = Board(13, 5.35)
    width, height = 5.2, 4.6
    for scene in (outside, inside):
        with_room(scene, 1.2, (width - 0.5) / height)
    board.scene(outside, 0.1, 0.35, width, height, "(a) from outside")
    ax = board.scene(inside, 6.8, 0.35, width - 0.5, height, "(b) what the target lies between")
    size = (int(130 * (width - 0.5)), int(130 * height))
    points = {name: np.concatenate(parts) for name, parts in solid.items()}
    clear = {"target": planning.points(np.argwhere(target))}
    clear |= {name: points.pop(name) for name in WIDE & points.keys()}
    spots = visible_spots(points, clear, inside.view, size)
    leaders(ax, spots, size)
    return board.legend(patches("bone", "target"), 2)


def visible_spots(
    solid: dict[str, np.ndarray], clear: dict[str, np.ndarray], view: View, size: Sequence[int]
) -> dict[str, np.ndarray]:
    """For each name the pixel in the middle of what is seen of it; a structure that is hidden gets none.

    Parameters
    ----------
    solid, clear : dict of str to (n, 3) arrays
        mm of what hides others and of what does not.
    view : View
        With centre and size.
    size : (2,) ints
        Pixels.
    """
    cell = 4
    shape = (size[0] // cell + 1, size[1] // cell + 1)
    front = np.full(shape, np.inf)
    cells, depths = {}, {}
    for name, points in {**solid, **clear}.items():
        at = (pixels(points, view, size) / cell).astype(int)
        within = ((at >= 0) & (at < shape)).all(axis=1)
        cells[name], depths[name] = at[within], (points @ view.looking)[within]
        if name in solid:
            np.minimum.at(front, tuple(cells[name].T), depths[name])
    out = {}
    for name, at in cells.items():
        limit = front[tuple(at.T)]
        seen = np.unique(at[depths[name] <= limit + 1e-9 if name in solid else np.isinf(limit)], axis=0)
        if len(seen):
            middle = np.median(seen, axis=0)
            out[name] = (seen[np.argmin(np.linalg.norm(seen - middle, axis=1))] + 0.5) * cell
    return out


def pixels(points: np.ndarray, view: View, size: Sequence[int]) -> np.ndarray:
    """(n, 2) column and row at which (n, 3) mm appear in a picture of `size` pixels."""
    per_mm = size[1] / (2 * view.half_height)
    from_centre = np.asarray(points) - view.centre
    return np.column_stack(
        [size[0] / 2 + per_mm * (from_centre @ view.right), size[1] / 2 - per_mm * (from_centre @ view.up)]
    )


def leaders(axes: Axes, spots: dict[str, np.ndarray], size: Sequence[int]) -> None:
    """Names left and right of a picture, in the order of height, with lines to what they name.

    Parameters
    ----------
    axes : Axes
        With pixels as data.
    spots : dict of str to (2,) arrays
        Palette name to pixel.
    size : (2,) ints
        Pixels.
    """
    names = sorted(spots, key=lambda name: spots[name][0])
    half = (len(names) + 1) // 2
    for side, group in ((-1, names[:half]), (1, names[half:])):
        group = sorted(group, key=lambda name: spots[name][1])
        heights = np.linspace(0.06, 0.80, len(group)) * size[1] if len(group) > 1 else [0.4 * size[1]]
        x = -0.03 * size[0] if side < 0 else 1.03 * size[0]
        for name, y in zip(group, heights, strict=True):
            axes.annotate(
                style_of(name).title, spots[name], (x, y), fontsize=9.5, va="center",
                ha="right" if side < 0 else "left", annotation_clip=False, color="black",
                arrowprops={"arrowstyle": "-", "color": "#222222", "lw": 0.9, "shrinkA": 2, "shrinkB": 0,
                            "path_effects": [withStroke(linewidth=2.2, foreground="#ffffffb0")]},
            )  # fmt: skip
            axes.plot(*spots[name], "o", ms=4, mfc=style_of(name).colour, mec="black", mew=0.8)
    axes.set(xlim=(0, size[0]), ylim=(size[1], 0))
