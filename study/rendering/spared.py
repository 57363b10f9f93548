"""What margins spare of a target, in three dimensions."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.figure import Figure

from study.cases import Case
from study.experiments.margin_plans import MarginedPlan
from study.rendering.panels import panels
from study.rendering.scene import Scene
from study.rendering.views import View, approach_view

#: Bone that a margin keeps from the burr.
COLOUR = "#b5179e"


def _around(case: Case, entry: MarginedPlan, view: View) -> Scene:
    scene = Scene(view)
    for margin in entry.margins:
        mask = case.structure(margin.structure)
        scene.mask(mask, case.anatomy.affine, margin.structure)
    return scene


def target_and_spared(case: Case, entries: Sequence[MarginedPlan]) -> Figure:
    """The target as drawn between its structures, then what is left of it and what the margins spare.

    Parameters
    ----------
    case : Case
        With anatomy and approach.
    entries : sequence of MarginedPlan
        Of the same target, each with margins.
    """
    view = approach_view(case.approach, oblique=True)
    first = _around(case, entries[0], view)
    first.label(entries[0].drawn, "target", opacity=0.45)
    scenes, titles = [first], [f"target as drawn, {entries[0].drawn.volume_mm3('target') / 1000:.2f} cm³"]
    for entry in entries:
        scene = _around(case, entry, view)
        spared = entry.spared
        scene.mask(
            spared, entry.drawn.affine, "target", exact=True, opacity=1.0, colour=COLOUR,
            title="target spared by a margin",
        )  # fmt: skip
        scene.label(entry.planning, "target", opacity=0.25)
        volume = spared.sum() * entry.drawn.voxel_volume
        scenes.append(scene)
        titles.append(f"{entry.name}, {volume:.0f} mm³ spared")
    # one scale for all, set by the target and what is near it
    placed = Scene(view).label(entries[0].drawn, "target").placed_view(4 / 3)
    for scene in scenes:
        scene.view = view.around(placed.centre, 1.25 * placed.half_height)
    return panels(scenes, titles, columns=len(scenes))
