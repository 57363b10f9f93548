"""The figures of Siebold's chapter 4 that are seen in space, drawn anew from any kidney and its margins."""

from __future__ import annotations

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np
import pyvista as pv
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from study.margins import SafetyMargin
from study.margins.removal_steps import Protrusion, RemovalStep, outermost
from study.plots.margins import HIT, MISSED
from study.plots.palette import STYLES
from study.plots.planes import Plane
from study.plots.removal import (
    anatomy_layers,
    axial_plane,
    coronal_plane,
    margin_section,
    points_near,
    protrusion_section,
    removal_sections,
    risk_colours,
)
from study.plots.style import patches, styled
from study.rendering.board import Board, with_room
from study.rendering.scene import Scene
from study.rendering.views import View
from study.rendering.voxels import voxel_cubes
from study.specimens import KidneyCase
from study.volumes import LabelVolume

#: Onto the side that was traced, the anterior one.
_FROM_THE_FRONT = View(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))
#: Without the palest yellow, which is lost on white.
_SHARES = mpl.colors.LinearSegmentedColormap.from_list(
    "shares", mpl.colormaps["YlOrRd"](np.linspace(0.18, 1, 128))
)
_PLANNED = "#6d7580"


def kidney_view(case: KidneyCase) -> View:
    """From the front, turned until the tumour is on the near side as far as 50 degrees allow."""
    kidney = case.anatomy.points(np.argwhere(case.anatomy.mask("kidney"))).mean(axis=0)
    outward = case.tumour_centre - kidney
    views = [_FROM_THE_FRONT.turned(right, up) for right in (-50, -25, 0, 25, 50) for up in (-15, 10, 30)]
    return min(views, key=lambda view: float(view.looking @ outward))


def _mesh(case: KidneyCase) -> pv.PolyData:
    """Surface of kidney and tumour together."""
    mesh = pv.wrap(case.surface)
    return mesh.compute_normals(cell_normals=False, split_vertices=False, auto_orient_normals=True)


def _dots(scene: Scene, points: np.ndarray, colour: str, size: float, title: str = "") -> None:
    if len(points):
        scene.mesh(
            pv.PolyData(np.asarray(points, float)), "path", colour=colour, opacity=1.0, title=title,
            style="points", render_points_as_spheres=True, point_size=size, lighting=False,
        )  # fmt: skip


def _swab(scene: Scene, case: KidneyCase, size: float = 5.0) -> None:
    _dots(scene, case.swab, STYLES["swab"].colour, size, STYLES["swab"].title)


def _dot(colour: str, label: str, mark: str = "o") -> Line2D:
    return Line2D([], [], marker=mark, ls="", ms=6, mfc=colour, mew=0, label=label)


def _swab_dot() -> Line2D:
    return _dot(STYLES["swab"].colour, STYLES["swab"].title)


def _extent(volume: LabelVolume, mask: np.ndarray, room: float) -> tuple[np.ndarray, np.ndarray]:
    """Middle and half extent (mm, LPS) of a mask, with room around."""
    points = volume.points(np.argwhere(mask))
    low, high = points.min(axis=0) - room, points.max(axis=0) + room
    return (low + high) / 2, (high - low) / 2


@styled()
def case_figure(case: KidneyCase) -> Figure:
    """Kidney, tumour and swab: from the front, from the tumour's side, and in two sections.

    Parameters
    ----------
    case : KidneyCase
    """
    volume, tumour = case.anatomy, case.anatomy.mask("tumour")
    board = Board(12.6, 8.3)
    near = kidney_view(case)
    for x, view, title in (
        (0.1, _FROM_THE_FRONT, "(a) from the front: the side that is traced"),
        (6.4, near if near.looking @ _FROM_THE_FRONT.looking < 0.95 else near.turned(90, 0), "(b) turned"),
    ):
        scene = Scene(view)
        scene.mask(tumour, volume.affine, "tumour")
        scene.mesh(_mesh(case), "kidney", opacity=0.4)
        _swab(scene, case)
        with_room(scene, 1.06, 6.0 / 4.0)
        board.scene(scene, x, 0.35, 6.0, 4.0, title)
    centre, whole = case.tumour_centre, volume.points(np.argwhere(volume.mask("kidney", "tumour")))
    for x, build, axes, along, title in (
        (0.7, axial_plane, [0, 1], 2, "(c) axial section through the tumour"),
        (6.9, coronal_plane, [0, 2], 1, "(d) coronal section"),
    ):
        cut = whole[np.abs(whole[:, along] - centre[along]) < volume.spacing.max()][:, axes]
        low, high = cut.min(axis=0) - 6, cut.max(axis=0) + 6
        at = centre.copy()
        at[axes] = (low + high) / 2
        plane = build(at, *(high - low) / 2)
        ax = _fitted(board, plane, x, 4.8, 5.4, 2.75)
        plane.show(ax, anatomy_layers(plane, volume), title)
        points_near(ax, plane, case.swab)
    return board.legend([*patches("kidney", "tumour"), _swab_dot()])


def _fitted(board: Board, plane: Plane, x: float, y: float, width: float, height: float) -> Axes:
    """Axes in the middle of a space, in the plane's proportions."""
    ratio = plane.half_width / plane.half_height
    wide, high = min(width, height * ratio), min(height, width / ratio)
    return board.axes(x + (width - wide) / 2, y + (height - high) / 2, wide, high)


def _levelled(plane: Plane, volume: LabelVolume) -> Plane:
    """The plane moved onto the voxel centres next to it, where it lies along the grid."""
    index = volume.indices(plane.centre[None])
    centre = volume.points(np.rint(index))[0]
    shift = (centre - plane.centre) @ plane.normal
    return Plane(
        plane.centre + shift * plane.normal, plane.right, plane.down, plane.half_width, plane.half_height
    )


@styled()
def protrusion_figure(case: KidneyCase, margin: SafetyMargin, grown: np.ndarray, shown: Protrusion) -> Figure:
    """Figure 4.2: one simulated registration of a margin that is not yet large enough.

    Parameters
    ----------
    case : KidneyCase
    margin : SafetyMargin
        Says what the structure is.
    grown : (nx, ny, nz) bool array
        The margin drawn, such as that at the start of a step.
    shown : Protrusion
        A registration of the structure that should stay in it.
    """
    volume = margin.volume
    union = margin.structure_mask | grown
    stray = shown.appear[shown.outside] if shown.outside.any() else shown.appear
    focus = stray[np.argmin(np.linalg.norm(stray - np.median(stray, axis=0), axis=1))]
    middle, half = _extent(volume, union, 4.0)
    outward = focus - middle
    views = [_FROM_THE_FRONT.turned(right, 15) for right in range(-160, 180, 20)]
    # Beside the view, so that what protrudes is seen against the white.
    view = min(views, key=lambda v: abs(float(v.looking @ outward) + 0.35 * float(np.linalg.norm(outward))))
    view = view.around(middle, 1.2 * float(np.abs(half).max()))
    planned, cloud, after = Scene(view), Scene(view), Scene(view)
    planned.mask(margin.structure_mask, volume.affine, "tumour")
    planned.mask(union, volume.affine, "removed_margin", opacity=0.35)
    _dots(cloud, shown.centres, _PLANNED, 4.0)
    _dots(after, shown.appear[~shown.outside], MISSED, 4.0)
    _dots(after, shown.appear[shown.outside], HIT, 9.0)
    after.mask(union, volume.affine, "removed_margin", opacity=0.3)
    board = Board(12.6, 9.3)
    titles = (
        "(a) tumour and margin",
        "(b) boundary voxels' centres, as planned",
        "(c) as one registration shows them",
    )
    for n, (scene, title) in enumerate(zip((planned, cloud, after), titles, strict=True)):
        board.scene(scene, 0.1 + 4.2 * n, 0.35, 4.0, 3.5, title)
    at = middle.copy()
    at[2] = focus[2]
    wide = max(half[0], half[1])
    whole = _levelled(axial_plane(at, wide), volume)
    close = _levelled(axial_plane(focus, 0.42 * wide), volume)
    for x, plane, title in (
        (1.5, whole, "(d) one voxel thick, through points that protrude"),
        (7.2, close, "(e) the same, enlarged"),
    ):
        axes = board.axes(x, 4.45, 3.7, 3.7)
        protrusion_section(axes, plane, margin, grown, shown)
        axes.set_title(title)
    board.figure.text(
        0.5,
        0.05,
        f"In {shown.hits} of {shown.registrations} registrations a part of the tumour appears outside; in "
        f"this one {shown.outside.sum()} of {len(shown.outside)} points.",
        ha="center",
        fontsize=10,
    )
    handles = [
        *patches("tumour", "removed_margin"),
        _dot(_PLANNED, "boundary voxel, as planned"),
        _dot(MISSED, "appears in tumour or margin"),
        _dot(HIT, "appears outside: left behind", "X"),
    ]
    return board.legend(handles)


@styled()
def violation_figure(case: KidneyCase, margin: SafetyMargin, step: RemovalStep) -> Figure:
    """Figure 4.3: the analyzed shell by how many registrations put the tumour's boundary into each voxel.

    Parameters
    ----------
    case : KidneyCase
    margin : SafetyMargin
    step : RemovalStep
        At whose start it is drawn: the shell about a finished margin is hardly ever overlapped.
    """
    volume = margin.volume
    voxels, shares = step.shell(margin.structure_mask)
    colours = risk_colours(shares)
    field = np.full(volume.shape, np.nan, np.float32)
    field[tuple(voxels.T)] = 100 * shares
    union = margin.structure_mask | step.before
    middle, half = _extent(volume, union, 8.0)
    board = Board(12.6, 4.35)
    view = kidney_view(case).around(middle, 1.3 * float(half.max()))
    scene = Scene(view)
    # Half of it, and the layer at the cut, so that what is inside shows.
    aside = (volume.points(voxels) - middle) @ view.right
    kept = outermost(np.isfinite(field) | union)[tuple(voxels.T)] & (aside < 0) | (np.abs(aside) <= 1.0)
    cubes = voxel_cubes(volume, volume.points(voxels[kept]), colours(100 * shares[kept]), 1.0)
    scene.mesh(
        cubes, "analyzed_shell", opacity=1.0, title="", scalars="value", cmap=_SHARES,
        clim=(0.0, 1.0), show_scalar_bar=False, ambient=0.5, diffuse=0.55,
    )  # fmt: skip
    scene.mask(margin.structure_mask, volume.affine, "tumour")
    scene.mask(union, volume.affine, "removed_margin", opacity=0.35)
    board.scene(scene, 0.1, 0.35, 4.3, 3.7, "(a) half of the shell, around margin and tumour")
    for n, (build, title) in enumerate(((axial_plane, "(b) axial"), (coronal_plane, "(c) coronal"))):
        plane = _levelled(build(middle, float(half.max())), volume)
        axes = board.axes(4.95 + 3.55 * n, 0.4, 3.0, 3.0)
        _shares_section(axes, plane, margin, step.before, field, colours)
        axes.set_title(title)
    bar = board.axes(11.75, 0.5, 0.16, 3.0)
    drawn = board.figure.colorbar(ScalarMappable(colours, _SHARES), cax=bar)
    drawn.set_label("overlapped in % of registrations")
    return board.legend(patches("tumour", "removed_margin"))


def _shares_section(
    axes: Axes, plane: Plane, margin: SafetyMargin, grown: np.ndarray, field: np.ndarray, colours
) -> None:
    volume = margin.volume
    values = plane.of(volume, np.nan_to_num(field, nan=-1.0) + 1.0) - 1.0  # nothing beyond the volume
    image = np.ones((*values.shape, 3))
    image[values >= 0] = _SHARES(colours(values[values >= 0]))[:, :3]
    for mask, name, opacity in (
        (grown, "removed_margin", 0.85),
        (margin.structure_mask, "tumour", 1.0),
    ):
        inside = plane.of(volume, mask)
        rgb = np.array(mpl.colors.to_rgb(STYLES[name].colour))
        image[inside] = (1 - opacity) * image[inside] + opacity * rgb
    axes.imshow(image, extent=plane.extent, interpolation="nearest")
    plane.frame(axes)


@styled()
def removal_growth_figure(case: KidneyCase, margin: SafetyMargin, step: RemovalStep) -> Figure:
    """Figure 4.4: one step of the printed growth, closing included, in space and in a section.

    Parameters
    ----------
    case : KidneyCase
    margin : SafetyMargin
    step : RemovalStep
        From `study.margins.removal_steps.removal_step`.
    """
    volume = margin.volume
    middle, half = _extent(volume, margin.structure_mask | step.after, 4.0)
    axis = int(np.argmax(np.abs(volume.directions[2])))
    counts = np.count_nonzero(step.chosen, axis=tuple({0, 1, 2} - {axis}))
    first, last = np.quantile(np.argwhere(margin.structure_mask)[:, axis], (0.25, 0.75)).astype(int)
    level = np.zeros(3)
    level[axis] = first + int(np.argmax(counts[first : last + 1]))
    at = middle.copy()
    at[2] = volume.points(level[None])[0, 2]
    plane = axial_plane(at, max(half[0], half[1]))
    scene = Scene(kidney_view(case).turned(0, 15))
    cubes = voxel_cubes(volume, volume.points(np.argwhere(step.chosen)), scale=1.0)
    scene.mesh(cubes, "violated", opacity=1.0)
    scene.mask(margin.structure_mask, volume.affine, "tumour")
    scene.mask(step.before | margin.structure_mask, volume.affine, "removed_margin", opacity=0.75)
    corners = [
        plane.centre + x * plane.half_width * plane.right + y * plane.half_height * plane.down
        for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    rectangle = pv.PolyData(np.array(corners), faces=[4, 0, 1, 2, 3])
    scene.mesh(rectangle, "path", colour="#0055a4", opacity=0.3, title="plane of the sections")
    board = Board(13.4, 4.2)
    with_room(scene, 1.15, 3.3 / 3.1)
    board.scene(scene, 0.1, 0.35, 3.3, 3.1, "(a) margin and voxels chosen")
    axes = [board.axes(3.95 + 3.2 * n, 0.35, 2.75, 2.75) for n in range(3)]
    removal_sections(axes, plane, margin, step)
    for ax in axes[1:]:
        ax.set_ylabel("")
    plate = Patch(facecolor="#0055a4", alpha=0.3, label="plane of the sections")
    return board.legend([*patches("tumour", "removed_margin", "violated", "enclosed"), plate])


@styled()
def margins_on_kidney(case: KidneyCase, margins: Mapping[str, SafetyMargin]) -> Figure:
    """Figure 4.6: the kidney with tumour, margin to be removed and swab, in a section and in space.

    Parameters
    ----------
    case : KidneyCase
    margins : mapping of str to SafetyMargin
        What each is called: one row a margin, all in one scale.
    """
    middle, half = _extent(case.anatomy, case.anatomy.mask("kidney", "tumour"), 5.0)
    low, high = middle - half, middle + half
    for margin in margins.values():
        around, reach = _extent(margin.volume, margin.inside, 3.0)
        low, high = np.minimum(low, around - reach), np.maximum(high, around + reach)
    middle, half = (low + high) / 2, (high - low) / 2
    at = case.tumour_centre.copy()
    at[:2] = middle[:2]
    plane = axial_plane(at, half[0], half[1])
    view = kidney_view(case).around(middle, 1.02 * float(np.linalg.norm(half[[0, 2]])) * 0.9)
    board = Board(12.6, 5.0 * len(margins) + 0.35)
    for row, (title, margin) in enumerate(margins.items()):
        volume, top = margin.volume, 5.0 * row
        ax = _fitted(board, plane, 0.6, top + 0.4, 5.2, 4.0)
        said = f"({'aceg'[row % 4]}) {title}, margin {margin.volume_mm3 / 1000:.1f} cm³"
        margin_section(ax, plane, margin, case.swab, said)
        scene = Scene(view)
        scene.mask(margin.structure_mask, volume.affine, "tumour")
        scene.mask(margin.inside, volume.affine, "removed_margin", opacity=0.5)
        scene.mesh(_mesh(case), "kidney", opacity=0.4)
        _swab(scene, case)
        board.scene(scene, 6.3, top + 0.4, 6.2, 4.4, f"({'bdfh'[row % 4]}) the same in space")
    return board.legend([*patches("kidney", "tumour", "removed_margin"), _swab_dot()])


@styled()
def inside_figure(case: KidneyCase, margin: SafetyMargin) -> Figure:
    """The region that a needle may aim at: in a section, enlarged, and in space.

    Parameters
    ----------
    case : KidneyCase
    margin : SafetyMargin
        With ``purpose="stay_inside"``.
    """
    volume = margin.volume
    middle, half = _extent(volume, margin.structure_mask, 3.0)
    if margin.inside.any():
        middle = volume.points(np.argwhere(margin.inside)).mean(axis=0)
    board = Board(12.6, 4.8)
    for n, (build, title) in enumerate(((axial_plane, "(a) axial"), (coronal_plane, "(b) coronal"))):
        plane = _levelled(build(middle, 1.15 * float(half.max())), volume)
        axes = board.axes(0.65 + 3.9 * n, 0.45, 3.3, 3.3)
        kidney, tumour = anatomy_layers(plane, volume)
        rim = plane.of(volume, margin.mask), STYLES["rim"].colour, 1.0
        inside = plane.of(volume, margin.inside), STYLES["surely_inside"].colour, 1.0
        plane.show(axes, [kidney, tumour, rim, inside], title)
    scene = Scene(kidney_view(case))
    scene.mask(margin.inside, volume.affine, "surely_inside")
    scene.mask(margin.structure_mask, volume.affine, "tumour", opacity=0.3)
    scene.mesh(_mesh(case), "kidney", opacity=0.2)
    with_room(scene, 1.08, 4.2 / 3.7)
    board.scene(scene, 8.3, 0.35, 4.2, 3.7, "(c) in space")
    return board.legend(patches("kidney", "tumour", "rim", "surely_inside"))
