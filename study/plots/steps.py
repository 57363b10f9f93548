"""Figure 2.18: the modified and the unmodified simulation in step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from study.errors import InputError
from study.planners import Plan
from study.planners.moments import Moment
from study.plots.modified import BURR, circle
from study.plots.palette import STYLES
from study.plots.sections import section
from study.plots.style import legend_below, new_axes, patches, show_labels, styled

MODIFIED = {0: "air", 1: "protected", 2: "target", 3: "target_boundary", 4: "removed"}
UNMODIFIED = {0: "air", 1: "protected", 2: "target", 4: "removed"}


@styled()
def simulations_in_step(plan: Plan, moments: Sequence[Moment], index: int = -1) -> Figure:
    """Both simulations on one plane at several moments, with supervoxel and burr where they cut it.

    Their outlines are dotted where the burr's centre is not on the plane itself.

    Parameters
    ----------
    plan : Plan
        With its volume.
    moments : sequence of Moment
        In order.
    index : int
        Which plane across the rotation axis; -1 takes that of the first moment.

    Raises
    ------
    InputError
        If no moment is given.
    """
    if not moments:
        raise InputError("moments: expected at least one, got none")
    normal = moments[0].frame.rotation_axis
    index = int(moments[0].index[normal]) if index < 0 else index
    plane = section(
        plan.volume, plan.approach, normal=normal, index=index,
        around=plan.volume.mask("target") | plan.modified.target, margin_mm=3.0,
    )  # fmt: skip
    figure, axes = new_axes(2, len(moments), (4 * len(moments), 8.4), sharex=True, sharey=True)
    began = plan.volume.mask("target")
    for moment, pair, letter in zip(moments, axes.T, "abcdefgh", strict=False):
        bone = moment.unmodified.labels.copy()
        bone[began & (bone == 0)] = 4
        show_labels(pair[0], plane.of(moment.modified.labels), MODIFIED, plane.spacing)
        show_labels(pair[1], plane.of(bone), UNMODIFIED, plane.spacing)
        pair[0].set_title(f"({letter}) modified, point {moment.row}")
        pair[1].set_title("unmodified")
        x, y = plane.place(moment.index)
        away = abs(int(moment.index[normal]) - index)
        line = "-" if away == 0 else ":"
        if away <= moment.reach[normal]:
            down, right = ((2 * moment.reach[axis] + 1) for axis in (plane.depth, plane.lateral))
            w, h = right * plane.spacing[1], down * plane.spacing[0]
            pair[0].add_patch(Rectangle((x - w / 2, y - h / 2), w, h, fc="none", ec="black", lw=1.6, ls=line))
        rest = plan.drill.burr_radius**2 - (away * plan.volume.spacing[normal]) ** 2
        if rest > 0:
            circle(pair[1], x, y, float(np.sqrt(rest)), ls=line)
            ends = plan.volume.indices(np.stack([moment.position, moment.position + 14 * moment.axis]))
            pair[1].plot(*plane.place(ends).T, color=STYLES["shaft"].colour, lw=5, alpha=0.8, clip_on=True)
        for ax in pair:
            ax.label_outer()
    square = Line2D([], [], marker="s", ls="", ms=10, mfc="none", mec="black", mew=1.6, label="supervoxel")
    shaft = Line2D([], [], color=STYLES["shaft"].colour, lw=5, label="shaft's axis")
    kinds = patches("air", "protected", "target", "target_boundary", "removed")
    legend_below(figure, [*kinds, square, BURR, shaft], 4)
    return figure
