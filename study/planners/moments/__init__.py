"""One moment of a 3-D plan: both simulations as they stood, and what there was to choose from.

A plan holds only its path. What the figures of chapter 2 show is the state in between (figures 2.7,
2.15, 2.17 and 2.18), which `moment` recovers by letting the planner decide again up to that row.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.collision import CanonicalFrame
from study.collision._kernels import Shaft, accessible_window
from study.errors import InputError
from study.planners.fitness import compile_terms
from study.planners.moments import _kernels
from study.planners.plan import Plan
from study.planners.planning import (
    _build,
    _choose_frame,
    _first_accessible,
    _search_arrays,
    supervoxel_reach,
)
from study.planners.simulation.state._kernels import Simulation
from study.planners.strategies import _kernels as strategies
from study.volumes import LabelVolume


@dataclass(frozen=True, eq=False)
class Moment:
    """State of both simulations after a decision of the 3-D planner.

    Attributes
    ----------
    row : int
        Last row of the plan that had been recorded.
    position : (3,) array
        Burr centre, mm.
    axis : (3,) array
        Unit vector from the burr towards the drill body.
    tilt : float
        Radians from the approach axis, about the rotation axis.
    window : (2,) tuple of float
        Accessible angles of the position, radians (alpha and beta of figure 2.15).
    unmodified : LabelVolume
        air, protected, target of the unmodified simulation; what is milled is ``air``.
    modified : LabelVolume
        air, protected, target, target_boundary and ``removed`` of the modified simulation.
    candidates : (n, 3) array
        mm, the accessible candidate positions of the next step.
    scores : (n,) array
        Their fitness, not normalised.
    inaccessible : (m, 3) array
        mm, candidates that the shaft does not reach.
    reach : (3,) array
        Voxels from the supervoxel's centre to its side, in the volume's axes.
    frame : CanonicalFrame
    shaft : Shaft
        Of the collapsed slabs at this moment.
    """

    row: int
    position: np.ndarray
    axis: np.ndarray
    tilt: float
    window: tuple[float, float]
    unmodified: LabelVolume
    modified: LabelVolume
    candidates: np.ndarray
    scores: np.ndarray
    inaccessible: np.ndarray
    reach: np.ndarray
    frame: CanonicalFrame
    shaft: Shaft

    @property
    def index(self) -> np.ndarray:
        """(3,) voxel of the volume at which the burr stands."""
        return np.rint(self.unmodified.indices(self.position[None])[0]).astype(int)


def decided(
    sim: Simulation, start: np.ndarray, weights: np.ndarray, terms: tuple, rows: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Let the 3-D planner decide until the path has `rows` rows.

    Parameters
    ----------
    sim : Simulation
        At its start; changed.
    start : (3,) int64 array
        Canonical voxel.
    weights : (5,) array
        ``FitnessWeights.as_array()``.
    terms : tuple
        Of `study.planners.fitness.compile_terms`.
    rows : int
        At least 1.

    Returns
    -------
    burr : (7,) array
        Canonical pose: layer, depth, lateral, tilt, tip, window.
    candidates : (n, 3) int64 array
        Canonical voxels to choose the next position from.
    scores : (n,) array
        Their fitness.
    """
    search = _search_arrays(sim.solid.size)
    burr, heading = strategies.run_3d(sim, search, start, weights, terms, rows)
    return burr, *_kernels.ranked(sim, burr, heading, weights, terms)


def moment(plan: Plan, row: int) -> Moment:
    """The state of a 3-D plan at the first decision that ends at `row` or later.

    Parameters
    ----------
    plan : Plan
        Made by `study.planners.plan_path` with the strategy ``"3d"`` and 4 degrees of freedom.
    row : int
        0 is the start; negative counts from the end. The way home is no decision: rows of it give the
        last one.

    Returns
    -------
    Moment

    Raises
    ------
    InputError
        If the plan is no 3-D plan with its volume, has not so many rows, or is not what its volume
        and settings give (a plan of other settings, or edited).
    """
    if plan.strategy != "3d" or plan.dof != 4 or plan.modified is None:
        raise InputError(
            "moment: expected a 3-D plan of 4 degrees of freedom with its volume, got strategy "
            f"{plan.strategy!r}, {plan.dof} degrees of freedom{'' if plan.modified else ', no volume'}"
        )
    n = len(plan.points)
    if not -n <= row < n:
        raise InputError(f"row: expected {-n} to {n - 1}, got {row}")
    row %= n
    volume, drill, settings = plan.volume, plan.drill, plan.settings
    reach_burr = np.floor(drill.burr_radius / volume.spacing + 0.5).astype(int) + 1
    reach = supervoxel_reach(settings.cutting_depth, volume.spacing)
    padding = int(max(reach_burr.max(), 2 * reach.max() + 2))
    canonical = _choose_frame(plan.modified, plan.approach, drill, settings, padding, plan.dof)
    frame = canonical.frame
    sim, _ = _build(canonical, drill, settings)
    before = sim.modified.copy()
    start = _first_accessible(canonical, sim, settings)
    terms = compile_terms(settings.terms, volume, frame)
    burr, candidates, scores = decided(sim, start, settings.weights.as_array(), terms, row + 1)
    rows = int(min(sim.counters[0], n))
    points = volume.points(frame.to_indices(sim.path[:rows, :3]))
    if not np.allclose(points, plan.points[:rows], atol=1e-6):
        raise InputError("moment: the plan is not what its volume and settings give; was it edited?")
    limit = (burr[5], burr[6], sim.min_window, sim.min_overlap)
    free = np.array([accessible_window(sim.shaft, *voxel, *limit)[0] for voxel in candidates], dtype=bool)
    where = volume.points(frame.to_indices(candidates)) if len(candidates) else np.empty((0, 3))
    return Moment(
        row=rows - 1,
        position=points[-1],
        axis=frame.shaft_axes(burr[3:4], volume.directions)[0],
        tilt=float(burr[3]),
        window=(float(burr[5]), float(burr[6])),
        unmodified=_unmodified(volume, frame.original(sim.solid)),
        modified=_modified(plan, frame.original(before), frame.original(sim.modified)),
        candidates=where[free],
        scores=scores[free],
        inaccessible=where[~free],
        reach=reach,
        frame=frame,
        shaft=sim.shaft,
    )


def telling_row(plan: Plan) -> int:
    """The row at which the shaft tilts most, the deepest one of them: where the window is narrow.

    Parameters
    ----------
    plan : Plan
    """
    tilt = np.round(-(plan.axes @ plan.approach), 3)
    depth = plan.points @ plan.approach
    return int(np.lexsort((-depth, tilt))[0])


def rows_on_one_plane(plan: Plan, n: int = 3) -> list[int]:
    """Rows at which the burr stands in the plane across the rotation axis that cuts most modified target.

    Two that follow each other, then later ones spread evenly over its visits.

    Parameters
    ----------
    plan : Plan
        With its volume.
    n : int
        How many; at most as many as there are.
    """
    axis = plan.rotation_axis
    layers = plan.volume.indices(plan.points)[:, axis]
    area = np.count_nonzero(plan.modified.target, axis=tuple({0, 1, 2} - {axis}))
    visits = np.flatnonzero((np.abs(layers - np.argmax(area)) < 1e-6) & (plan.removed > 0))
    if len(visits) <= n:
        return visits.tolist()
    first = len(visits) // 8
    later = np.linspace(first + 1, len(visits) - 1, n).round().astype(int)[:-1]
    return [int(visits[first]), *(int(row) for row in visits[later])]


def _unmodified(volume: LabelVolume, solid: np.ndarray) -> LabelVolume:
    out = np.where(volume.mask("air"), 0, 1).astype(np.uint8)
    out[volume.mask("target")] = np.where(solid[volume.mask("target")], 2, 0)
    return volume.with_labels(out, {"air": 0, "protected": 1, "target": 2})


def _modified(plan: Plan, before: np.ndarray, now: np.ndarray) -> LabelVolume:
    labels = plan.modified.as_label_volume()
    out = np.where(labels.mask("air"), 0, 1).astype(np.uint8)
    out[now == 1], out[now == 2] = 2, 3
    out[(before != 0) & (now == 0)] = 4
    names = {"air": 0, "protected": 1, "target": 2, "target_boundary": 3, "removed": 4}
    return labels.with_labels(out, names)
