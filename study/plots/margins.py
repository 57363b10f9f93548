"""Sections through margins and what they were grown by: the 2-D figures of Siebold's chapter 3."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from study.errors import InputError
from study.margins import ACCEPTABLE_RISKS, DECAY_STARTS, SafetyMargin
from study.margins.illustration import GrowthStep, Landing
from study.margins.published import transfer_share
from study.plots.palette import STYLES, structure_of, style_of
from study.plots.planes import Plane, axial
from study.plots.style import legend_below, new_axes, patches, styled
from study.volumes import LabelVolume

#: Labels that are no structure to look at in a section.
_GROUND = {"air", "air_cells", "middle_ear", "bone", "intracranial", "target", "protected"}
HIT, MISSED = "#d1372c", "#2e9e3f"


def level_of(volume: LabelVolume, mask: np.ndarray) -> np.ndarray:
    """(3,) mm of the middle of a mask in the axial level that cuts most of it.

    Raises
    ------
    InputError
        If no voxel is set.
    """
    if not mask.any():
        raise InputError("mask: expected at least one voxel to cut, got none")
    axis = int(np.argmax(np.abs(volume.directions[2])))
    cut = np.count_nonzero(mask, axis=tuple({0, 1, 2} - {axis}))
    voxels = np.argwhere(mask)
    return volume.points(voxels[voxels[:, axis] == np.argmax(cut)]).mean(axis=0)


def structure_layers(plane: Plane, volume: LabelVolume) -> list[tuple[np.ndarray, str, float]]:
    """What a section cuts of every structure of an anatomy, each in its colour."""
    labels = plane.of(volume, volume.labels)
    cut = set(np.unique(labels).tolist())
    return [
        (labels == value, style_of(name).colour, 1.0)
        for name, value in volume.names.items()
        if value in cut and structure_of(name) not in _GROUND
    ]


def structures_cut(plane: Plane, volume: LabelVolume) -> list[str]:
    """Palette names of the structures in a section."""
    cut = set(np.unique(plane.of(volume, volume.labels)).tolist())
    return [
        name for name, value in volume.names.items() if value in cut and structure_of(name) not in _GROUND
    ]


@styled()
def reduced_target_sections(
    planning: LabelVolume, margins: Sequence[SafetyMargin], reduced: LabelVolume, approach: np.ndarray
) -> Figure:
    """Figure 3.2: target and structures, the margins over them, the target without the margins.

    Parameters
    ----------
    planning, reduced : LabelVolume
        Before and after `study.margins.reduced_target`.
    margins : sequence of SafetyMargin
        Of one anatomy.
    approach : (3,) array
        Outside -> bone.
    """
    anatomy = margins[0].volume
    target = planning.mask("target")
    spared = target & ~reduced.mask("target")
    axis = int(np.argmax(np.abs(planning.directions[2])))
    corners = planning.points(np.argwhere(target))
    middle = (corners.min(axis=0) + corners.max(axis=0)) / 2
    near = level_of(planning, spared if spared.any() else target)
    middle[2] = near[2]
    half = 0.5 * np.ptp(corners, axis=0)
    whole = axial(middle, approach, half[1] + 6, half[0] + 3)
    if spared.any():
        level = np.argwhere(spared)
        at = level[:, axis] == np.rint(planning.indices(near[None])[0, axis])
        near = _densest(planning.points(level[at]), 3.5)
    ratio = whole.half_height / whole.half_width
    close = axial(near, approach, 4.5, 3.4)
    heights = (ratio, close.half_height / close.half_width)
    figure, axes = new_axes(2, 3, (11, 3.4 * sum(heights) + 2.1), height_ratios=heights)
    union = np.zeros(anatomy.shape, bool)
    for margin in margins:
        union |= margin.mask
    titles = ("target and structures", "safety margins around five structures", "target that may be milled")
    for row, plane in zip(axes, (whole, close), strict=True):
        before, after = plane.of(planning, target), plane.of(planning, reduced.mask("target"))
        ground = [
            (plane.of(planning, planning.mask("air")), STYLES["air"].colour, 1.0),
            (before, STYLES["target"].colour, 1.0),
        ]
        margin = plane.of(anatomy, union)
        bodies = structure_layers(plane, anatomy)
        given_up = (before & ~after, STYLES["spared"].colour, 1.0)
        drawn = (
            [*ground, *bodies],
            [*ground, (margin & ~before, STYLES["margin"].colour, 0.85), given_up, *bodies],
            [ground[0], (after, STYLES["target"].colour, 1.0), *bodies],
        )
        for number, (ax, layers) in enumerate(zip(row, drawn, strict=True)):
            title = f"({'abc'[number]}) {titles[number]}" if plane is whole else "the box, enlarged"
            plane.show(ax, layers, title, STYLES["protected"].colour, plane is whole)
            if number:
                ax.set_ylabel("")
            if number == 2:
                _outline(ax, plane, margin, STYLES["margin"].colour)
    x, y, _ = whole.place(near[None])[0]
    for ax in axes[0]:
        box = (x - close.half_width, y - close.half_height), 2 * close.half_width, 2 * close.half_height
        ax.add_patch(Rectangle(*box, fc="none", ec="black", lw=1.2))
    outline = Line2D([], [], color=STYLES["margin"].colour, lw=1.4, label="outline of the margins")
    names = dict.fromkeys(["air", "protected", "target", "margin", "spared"])
    names |= {structure_of(name): None for name in structures_cut(whole, anatomy)}
    legend_below(figure, [*patches(*names), outline], 5)
    return figure


def _densest(points: np.ndarray, radius: float) -> np.ndarray:
    """The point with most others within `radius` mm."""
    some = points[:: max(1, len(points) // 500)]
    near = np.linalg.norm(some[:, None] - points[None], axis=2) < radius
    return some[int(np.argmax(near.sum(axis=1)))]


def _outline(axes: Axes, plane: Plane, mask: np.ndarray, colour: str, **style) -> None:
    """The outline of a mask of a plane's pixels."""
    if mask.any() and not mask.all():
        left, right, bottom, top = plane.extent
        n, m = mask.shape
        x = left + (np.arange(m) + 0.5) * (right - left) / m
        y = top + (np.arange(n) + 0.5) * (bottom - top) / n
        axes.contour(x, y, mask.astype(float), [0.5], colors=[colour], linewidths=style.get("lw", 1.4))


def landing_section(
    axes: Axes, plane: Plane, margin: SafetyMargin, grown: np.ndarray, landing: Landing
) -> None:
    """Structure and margin where they are, and the shell's corners where one registration puts them.

    Parameters
    ----------
    axes : Axes
    plane : Plane
    margin : SafetyMargin
        Says what the structure is.
    grown : (nx, ny, nz) bool array
        The margin drawn.
    landing : Landing
    """
    volume = margin.volume
    layers = [
        (plane.of(volume, grown), STYLES["margin"].colour, 0.45),
        (plane.of(volume, margin.structure_mask), style_of(margin.structure).colour, 1.0),
    ]
    plane.show(axes, layers)
    points_in_plane(axes, plane, volume, landing.landed, landing.hit, 9)


def points_in_plane(
    axes: Axes, plane: Plane, volume: LabelVolume, points: np.ndarray, harmful: np.ndarray, size: float
) -> None:
    """Mark those of a registration's points that lie within half a voxel of a plane, harmful ones by crosses.

    Parameters
    ----------
    axes : Axes
    plane : Plane
    volume : LabelVolume
    points : (n, 3) array
        mm.
    harmful : (n,) bool array
    size : float
        Of a harmless point's mark, square points.
    """
    place = plane.place(points)
    shown = np.abs(place[:, 2]) <= 0.5 * float(volume.spacing.min())
    for bad, colour, mark, scale in ((False, MISSED, "o", 1.0), (True, HIT, "X", 2.5)):
        kept = shown & (harmful == bad)
        axes.scatter(*place[kept, :2].T, s=scale * size, c=colour, marker=mark, lw=0, zorder=3)


@styled()
def growth_sections(axes: Sequence[Axes], plane: Plane, margin: SafetyMargin, step: GrowthStep) -> None:
    """Before, chosen, after: one step of the published growth in three axes.

    Parameters
    ----------
    axes : sequence of three Axes
    plane : Plane
    margin : SafetyMargin
    step : GrowthStep
    """
    volume = margin.volume
    body = (plane.of(volume, margin.structure_mask), style_of(margin.structure).colour, 1.0)
    before = (plane.of(volume, step.before), STYLES["margin"].colour, 0.8)
    shell = (plane.of(volume, step.shell), STYLES["analyzed_shell"].colour, 1.0)
    chosen = (plane.of(volume, step.chosen), STYLES["chosen"].colour, 1.0)
    after = (plane.of(volume, step.after), STYLES["margin"].colour, 0.8)
    next_shell = (plane.of(volume, step.next_shell), STYLES["analyzed_shell"].colour, 1.0)
    count = int(np.count_nonzero(step.chosen))
    titles = (
        f"(b) step {step.number}, risk {step.risk:.2g}",
        f"(c) {count} voxels chosen ({step.transfer_share:.0%})",
        "(d) margin and shell after it",
    )
    drawn = ([before, shell, body], [before, shell, chosen, body], [after, next_shell, body])
    for ax, title, layers in zip(axes, titles, drawn, strict=True):
        plane.show(ax, layers, title)
        voxel_grid(ax, plane, volume)


def voxel_grid(axes: Axes, plane: Plane, volume: LabelVolume) -> None:
    """The edges of the voxels, where a plane lies along the grid."""
    to_index = np.linalg.inv(volume.affine[:3, :3])
    start = volume.indices(plane.centre[None])[0]
    for direction, low, high, draw in (
        (plane.right, -plane.half_width, plane.half_width, axes.axvline),
        (plane.down, -plane.half_height, plane.half_height, axes.axhline),
    ):
        step = to_index @ np.asarray(direction)
        axis = int(np.argmax(np.abs(step)))
        if np.abs(np.delete(step, axis)).max() > 1e-3 * abs(step[axis]):
            return
        ends = sorted((start[axis] + step[axis] * low, start[axis] + step[axis] * high))
        for edge in np.arange(np.ceil(ends[0] + 0.5), ends[1] + 0.5) - 0.5:
            draw((edge - start[axis]) / step[axis], color="#00000022", lw=0.5)


@styled()
def transfer_figure(margin: SafetyMargin) -> Figure:
    """Figure 3.8: transfer percentage against overall damage risk, and what a growth did.

    Parameters
    ----------
    margin : SafetyMargin
        Grown with ``method="published"``.

    Raises
    ------
    InputError
        If it was not.
    """
    if margin.history is None:
        raise InputError(f"{margin.structure}: expected a margin grown in steps, got method 'exact'")
    history = margin.history
    moved = np.diff(history["margin_voxels"]) / history["shell_voxels"].to_numpy()[:-1]
    risk = history["risk"].to_numpy()[:-1]
    start = margin.settings.decay_start_of(margin.structure)
    initial = margin.settings.initial_transfer
    figure, axes = new_axes(1, 2, (12, 4.6))
    for ax, x in zip(
        axes[0], (np.linspace(0, 1, 400), np.geomspace(margin.acceptable_risk, 1, 400)), strict=True
    ):
        for name in ACCEPTABLE_RISKS:
            if name != margin.structure:
                law = [transfer_share(r, ACCEPTABLE_RISKS[name], initial, DECAY_STARTS[name]) for r in x]
                ax.plot(x, 100 * np.array(law), color=style_of(name).colour, lw=1.2, ls="--")
        law = [transfer_share(r, margin.acceptable_risk, initial, start) for r in x]
        ax.plot(x, 100 * np.array(law), color="black", lw=2)
        ax.plot(risk, 100 * moved, "o", ms=5, mfc="#d1372c", mec="white", mew=0.5, zorder=3)
        ax.axvline(margin.acceptable_risk, color="black", lw=0.9, ls=":")
        ax.set(
            xlabel="overall damage risk at the start of a step",
            ylabel="transferred (% of the analyzed shell)",
        )
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set(xlim=(0, 1.03), ylim=(0, 100 * initial * 1.12), title="(a) as the text draws it")
    axes[0, 0].annotate(
        "the steps go this way", (0.42, 100 * initial * 1.06), (0.97, 100 * initial * 1.06), va="center",
        ha="right", arrowprops={"arrowstyle": "-|>", "color": "#444444"},
    )  # fmt: skip
    axes[0, 1].set(xscale="log", yscale="log", xlim=(margin.acceptable_risk / 1.6, 1.3), ylim=(5e-3, 40))
    axes[0, 1].set_title("(b) the same on logarithmic axes")
    handles = [
        Line2D([], [], color="black", lw=2, label=f"{style_of(margin.structure).title}"),
        *(
            Line2D([], [], color=style_of(n).colour, lw=1.2, ls="--", label=style_of(n).title)
            for n in ACCEPTABLE_RISKS
            if n != margin.structure
        ),
        Line2D([], [], marker="o", ls="", mfc="#d1372c", mec="white", ms=6,
               label=f"steps of one growth ({len(risk)})"),
        Line2D([], [], color="black", lw=0.9, ls=":", label=f"acceptable risk {margin.acceptable_risk:g}"),
    ]  # fmt: skip
    legend_below(figure, handles, 4)
    return figure


@styled()
def risk_against_margin(margins: Sequence[SafetyMargin]) -> Figure:
    """Overall damage risk against the margin's volume and against the distance it reaches.

    Parameters
    ----------
    margins : sequence of SafetyMargin
        By the exact method.
    """
    figure, axes = new_axes(1, 2, (12, 4.9), sharey=True)
    handles = []
    curves = [margin.curve() for margin in margins]
    for margin, table in zip(margins, curves, strict=True):
        style = style_of(margin.structure)
        chosen = margin.volume_mm3, margin.distance
        for ax, column, x in zip(axes[0], ("volume_mm3", "distance"), chosen, strict=True):
            ax.step(table[column], table["risk"], where="post", color=style.colour, lw=1.8)
            ax.plot(x, margin.damage_risk, "o", ms=8, mfc=style.colour, mec="black", zorder=4)
            ax.plot([x], [margin.acceptable_risk], "_", ms=15, mew=2, color="black", zorder=4)
        handles.append(Line2D([], [], color=style.colour, lw=2.4, label=style.title))
    least = min(table.loc[table["risk"] > 0, "risk"].min() for table in curves)
    axes[0, 0].set(yscale="log", xlabel="volume of the margin (mm³)", ylabel="overall damage risk")
    axes[0, 0].set(xlim=(0, None), ylim=(least / 1.5, 1.3), title="(a) what safety costs in bone")
    axes[0, 1].set(xlabel="distance the margin reaches (standard deviations of the error)", xlim=(0, None))
    axes[0, 1].set_title("(b) the same against the largest Mahalanobis distance")
    for ax in axes[0]:
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="#00000015", lw=0.6)
    handles += [
        Line2D([], [], marker="o", ls="", ms=8, mfc="#bbbbbb", mec="black", label="margin chosen"),
        Line2D([], [], marker="_", ls="", ms=15, mew=2, color="black", label="acceptable risk"),
    ]
    legend_below(figure, handles, 4)
    return figure
