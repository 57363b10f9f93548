"""Figures 2.2 to 2.4: the burr against the voxels, and from the segmentation to the modified volume."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from study.planners import ModifiedVolume
from study.plots.palette import STYLES
from study.plots.sections import Section, section
from study.plots.style import legend_below, new_axes, patches, show_labels, styled
from study.volumes import ball_element

SEGMENTED = {0: "air", 1: "protected", 2: "target"}
STEPS = {**SEGMENTED, 3: "target_boundary", 4: "eroded", 5: "unreachable", 6: "into_air"}
#: Stands for the burr's outline in a legend.
BURR = Line2D([], [], marker="o", ls="", ms=11, mfc="none", mec=STYLES["burr"].colour, mew=1.6, label="burr")


def circle(axes, x: float, y: float, radius: float, **style) -> None:
    """The outline of a burr in a section."""
    style = {"edgecolor": STYLES["burr"].colour, "lw": 1.6} | style
    axes.add_patch(Circle((x, y), radius, facecolor="none", **style))


@styled()
def burr_and_voxels(burr_diameter: float = 5.0, voxel: float = 0.4) -> Figure:
    """Figure 2.2: a burr beside the voxels, and those it overlaps.

    Parameters
    ----------
    burr_diameter, voxel : float
        mm.
    """
    element = ball_element(burr_diameter / 2, np.full(3, voxel))
    middle = element[:, :, element.shape[2] // 2]
    reach = element.shape[0] // 2
    labels = np.pad(middle.astype(np.uint8), 2)
    figure, axes = new_axes(1, 1, (5.4, 5.6))
    ax = axes[0, 0]
    first = -(reach + 2) * voxel
    show_labels(
        ax, labels, {0: "air", 1: "removed"}, (voxel, voxel), grid=True, origin_mm=(first, first),
        title=f"{np.count_nonzero(middle)} of {middle.shape[0]} × {middle.shape[1]} voxels of {voxel:g} mm\n"
        f"in this plane, {np.count_nonzero(element)} in space",
    )  # fmt: skip
    circle(ax, 0, 0, burr_diameter / 2, lw=2.2)
    ax.plot(0, 0, "+", color=STYLES["burr"].colour, ms=9, mew=1.6)
    ax.annotate("", (-burr_diameter / 2, 0), (burr_diameter / 2, 0), arrowprops={"arrowstyle": "<->"})
    ax.text(0.3, -0.15, f"Ø {burr_diameter:g} mm", ha="left", va="bottom")
    handles = [*patches("removed"), BURR]
    handles[0].set_label("voxels the burr overlaps")
    legend_below(figure, handles)
    return figure


def _deepest_fit(modified: ModifiedVolume, plane: Section) -> np.ndarray | None:
    """Where in the section the burr fits nearest to protected bone on two sides: the lowest target voxel."""
    where = np.argwhere(plane.of(modified.target & modified.volume.mask("target")))
    return where[np.argmax(where[:, 0])] if len(where) else None


@styled()
def modified_steps(modified: ModifiedVolume, approach: np.ndarray) -> Figure:
    """Figure 2.3: the segmented slice, what the erosion takes from the target, the modified slice.

    Parameters
    ----------
    modified : ModifiedVolume
    approach : (3,) array
        Outside -> bone.
    """
    volume = modified.volume
    plane = section(volume, approach)
    before = _segmented(modified)
    target = volume.mask("target")
    during = before.copy()
    during[target & ~modified.allowed] = 4
    during[modified.unreachable] = 5
    after = np.where(before == 0, 0, 1).astype(np.uint8)
    after[modified.target & target], after[modified.boundary & target] = 2, 3
    figure, axes = new_axes(1, 3, (12, 4.7), sharey=True)
    titles = ("(a) segmented", "(b) the target is eroded by the burr", "(c) modified, before it meets air")
    for ax, labels, title in zip(axes[0], (before, during, after), titles, strict=True):
        show_labels(ax, plane.of(labels), STEPS, plane.spacing, title=title)
    row, column = _deepest_fit(modified, plane)
    for ax in axes[0]:
        x, y = column * plane.spacing[1], row * plane.spacing[0]
        circle(ax, x, y, modified.burr_radius)
        ax.plot(x, y, "+", color=STYLES["burr"].colour)
    for ax in axes[0, 1:]:
        ax.set_ylabel("")
    legend_below(
        figure,
        [*patches("air", "protected", "target", "eroded", "unreachable", "target_boundary"), BURR],
        columns=4,
    )
    return figure


@styled()
def dilation_into_air(modified: ModifiedVolume, approach: np.ndarray) -> Figure:
    """Figure 2.4: the eroded target at the bone's surface, and its dilation into the air.

    Parameters
    ----------
    modified : ModifiedVolume
    approach : (3,) array
        Outside -> bone.
    """
    volume = modified.volume
    air = volume.mask("air")
    plane = section(volume, approach, around=modified.target, margin_mm=4.5)
    eroded = np.where(air, 0, 1).astype(np.uint8)
    eroded[modified.target & ~air] = 2
    dilated = eroded.copy()
    dilated[modified.target & air] = 6
    figure, axes = new_axes(1, 2, (9.5, 5.0), sharey=True)
    shown = plane.of(modified.target & ~air)
    columns = np.flatnonzero(shown.any(axis=0))
    column = int(columns[len(columns) // 2])
    first = int(np.flatnonzero(shown[:, column])[0])
    lifted = int(np.flatnonzero(plane.of(modified.target)[:, column])[0])
    titles = ("(a) eroded: a whole radius of bone at once", "(b) dilated: the burr starts in the air")
    for ax, labels, title, row in zip(axes[0], (eroded, dilated), titles, (first, lifted), strict=True):
        show_labels(ax, plane.of(labels), STEPS, plane.spacing, title=title)
        circle(ax, column * plane.spacing[1], row * plane.spacing[0], modified.burr_radius, lw=2)
    axes[0, 1].set_ylabel("")
    legend_below(figure, [*patches("air", "protected", "target", "into_air"), BURR])
    return figure


def _segmented(modified: ModifiedVolume) -> np.ndarray:
    volume = modified.volume
    return np.where(volume.mask("air"), 0, np.where(volume.mask("target"), 2, 1)).astype(np.uint8)
