"""The octree of the unmilled surface and the shafts checked against it (Siebold, figures 2.8, 2.9, 2.16)."""

from __future__ import annotations

import numpy as np
import pyvista as pv
from matplotlib.collections import PatchCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from study.collision import Drill, find_approach
from study.collision.octree import OctreeCheck
from study.errors import GeometryError, InputError
from study.plots.sections import section
from study.plots.style import legend_below, new_axes, patches, show_labels, styled
from study.rendering.panels import panels
from study.rendering.scene import Scene
from study.rendering.views import approach_view
from study.rendering.voxels import voxel_cubes
from study.volumes import LabelVolume

FREE, BLOCKED = "#0072b2", "#d55e00"
#: Voxels that a shaft overlaps: bright on any bone.
HIT = "#ffe100"
#: Boxes from the one around everything down; voxels are black, as in the text.
_COLOURS = ("#000000", "#1f6fd4", "#b8860b", "#7a3fb0", "#e0559b", "#0a7f5a", "#56b4e9", "#8e1b1b", "#4a8f8f")
_WIDTHS = (9.0, 6.0, 4.0, 3.0, 2.0, 1.5)


def box_wires(volume: LabelVolume, boxes: np.ndarray) -> pv.PolyData:
    """The edges of an octree's boxes, in the volume's mm frame.

    Parameters
    ----------
    volume : LabelVolume
        Gives size and directions.
    boxes : (n, 4) array
        Centre and edge length in voxels (of the index frame).

    Raises
    ------
    InputError
        If there is no box.
    """
    boxes = np.asarray(boxes, float).reshape(-1, 4)
    if not len(boxes):
        raise InputError("boxes: expected at least one to draw, got none")
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, -1).T
    pairs = np.array([(a, b) for a in range(8) for b in range(a) if np.abs(signs[a] - signs[b]).sum() == 2])
    corners = boxes[:, None, :3] + signs * boxes[:, None, 3:] / 2
    edges = (8 * np.arange(len(boxes))[:, None, None] + pairs).reshape(-1, 2)
    # Boxes that touch share edges: each is drawn once. Corners lie half-way between voxel centres.
    halves = np.round(2 * corners.reshape(-1, 3)).astype(int)
    points, numbers = np.unique(halves, axis=0, return_inverse=True)
    edges = np.unique(np.sort(numbers.ravel()[edges], axis=1), axis=0)
    lines = np.column_stack([np.full(len(edges), 2), edges]).ravel()
    return pv.PolyData(volume.points(points / 2), lines=lines)


class _Drawing:
    """An octree of a volume's unmilled surface, in voxels, and how to put parts of it into a scene."""

    def __init__(self, volume: LabelVolume, drill: Drill | None = None):
        self.volume = volume
        if drill is not None and np.ptp(volume.spacing) > 0.01 * volume.spacing.mean():
            raise GeometryError(
                f"expected nearly cubic voxels to draw shafts, got {volume.spacing.tolist()} mm"
            )
        cylinders = np.array((drill or Drill()).cylinders) / volume.spacing.mean()
        self.octree = OctreeCheck(~volume.mask("air"), np.ones(3), cylinders=cylinders)

    @property
    def top(self) -> int:
        return self.octree.levels - 1

    def name(self, level: int) -> str:
        return f"box of {self.volume.spacing.mean() * 2**level:.3g} mm" if level else "voxel of the surface"

    def colour(self, level: int) -> str:
        return _COLOURS[min(self.top - level, len(_COLOURS) - 1)] if level else "#000000"

    def near(self, level: int, centre: np.ndarray, half: float) -> np.ndarray:
        """The boxes of a level that reach into a cube of 2 `half` mm around a centre (mm)."""
        boxes = self.octree.boxes(level)
        apart = np.abs(boxes[:, :3] - self.volume.indices(centre))
        return boxes[(apart < half / self.volume.spacing + boxes[:, 3:] / 2 - 1e-6).all(axis=1)]

    def wires(self, scene: Scene, level: int, boxes: np.ndarray, width: float = 0.0) -> None:
        if len(boxes):
            scene.mesh(
                box_wires(self.volume, boxes), "supervoxel", title=self.name(level), opacity=1.0,
                colour=self.colour(level), render_lines_as_tubes=True,
                line_width=width or _WIDTHS[min(self.top - level, len(_WIDTHS) - 1)],
            )  # fmt: skip

    def voxels(self, scene: Scene, boxes: np.ndarray, scale: float = 1.0) -> None:
        """Voxels of the surface in the colours of what they are."""
        index = np.round(boxes[:, :3]).astype(int)
        target = self.volume.mask("target")[tuple(index.T)]
        for label, chosen in (("protected", ~target), ("target", target)):
            if chosen.any():
                cubes = voxel_cubes(self.volume, self.volume.points(index[chosen]), scale=scale)
                scene.mesh(cubes, label, opacity=1.0)


def _bone(scene: Scene, volume: LabelVolume, opacity: float = 1.0) -> Scene:
    solid = ~volume.mask("air")
    target = volume.mask("target")
    scene.mask(solid & ~target, volume.affine, "protected", opacity=opacity)
    return scene.mask(target, volume.affine, "target", opacity=opacity)


def octree_levels(
    volume: LabelVolume, centre: np.ndarray | None = None, approach: np.ndarray | None = None
) -> Figure:
    """Figure 2.8: the octree of the unmilled surface, its boxes from coarse to fine.

    Parameters
    ----------
    volume : LabelVolume
        Planning labels as they are at some moment of the milling.
    centre : (3,) array, optional
        mm; the finer levels are shown around the surface nearest to it: the burr's centre, for instance.
        The middle of the target by default.
    approach : (3,) array, optional
        Outside -> bone; found if not given.
    """
    drawing = _Drawing(volume)
    approach = find_approach(volume) if approach is None else np.asarray(approach, float)
    view = approach_view(approach, oblique=True)
    if centre is None:
        centre = volume.points(np.argwhere(volume.mask("target"))).mean(axis=0)
    surface = volume.points(drawing.octree.boxes(0)[:, :3])
    touched = surface[np.argmin(np.linalg.norm(surface - centre, axis=1))]
    whole, around, close = Scene(view), Scene(view.around(touched, 12.0)), Scene(view.around(touched, 4.0))
    for scene in (whole, around):
        _bone(scene, volume)
    for level in range(drawing.top, min(4, drawing.top - 1), -1):
        drawing.wires(whole, level, drawing.octree.boxes(level))
    for level in (4, 3):
        if level < drawing.top:
            drawing.wires(around, level, drawing.near(level, touched, 9.0), width=2.0 * (level - 2))
    drawing.voxels(close, drawing.near(0, touched, 3.0), scale=0.9)
    for level in (2, 1):
        drawing.wires(close, level, drawing.near(level, touched, 3.0), width=2.5 * level)
    titles = ["(a) the largest boxes", "(b) at the burr, smaller ones", "(c) the smallest, and the voxels"]
    return panels([whole, around, close], titles)


def whole_octree(volume: LabelVolume, approach: np.ndarray | None = None) -> Figure:
    """The octree of the unmilled surface in one picture: the boxes of its upper levels and the voxels.

    Parameters
    ----------
    volume : LabelVolume
        Planning labels as they are at some moment of the milling.
    approach : (3,) array, optional
        Outside -> bone; found if not given.
    """
    drawing = _Drawing(volume)
    scene = Scene(approach_view(find_approach(volume) if approach is None else approach, oblique=True))
    drawing.voxels(scene, drawing.octree.boxes(0))
    for level in range(drawing.top, max(drawing.top - 5, 0), -1):
        drawing.wires(scene, level, drawing.octree.boxes(level))
    counts = [len(drawing.octree.boxes(level)) for level in reversed(range(drawing.octree.levels))]
    return panels([scene], ["boxes a level, from the largest down: " + ", ".join(f"{n:,}" for n in counts)])


@styled()
def octree_section(
    volume: LabelVolume,
    position: np.ndarray | None = None,
    approach: np.ndarray | None = None,
    normal: int = -1,
) -> Figure:
    """One section of the octree: every level's boxes, and how thin the modelled surface is.

    Parameters
    ----------
    volume : LabelVolume
        Planning labels as they are at some moment of the milling.
    position : (3,) array, optional
        mm; the section goes through it. The middle of the target by default.
    approach : (3,) array, optional
        Outside -> bone, on top of the picture; found if not given.
    normal : int
        Grid axis across the section.
    """
    drawing = _Drawing(volume)
    approach = find_approach(volume) if approach is None else np.asarray(approach, float)
    everything = np.ones(volume.shape, bool)
    plane = section(volume, approach, normal=normal, around=everything)
    if position is not None:
        index = int(np.round(volume.indices(position))[plane.normal])
        plane = section(volume, approach, normal=plane.normal, index=index, around=everything)
    labels = np.where(volume.mask("air"), 0, np.where(volume.mask("target"), 2, 1))
    figure, axes = new_axes(1, 1, (9.0, 8.2))
    ax = axes[0, 0]
    show_labels(ax, plane.of(labels), {0: "air", 1: "protected", 2: "target"}, plane.spacing)
    handles = patches("protected", "target")
    for level in range(drawing.octree.levels):
        boxes = drawing.octree.boxes(level)
        cut = np.abs(boxes[:, plane.normal] - plane.index) < boxes[:, 3] / 2
        middles, size = plane.place(boxes[cut, :3]), 2.0**level * np.array(plane.spacing[::-1])
        width = 0.35 + 0.33 * level
        colour = drawing.colour(level)
        squares = [Rectangle(corner, *size) for corner in middles - size / 2]
        style = (
            {"facecolor": colour} if level == 0 else {"facecolor": "none", "edgecolor": colour, "lw": width}
        )
        ax.add_collection(PatchCollection(squares, zorder=2 + level, **style))
        handles.append(
            Line2D([], [], color=colour, lw=max(width, 1.0) if level else 4.0, label=drawing.name(level))
        )
    corners = plane.place(drawing.octree.boxes(drawing.top)[:, :3]) + np.array([[-1], [1]]) * size / 2 * 1.02
    ax.set(
        xlim=corners[:, 0],
        ylim=corners[::-1, 1],
        title="Section, outside on top: the modelled surface is one voxel thick",
    )
    legend_below(figure, handles)
    return figure


def _pose(
    scene: Scene, drawing: _Drawing, drill: Drill, position: np.ndarray, axis: np.ndarray, boxes: bool = True
) -> bool:
    """Add a drill, the voxels it collides with, and the octree's boxes that its shaft meets."""
    volume = drawing.volume
    met = drawing.octree.met(volume.indices(position), axis @ volume.directions)
    for level in range(1, drawing.octree.levels if boxes else 1):
        drawing.wires(scene, level, met[level])
    blocked = bool(len(met[0]))
    if blocked:
        cubes = voxel_cubes(volume, volume.points(met[0][:, :3]), scale=1.1)
        style = {"colour": HIT, "opacity": 1.0, "lighting": False}
        scene.mesh(cubes, "target", title="voxels in collision", **style)
    scene.drill(drill, position, axis, 40.0, opacity=0.55)
    return blocked


def shaft_against_octree(
    volume: LabelVolume,
    position: np.ndarray,
    free_axis: np.ndarray,
    blocked_axis: np.ndarray,
    drill: Drill | None = None,
    approach: np.ndarray | None = None,
) -> Figure:
    """Figure 2.9: a shaft that is free and one in collision, and the boxes of the octree each meets.

    Parameters
    ----------
    volume : LabelVolume
        Planning labels as they are at some moment of the milling.
    position : (3,) array
        Burr's centre, mm.
    free_axis, blocked_axis : (3,) arrays
        Unit vectors from the burr towards the drill's body, mm frame.
    drill : Drill, optional
    approach : (3,) array, optional
        Outside -> bone; found if not given.

    Raises
    ------
    InputError
        If the first shaft is in collision or the second is not.
    """
    drill = drill or Drill()
    drawing = _Drawing(volume, drill)
    approach = find_approach(volume) if approach is None else np.asarray(approach, float)
    scenes = []
    for axis, name, expected in ((free_axis, "free_axis", False), (blocked_axis, "blocked_axis", True)):
        scene = Scene(
            approach_view(approach, oblique=True).turned(20, 8).around(position - 5 * approach, 15.0)
        )
        _bone(scene, volume)
        if _pose(scene, drawing, drill, np.asarray(position, float), np.asarray(axis, float)) != expected:
            raise InputError(
                f"{name}: expected a shaft {'in collision' if expected else 'free of bone'}, got the opposite"
            )
        scenes.append(scene)
    return panels(scenes, ["(a) the shaft is free", "(b) the shaft is in collision"])


def shaft_range(
    volume: LabelVolume,
    position: np.ndarray,
    axes: np.ndarray,
    free: np.ndarray,
    drill: Drill | None = None,
    approach: np.ndarray | None = None,
) -> Figure:
    """Figure 2.16: a free shaft, one in collision, and the range of shafts that was tested.

    Parameters
    ----------
    volume : LabelVolume
        Planning labels as they are at some moment of the milling.
    position : (3,) array
        Burr's centre, mm.
    axes : (n, 3) array
        Unit vectors from the burr towards the drill's body, mm frame.
    free : (n,) bool array
        Which of them a check has called free.
    drill : Drill, optional
    approach : (3,) array, optional
        Outside -> bone; found if not given.

    Raises
    ------
    InputError
        If the shapes differ, or no shaft is free or none in collision.
    """
    position, axes, free = np.asarray(position, float), np.asarray(axes, float), np.asarray(free, bool)
    if axes.ndim != 2 or axes.shape[1] != 3 or free.shape != axes.shape[:1]:
        raise InputError(f"expected (n, 3) axes and (n,) flags, got shapes {axes.shape} and {free.shape}")
    if free.all() or not free.any():
        raise InputError(f"expected shafts of both kinds, got {free.sum()} free ones of {len(free)}")
    drill = drill or Drill()
    drawing = _Drawing(volume, drill)
    approach = find_approach(volume) if approach is None else np.asarray(approach, float)
    view = approach_view(approach, oblique=True).turned(20, 8).around(position - 5 * approach, 15.0)
    middle = axes[free].mean(axis=0)
    chosen = axes[free][np.argmax(axes[free] @ middle)], axes[~free][np.argmin(axes[~free] @ middle)]
    scenes = [_bone(Scene(view), volume) for _ in range(3)]
    for scene, axis in zip(scenes, chosen, strict=False):
        _pose(scene, drawing, drill, position, axis, boxes=False)
    length = drill.shaft_ends[0]
    for kind, colour, title in ((~free, BLOCKED, "in collision"), (free, FREE, "free")):
        ends = position + length * axes[kind]
        points = np.concatenate([np.broadcast_to(position, ends.shape), ends])
        lines = np.column_stack(
            [np.full(len(ends), 2), np.arange(len(ends)), len(ends) + np.arange(len(ends))]
        )
        scenes[2].mesh(
            pv.PolyData(points, lines=lines.ravel()), "shaft", colour=colour, opacity=1.0, title=title,
            line_width=2.0, render_lines_as_tubes=True,
        )  # fmt: skip
    titles = ["(a) free", "(b) in collision", f"(c) {len(axes)} axes tested, {free.sum()} free"]
    return panels(scenes, titles)
