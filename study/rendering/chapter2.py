"""The 3-D figures of Siebold's chapter 2, drawn anew from any planning volume and plan."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from study.collision import Drill, find_approach
from study.errors import InputError
from study.planners import ModifiedVolume, Plan
from study.planners.moments import Moment
from study.plots.palette import structure_of as _kind
from study.plots.short_path import descending_path, manhattan_labels
from study.plots.style import new_axes, styled
from study.rendering.milling import milling_frames
from study.rendering.panels import panels
from study.rendering.scene import Scene
from study.rendering.views import View, approach_view, side_view
from study.rendering.voxels import box_edges, voxel_cubes
from study.volumes import LabelVolume

RANKS = "cividis"
#: Labels that are no structure to look at.
HOLLOW = {"air", "air_cells", "middle_ear", "bone", "intracranial"}


def _same_view(*scenes: Scene) -> None:
    """Give all scenes the placed view of the last one."""
    view = scenes[-1].placed_view(4 / 3)
    for scene in scenes:
        scene.view = view


def _protected(volume: LabelVolume) -> np.ndarray:
    return ~(volume.mask("air") | volume.mask("target"))


def segmentation(volume: LabelVolume, approach: np.ndarray | None = None) -> Figure:
    """Figure 2.1: air, targeted bone, protected bone, and all three.

    Parameters
    ----------
    volume : LabelVolume
        With air and target; the rest is protected.
    approach : (3,) array, optional
        Outside -> bone; found if not given.
    """
    view = approach_view(find_approach(volume) if approach is None else approach, oblique=True)
    air, target, protected, combined = (Scene(view) for _ in range(4))
    air.label(volume, "air", opacity=0.55, colour="#a9c9e0")
    target.label(volume, "target", opacity=1.0)
    protected.mask(_protected(volume), volume.affine, "protected")
    combined.items = [*protected.items, *target.items]
    combined.label(volume, "air", opacity=0.18, colour="#a9c9e0", title="")
    _same_view(air, target, protected, combined)
    return panels(
        [air, target, protected, combined],
        ["(a) air", "(b) targeted bone", "(c) protected bone", "(d) all three"],
    )


def modified_segmentation(modified: ModifiedVolume, approach: np.ndarray | None = None) -> Figure:
    """Figure 2.5: the modified volume; its target stands out into the air and has a boundary."""
    volume = modified.as_label_volume()
    approach = find_approach(modified.volume) if approach is None else approach
    view = approach_view(approach, oblique=True)
    air, target, protected, combined = (Scene(view) for _ in range(4))
    air.mask(volume.mask("air"), volume.affine, "air", opacity=0.55, colour="#a9c9e0")
    inner = volume.mask("target")
    across = side_view(approach)
    near = volume.points(np.argwhere(modified.target)) @ across.looking
    half = np.zeros(volume.shape, bool)
    half[tuple(np.argwhere(modified.target)[near >= np.median(near)].T)] = True
    target.view = across.turned(12, 10)
    target.mask(inner & half, volume.affine, "target", exact=True, opacity=1.0)
    target.mask(modified.boundary & half, volume.affine, "target_boundary", exact=True, opacity=1.0)
    protected.mask(volume.mask("protected"), volume.affine, "protected")
    combined.items = list(protected.items)
    combined.mask(inner, volume.affine, "target", opacity=1.0)
    combined.mask(modified.boundary, volume.affine, "target_boundary", opacity=1.0)
    combined.mask(volume.mask("air"), volume.affine, "air", opacity=0.18, colour="#a9c9e0", title="")
    _same_view(air, protected, combined)
    return panels(
        [air, target, protected, combined],
        ["(a) air", "(b) targeted bone with its boundary, cut open", "(c) protected bone", "(d) all three"],
    )


def anatomy(volume: LabelVolume | None, planning: LabelVolume, approach: np.ndarray | None = None) -> Figure:
    """The segmented bone from outside with the target, and the structures around the target inside it.

    Parameters
    ----------
    volume : LabelVolume or None
        Anatomical labels; without them the target is shown in the protected bone only.
    planning : LabelVolume
        Of the same bone, with the target.
    approach : (3,) array, optional
        Outside -> bone; found if not given.
    """
    approach = find_approach(planning) if approach is None else approach
    outside, inside = (Scene(approach_view(approach, oblique=True)) for _ in range(2))
    target = planning.mask("target")
    if volume is None:
        outside.mask(_protected(planning), planning.affine, "protected")
        outside.label(planning, "target", opacity=1.0)
        return panels([outside])
    names = [name for name in volume.names if _kind(name) not in HOLLOW and volume.mask(name).any()]
    for name in (name for name in volume.names if _kind(name) == "bone"):
        kept = volume.mask(name)
        outside.mask(kept & ~target if kept.shape == target.shape else kept, volume.affine, name)
    outside.label(volume, *names)
    outside.label(planning, "target", opacity=1.0)
    inside.label(volume, *[name for name in names if _kind(name) != "temporomandibular_joint"])
    inside.label(planning, "target", opacity=0.22)
    _same_view(inside, outside)
    return panels([outside, inside], ["(a) from outside", "(b) what the target lies between"])


@styled()
def drill_figure(drill: Drill) -> Figure:
    """Figure 2.6: the burr and the three cylinders of the shaft, with their sizes in mm."""
    scene = Scene(View([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]))
    end = drill.shaft_ends[-1]
    scene.drill(drill, np.zeros(3), np.array([1.0, 0.0, 0.0]), length=end)
    low, high = -drill.burr_radius - 3, end + 3
    half = 0.125 * (high - low)
    scene.view = scene.view.around([(low + high) / 2, 0, 0], half)
    figure, axes = new_axes(1, 1, (12, 3.8))
    ax = axes[0, 0]
    size = (1800, int(1800 * 2 * half / (high - low)))
    ax.imshow(scene.image(size), extent=(low, high, -half, half))
    names = ("shaft", "chuck", "barrel")
    rows = list(zip(names, drill.cylinders, strict=True))
    above = drill.cylinders[-1][0] + 3.0
    for n, (name, (radius, start, stop)) in enumerate(rows):
        ax.annotate("", (start, -above), (stop, -above), arrowprops={"arrowstyle": "<->", "lw": 0.9})
        middle = (start + stop) / 2
        ax.text(
            middle, -above - 0.8, f"{name}\n{start:.3g} to {stop:g} mm", ha="center", va="top", fontsize=9
        )
        where = start + 0.7 * (stop - start)
        ax.annotate("", (where, radius), (where, above), arrowprops={"arrowstyle": "->", "lw": 0.9})
        ax.annotate("", (where, -radius), (where, -above + 0.3), arrowprops={"arrowstyle": "->", "lw": 0.9})
        ax.text(where, above + 0.4, f"Ø {2 * radius:g} mm", ha="center", va="bottom", fontsize=9)
        if n == 0:
            ax.annotate(
                f"burr Ø {drill.burr_diameter:g} mm",
                (0, drill.burr_radius), (0, above + 0.6),
                ha="center", fontsize=9, arrowprops={"arrowstyle": "->", "lw": 0.9},
            )  # fmt: skip
    ax.set(xlabel="mm from the burr's centre along the axis", yticks=[], xlim=(low, high), ylim=(-half, half))
    for side in ("left", "right", "top"):
        ax.spines[side].set_visible(False)
    return figure


def supervoxel(moment: Moment) -> Figure:
    """Figure 2.10: the voxels of a supervoxel by kind, whole and cut open at its centre."""
    volume = moment.modified
    centre = moment.index
    grids = np.meshgrid(*[np.arange(-r, r + 1) for r in moment.reach], indexing="ij")
    offsets = np.stack([g.ravel() for g in grids], axis=1)
    points = volume.points(centre + offsets)
    labels = volume.labels[tuple((centre + offsets).T)]
    toward = -approach_direction(moment)
    view = approach_view(-toward).turned(32, 26)
    view = view.around(moment.position, 1.35 * float((moment.reach * volume.spacing).max() + 0.5))
    whole, opened = Scene(view), Scene(view)
    in_front = (points - moment.position) @ toward > 1e-6
    middle = (offsets == 0).all(axis=1)
    for scene, shown in ((whole, np.ones(len(points), bool)), (opened, ~in_front)):
        for name in ("protected", "target", "target_boundary", "removed", "air"):
            kind = shown & (labels == volume.names[name]) & ~(middle & (scene is opened))
            if kind.any():
                scene.mesh(voxel_cubes(volume, points[kind]), name, opacity=1.0, show_edges=True)
        if scene is opened:
            cube = voxel_cubes(volume, points[middle], scale=1.0)
            scene.mesh(cube, "supervoxel", opacity=1.0, title="centre: burr's centre")
    size = " x ".join(str(2 * r + 1) for r in moment.reach)
    return panels([whole, opened], [f"(a) supervoxel of {size} voxels", "(b) its outer half taken away"])


def approach_direction(moment: Moment) -> np.ndarray:
    """(3,) unit vector in mm along which the drill enters."""
    frame = moment.frame
    return frame.into_bone * moment.unmodified.directions[:, frame.depth_axis]


def candidates(moment: Moment, half_width: float = 3.6) -> Figure:
    """Figure 2.17: what surrounds the supervoxel, and the candidate positions by rank of fitness.

    Parameters
    ----------
    moment : Moment
        With at least one candidate.
    half_width : float
        mm from the burr shown in panel (a).
    """
    volume = moment.modified
    near = np.abs(moment.unmodified.labels * 0) == 1
    reach = np.ceil(half_width / volume.spacing).astype(int)
    box = tuple(slice(max(0, i - r), i + r + 1) for i, r in zip(moment.index, reach, strict=True))
    near[box] = True
    outward = -approach_direction(moment)
    offsets = (volume.points(np.argwhere(near)) - moment.position) @ outward
    beyond = float((moment.reach * volume.spacing).max()) + 1e-6
    near[near] = offsets <= beyond  # opened from outside, down to the supervoxel
    view = approach_view(approach_direction(moment)).turned(28, 30)
    around, ranked = Scene(view.around(moment.position, 1.3 * half_width)), Scene(view)
    around.mask(near & volume.mask("protected"), volume.affine, "protected", exact=True)
    around.mask(near & volume.mask("target"), volume.affine, "target", exact=True, opacity=1.0)
    around.mask(near & volume.mask("target_boundary"), volume.affine, "target_boundary", exact=True)
    edges = {"colour": "#111111", "line_width": 4, "lighting": False}
    around.mesh(box_edges(volume, moment.position, moment.reach), "supervoxel", opacity=1.0, **edges)
    around.mesh(
        voxel_cubes(volume, moment.position[None], scale=1.0),
        "supervoxel",
        opacity=1.0,
        title="burr's centre",
    )
    scores, points = _ranked(moment)
    ranks = np.argsort(np.argsort(scores)) / max(1, len(scores) - 1)
    ranked.mesh(
        voxel_cubes(volume, points, ranks), "target", opacity=1.0, title="",
        scalars="value", cmap=RANKS, clim=(0, 1), show_scalar_bar=False, show_edges=True,
    )  # fmt: skip
    ranked.mesh(box_edges(volume, moment.position, moment.reach), "supervoxel", opacity=1.0, **edges)
    ranked.mesh(
        voxel_cubes(volume, moment.position[None], scale=1.0),
        "supervoxel",
        opacity=1.0,
        title="burr's centre",
    )
    best = points[np.argmax(scores)]
    way = best - moment.position
    if np.linalg.norm(way) > 0:
        ranked.path(np.stack([moment.position, best]), radius=0.07, title="to the best candidate")
    ranked.view = view.around(moment.position, 1.5 * float(((moment.reach + 1.5) * volume.spacing).max()))
    figure = panels(
        [around, ranked], ["(a) around the supervoxel", f"(b) {len(points)} accessible candidates by fitness"]
    )
    _bar(figure, "fitness", (f"lowest\n{scores.min():.1f}", f"highest\n{scores.max():.1f}"))
    return figure


def _ranked(moment: Moment) -> tuple[np.ndarray, np.ndarray]:
    if not len(moment.candidates):
        raise InputError(f"row {moment.row}: expected candidates for the next step, got none")
    return moment.scores, moment.candidates


def _bar(figure: Figure, title: str, ends: tuple[str, str]) -> None:
    axes = figure.add_axes((0.925, 0.5, 0.012, 0.34))
    bar = figure.colorbar(ScalarMappable(mpl.colors.Normalize(0, 1), mpl.colormaps[RANKS]), cax=axes)
    bar.set_ticks([0, 1], labels=list(ends))
    bar.ax.set_title(title, fontsize=9, pad=14)
    bar.ax.tick_params(labelsize=8)


def short_path_in_space(seed: int = 0) -> Figure:
    """Figure 2.13 (b): the labels of the box between burr and goal, and the short path around bone."""
    shape, start, goal = (6, 6, 6), (1, 1, 1), (4, 4, 4)
    bone = np.zeros(shape, bool)
    bone[2, 1:4, 1:3] = True
    bone[3, 1:3, 3] = True
    labels = manhattan_labels(bone, start, goal)
    path = np.array(descending_path(labels, start, seed), float)
    volume = LabelVolume(bone.astype(np.uint8), np.diag([0.4, 0.4, 0.4, 1.0]), {"air": 0, "protected": 1})
    view = View([0.75, 0.6, -0.4], [0.0, 0.0, 1.0])
    numbered, taken = Scene(view), Scene(view)
    box = np.argwhere(labels >= 0)
    options = {"scalars": "value", "cmap": RANKS, "show_scalar_bar": False, "show_edges": True}
    numbered.mesh(
        voxel_cubes(volume, volume.points(box), labels[labels >= 0], 0.5), "target", opacity=1.0, title="",
        **options,
    )  # fmt: skip
    ways = [tuple(int(i) for i in at) for at in path]
    steps = np.array([labels[at] for at in ways])
    taken.mesh(
        voxel_cubes(volume, volume.points(path), steps, 0.5), "target", opacity=1.0, title="",
        clim=(0, labels.max()), **options,
    )  # fmt: skip
    taken.path(volume.points(path), radius=0.05, title="short path")
    for scene in (numbered, taken):
        scene.mesh(box_edges(volume, volume.points(np.array([[1, 1, 1]]))[0], np.array([2, 2, 2])),
                   "supervoxel", opacity=1.0, colour="#111111", line_width=4, lighting=False)  # fmt: skip
        scene.mask(bone, volume.affine, "protected", exact=True, opacity=0.35)
    _same_view(taken, numbered)
    figure = panels(
        [numbered, taken], ["(a) Manhattan distance to go", f"(b) the path, {len(path) - 1} steps"]
    )
    _bar(figure, "to go", ("0", f"{labels.max()}"))
    return figure


def path_in_region(plan: Plan) -> Figure:
    """Figure 2.19: the path inside the modified target, and the path alone, coloured by its order."""
    view = side_view(plan.approach).turned(25, 12)
    inside, alone = Scene(view), Scene(view)
    order = np.linspace(0, 1, len(plan.points))
    inside.path(plan.points, radius=0.14)
    inside.mask(plan.modified.target, plan.volume.affine, "target", opacity=0.25, title="modified target")
    alone.path(plan.points, radius=0.09, values=order, cmap="viridis", clim=(0, 1), title="")
    _same_view(alone, inside)
    figure = panels(
        [inside, alone],
        [
            f"(a) path in the modified target ({plan.strategy}, {plan.length_mm / 1000:.2f} m)",
            "(b) path alone, from its start (dark) to its end (bright)",
        ],
    )
    return figure


def milling_strip(plan: Plan, n: int = 6) -> Figure:
    """The bone as it is milled: the same view at `n` moments, with the drill where it is then.

    Parameters
    ----------
    plan : Plan
        With its volume.
    n : int
        How many.
    """
    view = approach_view(plan.approach, oblique=True)
    frames = milling_frames(plan, n)
    volume = plan.volume
    target = volume.mask("target")
    corners = volume.points(np.argwhere(target)[:: max(1, target.sum() // 5000)])
    half = 0.62 * float(np.ptp(corners, axis=0).max()) + 5
    view = view.around((corners.min(axis=0) + corners.max(axis=0)) / 2 - 3 * plan.approach, half)
    fixed = Scene(view).mask(_protected(volume), volume.affine, "protected")
    scenes, titles = [], []
    for frame in frames:
        scene = Scene(view)
        scene.items = list(fixed.items)
        scene.label(frame.remaining, "target", opacity=1.0, smooth=15)
        scene.drill(plan.drill, frame.position, frame.axis, 40.0, opacity=0.6)
        scenes.append(scene)
        titles.append(
            f"{frame.removed_mm3 / plan.removed.sum():.0%} of the bone, {frame.path_mm / 1000:.2f} m of path"
        )
    return panels(scenes, titles, columns=min(3, n))


def plan_scene(plan: Plan, anatomy: LabelVolume | None = None) -> Scene:
    """The bone after milling, the path, the drill at its deepest, and the critical structures: to be turned.

    Parameters
    ----------
    plan : Plan
        With its volume.
    anatomy : LabelVolume, optional
        Anatomical labels of the same bone.
    """
    scene = Scene(approach_view(plan.approach, oblique=True))
    volume = plan.volume
    if anatomy is None:
        scene.mask(_protected(volume), volume.affine, "protected")
    else:
        bone = [name for name in anatomy.names if _kind(name) == "bone"]
        left = anatomy.mask(*bone) if bone else _protected(volume)
        if anatomy.shape == volume.shape:
            left = left & (~volume.mask("target") | plan.remaining.mask("target"))
        scene.mask(left, anatomy.affine, "bone")
        scene.label(anatomy, *[name for name in anatomy.names if _kind(name) not in HOLLOW])
    if plan.remaining.mask("target").any():
        scene.label(plan.remaining, "target", opacity=1.0, title="targeted bone left")
    scene.path(plan.points, radius=0.1)
    deepest = int(np.argmax(plan.points @ plan.approach))
    return scene.drill(plan.drill, plan.points[deepest], plan.axes[deepest], 40.0, opacity=0.6)


def scene_figure(scene: Scene, title: str = "") -> Figure:
    """A picture of one scene with scale bar and legend."""
    return panels([scene], [title] if title else ())
