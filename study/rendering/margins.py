"""The figures of Siebold's chapter 3 that are seen in space, drawn anew from any bone and its margins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from study.margins import SafetyMargin
from study.margins.illustration import GrowthStep, Landing, analyzed_shell
from study.plots.margins import HIT, MISSED, growth_sections, landing_section
from study.plots.palette import structure_of, style_of
from study.plots.planes import Plane, axial
from study.plots.style import patches, styled
from study.rendering.board import Board, with_room
from study.rendering.labelled import WIDE
from study.rendering.panels import panels
from study.rendering.scene import Scene
from study.rendering.views import View, approach_view, posterior_on_right
from study.rendering.voxels import voxel_cubes
from study.specimens import structure_mask
from study.specimens.structures import labels_of
from study.volumes import LabelVolume

RISKS = "magma_r"


def _points(scene: Scene, points: np.ndarray, colour: str, title: str, size: float) -> None:
    if len(points):
        scene.mesh(
            pv.PolyData(points), "path", colour=colour, opacity=1.0, title=title, style="points",
            render_points_as_spheres=True, point_size=size, lighting=False,
        )  # fmt: skip


@styled()
def landing_figure(margin: SafetyMargin, step: GrowthStep, landing: Landing, approach: np.ndarray) -> Figure:
    """Figure 3.4: one simulated registration of a margin that is not yet large enough.

    Parameters
    ----------
    margin : SafetyMargin
    step : GrowthStep
        The margin at its start is drawn.
    landing : Landing
        A registration of the shell around that margin.
    approach : (3,) array
        Outside -> bone.
    """
    volume = margin.volume
    struck = landing.landed[landing.hit] if landing.hit.any() else landing.landed
    focus = struck[np.argmin(np.linalg.norm(struck - np.median(struck, axis=0), axis=1))]
    body = volume.points(np.argwhere(margin.structure_mask))
    view = _facing(focus - _middle_near(body, focus), approach).around(focus, 3.6)
    truth, planned, both = Scene(view), Scene(view), Scene(view)
    for scene in (truth, planned, both):
        near = _within(volume, focus, 9.0)
        scene.mask(
            margin.structure_mask & near, volume.affine, margin.structure, smooth=20,
            opacity=0.5 if scene is both else 1.0,
        )  # fmt: skip
    truth.mask((step.before | margin.structure_mask) & near, volume.affine, "margin", opacity=0.3, smooth=20)
    shown = np.linalg.norm(landing.corners - focus, axis=1) < 8
    _points(planned, landing.corners[shown], "#7a828c", "", 4.5)
    _points(both, landing.landed[shown & ~landing.hit], MISSED, "", 4.5)
    _points(both, landing.landed[shown & landing.hit], HIT, "", 12)
    board = Board(12, 8.3)
    side = 3.85
    titles = ("(a) structure and margin", "(b) corners of the shell as planned",
              "(c) after one simulated registration")  # fmt: skip
    for n, (scene, title) in enumerate(zip((truth, planned, both), titles, strict=True)):
        board.scene(scene, 0.1 + n * 4.0, 0.35, side, 3.2, title)
    for n, share in enumerate((0.1, 0.5, 0.9)):
        height = np.quantile(struck[:, 2], share)
        level = struck[np.argmin(np.abs(struck[:, 2] - height))]
        plane = axial((level + _middle_near(body, level)) / 2, approach, 2.9, 2.3)
        axes = board.axes(0.65 + n * 3.95, 4.2, 3.2, 3.2 * 2.3 / 2.9)
        landing_section(axes, plane, margin, step.before, landing)
        axes.set_title(f"({'def'[n]}) section, {('through low', 'through middle', 'through high')[n]} hits")
        if n:
            axes.set_ylabel("")
    share = f"{landing.hits} of {landing.registrations} registrations do damage; in this one"
    board.figure.text(
        0.5, 0.075, f"{share} {landing.hit.sum()} of {len(landing.hit)} corners hit. Nothing is exaggerated.",
        ha="center", fontsize=10,
    )  # fmt: skip
    handles = [
        *patches(margin.structure, "margin"),
        Line2D([], [], marker="o", ls="", ms=6, mfc="#7a828c", mew=0, label="corner as planned"),
        Line2D([], [], marker="o", ls="", ms=6, mfc=MISSED, mew=0, label="lands outside the structure"),
        Line2D([], [], marker="X", ls="", ms=8, mfc=HIT, mew=0, label="lands in it: hit"),
    ]
    return board.legend(handles)


def _height(offset: np.ndarray, at_zero: str) -> str:
    if abs(offset[2]) < 0.05:
        return at_zero
    return f"{abs(offset[2]):.1f} mm {'higher' if offset[2] > 0 else 'lower'}"


def _middle_near(points: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Middle of the points about as high as one and not far from it."""
    step = points - point
    near = (np.abs(step[:, 2]) < 0.5) & (np.linalg.norm(step, axis=1) < 3.0)
    return points[near].mean(axis=0) if near.any() else point


def _facing(outward: np.ndarray, approach: np.ndarray) -> View:
    """The surgeon's view, turned until it looks at the side of a structure that points `outward`."""
    views = [approach_view(approach).turned(right, 20) for right in (-60, -30, 0, 30, 60)]
    return min(views, key=lambda view: float(view.looking @ outward))


def _within(volume: LabelVolume, centre: np.ndarray, mm: float) -> np.ndarray:
    """Bool mask of a box of voxels around a point."""
    middle = volume.indices(centre[None])[0]
    reach = mm / volume.spacing
    out = np.zeros(volume.shape, bool)
    low = np.maximum(np.floor(middle - reach), 0).astype(int)
    out[tuple(slice(a, int(b) + 1) for a, b in zip(low, middle + reach, strict=True))] = True
    return out


@styled()
def shell_risks(margins: Sequence[SafetyMargin], titles: Sequence[str], approach: np.ndarray) -> Figure:
    """Figure 3.6: analyzed shells coloured by point damage risk, from outside and in three sections each.

    Parameters
    ----------
    margins : sequence of SafetyMargin
        Of one structure, drawn below each other on one scale.
    titles : sequence of str
    approach : (3,) array
        Outside -> bone.
    """
    shells = [analyzed_shell(margin) for margin in margins]
    floor = 1e-12
    every = np.log10(np.maximum(np.concatenate([risks for _, risks in shells]), floor))
    norm = mpl.colors.Normalize(np.floor(np.quantile(every, 0.01)), np.ceil(every.max()))
    volume = margins[0].volume
    levels = _levels(volume, margins[0].structure_mask)
    board = Board(12.4, 3.45 * len(margins) + 0.65)
    for row, (margin, (voxels, risks), title) in enumerate(zip(margins, shells, titles, strict=True)):
        log = np.log10(np.maximum(risks, floor))
        field = np.zeros(volume.shape, np.float32)
        field[tuple(voxels.T)] = log
        scene = Scene(approach_view(approach, oblique=True).turned(20 * posterior_on_right(approach), 0))
        cubes = voxel_cubes(volume, volume.points(voxels), log, 1.0)
        scene.mesh(
            cubes, "analyzed_shell", opacity=1.0, title="", scalars="value", cmap=RISKS,
            clim=(norm.vmin, norm.vmax), show_scalar_bar=False, ambient=0.55, diffuse=0.5,
        )  # fmt: skip
        top = 0.35 + 3.45 * row
        board.scene(scene, 0.1, top, 4.0, 3.0, title)
        for n, centre in enumerate(levels):
            plane = axial(centre, approach, 3.1, 3.6)
            axes = board.axes(4.65 + 2.25 * n, top, 2.1, 2.1 * 3.6 / 3.1)
            _risk_section(axes, plane, margin, field, norm)
            axes.set_title(_height(centre - levels[1], "middle level"))
            if n:
                axes.set(ylabel="", yticklabels=[])
    bar = board.axes(11.5, 0.5, 0.16, 3.45 * len(margins) - 1.1)
    ticks = np.arange(norm.vmin, norm.vmax + 1, max(1, int((norm.vmax - norm.vmin) // 6)))
    drawn = board.figure.colorbar(ScalarMappable(norm, mpl.colormaps[RISKS]), cax=bar)
    drawn.set_ticks(ticks, labels=[f"$10^{{{int(t)}}}$" for t in ticks])
    drawn.set_label("point damage risk")
    return board.legend(patches(margins[0].structure, "margin"))


def _levels(volume: LabelVolume, mask: np.ndarray) -> list[np.ndarray]:
    """(3,) mm of the middle of a mask at a low, its most typical and a high level."""
    points = volume.points(np.argwhere(mask))
    out = []
    for share in (0.25, 0.45, 0.65):
        height = np.quantile(points[:, 2], share)
        near = points[np.abs(points[:, 2] - height) <= volume.spacing.min()]
        out.append(np.array([*near[:, :2].mean(axis=0), height]))
    return out


def _risk_section(axes: Axes, plane: Plane, margin: SafetyMargin, field: np.ndarray, norm) -> None:
    volume = margin.volume
    values = plane.of(volume, field)
    image = np.ones((*values.shape, 3))
    image[values < 0] = mpl.colormaps[RISKS](norm(values[values < 0]))[:, :3]
    for mask, name, opacity in ((margin.mask, "margin", 0.6), (margin.structure_mask, margin.structure, 1.0)):
        inside = plane.of(volume, mask)
        rgb = np.array(mpl.colors.to_rgb(style_of(name).colour))
        image[inside] = (1 - opacity) * image[inside] + opacity * rgb
    axes.imshow(image, extent=plane.extent, interpolation="nearest")
    plane.frame(axes)


@styled()
def growth_figure(margin: SafetyMargin, step: GrowthStep, approach: np.ndarray) -> Figure:
    """Figure 3.7: one step of the published growth in space and in a section.

    Parameters
    ----------
    margin : SafetyMargin
    step : GrowthStep
        From `study.margins.illustration.growth_step`.
    approach : (3,) array
        Outside -> bone.
    """
    volume = margin.volume
    plane = axial(_telling_level(volume, margin.structure_mask, step.chosen), approach, 3.2)
    scene = Scene(approach_view(approach).turned(38 * posterior_on_right(approach), 35))
    scene.mask(margin.structure_mask, volume.affine, margin.structure, smooth=20)
    scene.mask(step.before | margin.structure_mask, volume.affine, "margin", smooth=20)
    corners = [
        plane.centre + x * plane.half_width * plane.right + y * plane.half_height * plane.down
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    rectangle = pv.PolyData(np.array(corners), faces=[4, 0, 1, 2, 3])
    scene.mesh(rectangle, "path", colour="#0055a4", opacity=0.35, title="plane of the sections")
    board = Board(13.4, 4.2)
    board.scene(scene, 0.1, 0.35, 3.3, 3.1, "(a) structure, margin, plane")
    axes = [board.axes(3.95 + 3.2 * n, 0.35, 2.75, 2.75) for n in range(3)]
    growth_sections(axes, plane, margin, step)
    for ax in axes[1:]:
        ax.set_ylabel("")
    plate = Patch(facecolor="#0055a4", alpha=0.35, label="plane of the sections")
    return board.legend([*patches(margin.structure, "margin", "analyzed_shell", "chosen"), plate])


def _telling_level(volume: LabelVolume, structure: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(3,) mm of the structure's middle in the level of its middle half with most voxels chosen."""
    axis = int(np.argmax(np.abs(volume.directions[2])))
    voxels = np.argwhere(structure)
    low, high = np.quantile(voxels[:, axis], (0.2, 0.6)).astype(int)
    counts = np.count_nonzero(chosen, axis=tuple({0, 1, 2} - {axis}))[low : high + 1]
    level = low + int(np.argmax(counts))
    cut = voxels[voxels[:, axis] == level]
    return volume.points(cut if len(cut) else voxels).mean(axis=0)


def margins_in_space(
    volume: LabelVolume,
    planning: LabelVolume,
    margins: Sequence[SafetyMargin],
    fiducials: np.ndarray,
    approach: np.ndarray,
) -> Figure:
    """Figure 3.9: fiducials, bone, target; and the structures in their transparent margins.

    Parameters
    ----------
    volume : LabelVolume
        Anatomy.
    planning : LabelVolume
        With the target.
    margins : sequence of SafetyMargin
    fiducials : (n, 3) mm
    approach : (3,) array
        Outside -> bone.
    """
    turned = approach_view(approach).turned(38 * posterior_on_right(approach), 24)
    whole, close = Scene(turned), Scene(turned)
    target = planning.mask("target")
    for point in np.asarray(fiducials, float):
        whole.mesh(pv.Sphere(radius=1.6, center=point), "fiducial", opacity=1.0)
    for margin in margins:
        body = structure_mask(volume, margin.structure)
        wide = any(structure_of(label) in WIDE for label in labels_of(volume, margin.structure))
        whole.mask(body, volume.affine, margin.structure, opacity=0.35 if wide else 1.0)
        close.items.append(whole.items[-1])
        around = margin.mask | margin.structure_mask
        close.mask(around, margin.volume.affine, "margin", opacity=0.2 if wide else 0.4, smooth=60)
    whole.mask(target, planning.affine, "target", opacity=0.4)
    close.items.append(replace(whole.items[-1], opacity=0.13))
    for name in (n for n in volume.names if structure_of(n) == "bone"):
        whole.mask(volume.mask(name) & ~target, volume.affine, name, opacity=0.25)
    for scene in (whole, close):
        with_room(scene, 1.12)
    return panels(
        [whole, close],
        ["(a) fiducials, target and structures", "(b) structures in their safety margins"],
    )
