"""A planned hole to the cochlea in the bone, with drills that err (Baron, section 2)."""

from __future__ import annotations

import numpy as np
import pyvista as pv
from matplotlib.figure import Figure

from study.guidance.access import AccessPlan
from study.rendering.panels import panels
from study.rendering.scene import Scene
from study.rendering.views import View, approach_view
from study.specimens.orientation import lateral_direction
from study.specimens.structures import labels_of

#: What is shown around the hole, from the inside out: translucent surfaces come last.
_SOLID = (
    "labyrinth",
    "facial_nerve",
    "chorda_tympani",
    "internal_auditory_canal",
    "ossicles",
    "carotid_artery",
)
_VEILED = {"external_auditory_canal": 0.35, "sigmoid_sinus": 0.18}
DRILL = "#c8322d"
ERRING = "#3a3f47"


def _structures(scene: Scene, plan: AccessPlan, names: tuple[str, ...], **style) -> Scene:
    for name in names:
        labels = labels_of(plan.anatomy, name)
        if labels:
            scene.mask(
                plan.anatomy.mask(*labels),
                plan.anatomy.affine,
                labels[0] if len(labels) == 1 else name,
                **style,
            )
    return scene


def _drill(scene: Scene, plan: AccessPlan, opacity: float = 1.0) -> Scene:
    """The capsule that a drill without error sweeps, a little beyond the bone's surface."""
    outside = plan.entry - 4.0 * plan.direction
    line = pv.Line(outside, plan.target)
    scene.mesh(
        line.tube(radius=plan.settings.drill_radius, n_sides=32, capping=True), "burr",
        colour=DRILL, opacity=opacity, title="drill as planned",
    )  # fmt: skip
    tip = pv.Sphere(radius=plan.settings.drill_radius, center=plan.target)
    return scene.mesh(tip, "burr", colour=DRILL, opacity=opacity, title="")


def _erring(scene: Scene, plan: AccessPlan, count: int) -> Scene:
    """Axes of some erring drills; the first drawn are as good as any."""
    errors = plan.risks.errors[:count]
    starts = plan.entry + errors[:, 0] - 4.0 * plan.direction
    ends = plan.target + errors[:, 1]
    points = np.stack([starts, ends], axis=1).reshape(-1, 3)
    cells = np.column_stack([np.full(len(errors), 2), np.arange(len(points)).reshape(-1, 2)]).ravel()
    lines = pv.PolyData(points, lines=cells).tube(radius=0.04, n_sides=6)
    return scene.mesh(lines, "path", colour=ERRING, title=f"axes of {len(errors)} drills that err")


def access_figure(plan: AccessPlan, count: int = 80) -> Figure:
    """The hole in the bone from outside, what it passes, and the facial recess as the drill sees it.

    Parameters
    ----------
    plan : AccessPlan
    count : int
        Erring axes to draw.
    """
    view = approach_view(-lateral_direction(plan.side), oblique=True)
    outside = Scene(view)
    _drill(outside, plan)
    bone = labels_of(plan.anatomy, "bone")
    outside.mask(plan.anatomy.mask(*bone), plan.anatomy.affine, bone[0], opacity=1.0)
    _structures(outside, plan, ("external_auditory_canal",))

    middle = plan.entry + 0.55 * (plan.target - plan.entry)
    inside = Scene(_across(plan).around(middle, 0.62 * plan.length_mm))
    _structures(inside, plan, _SOLID)
    _drill(inside, plan, 0.4)
    _erring(inside, plan, count)
    for name, opacity in _VEILED.items():
        _structures(inside, plan, (name,), opacity=opacity)

    recess = Scene(_along(plan).around(plan.target, 8.0))
    _structures(recess, plan, _SOLID[:5])
    _drill(recess, plan, 0.3)
    _erring(recess, plan, count)
    return panels(
        [outside, inside, recess],
        ["(a) from outside", "(b) across the drill", "(c) along the drill, from its entry"],
        columns=3,
        width=15.0,
        pixels=1500,
    )


def _along(plan: AccessPlan) -> View:
    return View(plan.direction, [0.0, 0.0, 1.0])


def _across(plan: AccessPlan) -> View:
    """From above: the drill lies level, anterior is up."""
    down = np.array([0.0, 0.0, -1.0])
    looking = down - (down @ plan.direction) * plan.direction
    return View(looking, [0.0, -1.0, 0.0]).turned(0.0, 25.0)
