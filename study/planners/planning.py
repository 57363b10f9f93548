"""From a segmented volume to a milling plan: `plan_path`."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from scipy import ndimage

from study.collision import CanonicalFrame, Drill, build_shaft, canonical_frame, find_approach
from study.collision.directions import build_free_space
from study.collision.frame import check_direction, check_orthogonal
from study.errors import IncompletePlanWarning, InputError, PlanningError, TargetUnreachableError
from study.planners.fitness import compile_terms, live_bone
from study.planners.modified import ModifiedVolume, modified_volume
from study.planners.motion._kernels import Search
from study.planners.plan import Plan
from study.planners.pointing import _kernels as pointing
from study.planners.settings import PlannerSettings
from study.planners.simulation import _kernels as simulation
from study.planners.simulation.state import _kernels as state
from study.planners.strategies import _kernels as strategies
from study.planners.tilting import _kernels as tilting
from study.volumes import LabelVolume, ball_element
from study.volumes.elements import element_rows

STRATEGIES = ("3d", "zigzag")
DEGREES_OF_FREEDOM = (4, 5)
GROUNDS = 1 << 22  # voxels remembered as barring others from every side; more would only save time


def supervoxel_reach(cutting_depth: float, spacing: np.ndarray) -> np.ndarray:
    """(3,) voxels from the supervoxel's centre to its side (2.2.4).

    The size is the odd number nearest to twice the cutting depth: 5 for 1 mm at 0.4 mm.
    """
    spacing = np.asarray(spacing, dtype=float)
    return np.maximum(np.floor(cutting_depth / spacing + 1e-9), 0).astype(np.int64)


def swept_moves(longest: int, steps: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What the burr newly overlaps on every straight move of up to `longest` voxels an axis.

    Returns
    -------
    first, count : (longest + 1,) * 4 int64 arrays
        Where the voxels of a part begin in `offsets`, and how many they are: ``[a, b, c, part]``.
    offsets : (n, 3) int16 array
        From the voxel where the move starts.
    """
    capacity = 1 << 17
    while True:
        offsets = np.empty((capacity, 3), np.int16)
        first, count, used = simulation.swept_parts(longest, steps, radius, offsets)
        if used <= capacity:
            return first, count, offsets[:used].copy()
        capacity = used


@lru_cache(maxsize=8)
def _burr_geometry(radius: float, steps: tuple[float, float, float], reach: tuple[int, int, int]):
    """Offsets of the element, rows of its outer half, voxels swept by straight moves."""
    steps_array = np.array(steps)
    element = ball_element(radius, steps_array)
    middle = np.array(element.shape) // 2
    offsets = (np.argwhere(element) - middle).astype(np.int64)
    rows = element_rows(element)
    top_rows = np.ascontiguousarray(rows[rows[:, 1] < 0])
    return offsets, top_rows, swept_moves(int(max(reach)) + 1, steps_array, radius)


def _box(mask: np.ndarray, grow: np.ndarray | int = 0) -> np.ndarray:
    """(2, 3) low and high corner of what is set, grown and clipped."""
    axes = [np.flatnonzero(mask.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    low = np.array([a[0] for a in axes]) - grow
    high = np.array([a[-1] + 1 for a in axes]) + grow
    return np.stack([np.maximum(low, 0), np.minimum(high, mask.shape)]).astype(np.int64)


class _Canonical:
    """The volume in one canonical frame, with its initial accessibility pass done."""

    def __init__(
        self,
        modified: ModifiedVolume,
        frame: CanonicalFrame,
        drill: Drill,
        settings: PlannerSettings,
        dof: int,
    ):
        volume = modified.volume
        self.frame, self.dof = frame, dof
        air, target = volume.mask("air"), volume.mask("target")
        self.solid = frame.canonical(np.where(air, 0, np.where(target, 2, 1)).astype(np.uint8))
        self.allowed = frame.canonical(modified.allowed)
        labels = modified.target.view(np.uint8) + modified.boundary.view(np.uint8)
        self.modified = frame.canonical(labels)
        # The burr lifts over bone between pits, but has no business beside the target.
        low, high = _box(self.modified, 1)
        self.allowed[: low[0]] = self.allowed[high[0] :] = False
        self.allowed[:, :, : low[2]] = self.allowed[:, :, high[2] :] = False
        max_tilt = np.deg2rad(settings.max_tilt_deg)
        self.min_window = np.deg2rad(settings.min_window_deg)
        protected = (self.solid == state.PROTECTED).astype(np.uint8)
        if dof == 5:
            spacing = np.deg2rad(settings.direction_step_deg)
            space = build_free_space(protected, frame.steps, drill, max_tilt, spacing)
            self.dropped = pointing.drop_inaccessible(space, self.modified)
            return
        self.shaft = build_shaft(protected, frame.steps, drill, max_tilt)
        # Half a window plus rounding, so that a window exactly as wide as the least one still counts.
        narrow = self.shaft._replace(max_tilt=min(max_tilt, self.min_window / 2 + 1e-12))
        self.dropped = tilting.drop_inaccessible(self.shaft, narrow, self.modified, self.min_window)

    def mean_window(self, sample: int = 400) -> float:
        """Mean width of the windows that protected bone leaves some of the targeted voxels, radians."""
        voxels = np.argwhere(self.modified)
        voxels = voxels[:: max(1, len(voxels) // sample)]
        return tilting.total_width(self.shaft, voxels) / max(1, len(voxels))


def _choose_frame(modified, approach, drill, settings, padding, dof) -> _Canonical:
    """The canonical volume about the asked rotation axis, or about the better of the two (4 DOF)."""
    along = np.abs(modified.volume.directions.T @ approach)
    across = [axis for axis in range(3) if axis != int(np.argmax(along))]
    asked = [settings.rotation_axis] if settings.rotation_axis >= 0 else across
    if dof == 5:
        asked = asked[:1]  # the cone looks the same from both
    max_tilt = np.deg2rad(settings.max_tilt_deg)
    options = [
        _Canonical(
            modified,
            canonical_frame(modified.volume, approach, axis, padding, drill, max_tilt, cone=dof == 5),
            drill,
            settings,
            dof,
        )
        for axis in asked
    ]
    if len(options) == 1:
        return options[0]
    if options[0].dropped != options[1].dropped:
        return min(options, key=lambda option: option.dropped)
    return options[int(np.argmax([option.mean_window() for option in options]))]


def _start_voxels(labels: np.ndarray, steps: np.ndarray) -> Iterator[np.ndarray]:
    """Targeted voxels, outermost first, then nearest to the middle of the target as seen from outside."""
    plane = labels.any(axis=1)
    middle = np.argwhere(plane).mean(axis=0)
    for depth in np.flatnonzero(labels.any(axis=(0, 2))):
        voxels = np.argwhere(labels[:, depth, :])
        aside = (((voxels - middle) * steps[[0, 2]]) ** 2).sum(axis=1)
        for layer, lateral in voxels[np.argsort(aside, kind="stable")]:
            yield np.array([layer, depth, lateral], dtype=np.int64)


def _connected(labels: np.ndarray, allowed: np.ndarray) -> Iterator[np.ndarray]:
    """Targeted voxels that hang together through allowed positions, the largest part first."""
    parts, n = ndimage.label(allowed)
    if n <= 1:
        yield labels != 0
        return
    counts = np.bincount(parts[labels != 0], minlength=n + 1)
    for part in np.argsort(-counts, kind="stable"):
        if counts[part]:
            yield (labels != 0) & (parts == part)


def _first_accessible(canonical: _Canonical, sim, settings: PlannerSettings) -> np.ndarray:
    """The start voxel: the outermost targeted voxel that the shaft reaches past unmilled bone.

    In the largest connected part of the target of which any can be reached.
    """
    if not canonical.modified.any():
        raise TargetUnreachableError(
            f"none of the {canonical.dropped} burr positions in the target can be reached by the shaft past "
            f"protected bone within {settings.max_tilt_deg:g} degrees of the approach"
        )
    for part in _connected(canonical.modified, canonical.allowed):
        for start in _start_voxels(part, canonical.frame.steps):
            if strategies.can_start(sim, *start):
                return start
    raise TargetUnreachableError(
        "no targeted voxel can be reached from outside past unmilled bone: expected a target open to the "
        "air, with room for the burr inside the image (LabelVolume.padded adds air)"
    )


def plan_path(
    volume: LabelVolume,
    strategy: str = "3d",
    dof: int = 4,
    drill: Drill | None = None,
    settings: PlannerSettings | None = None,
    approach: np.ndarray | None = None,
) -> Plan:
    """Plan the milling of a volume's target.

    Parameters
    ----------
    volume : LabelVolume
        With labels ``air`` and ``target``; everything else is protected.
    strategy : {"3d", "zigzag"}
        The 3-D planner of section 2.3, or the 2.5-D zigzag of section 2.4.1.
    dof : {4, 5}
        4: three translations and a tilt about one grid axis. 5: a tilt about either axis across the
        approach, within a cone; see `PlannerSettings.method`.
    drill : Drill, optional
        `Drill()` by default.
    settings : PlannerSettings, optional
    approach : (3,) array, optional
        Direction in mm from outside into the bone; found by `find_approach` when not given, and
        snapped to the nearest grid axis.

    Returns
    -------
    Plan
        Byte-identical for the same arguments, its planning time apart.

    Raises
    ------
    InputError, GeometryError, LabelError
        If an argument cannot be used.
    PlanningError, TargetUnreachableError
        If there is no target, the burr does not fit, or no start position can be reached.
    """
    if strategy not in STRATEGIES:
        raise InputError(f"strategy: expected one of {STRATEGIES}, got {strategy!r}")
    if dof not in DEGREES_OF_FREEDOM or isinstance(dof, bool):
        raise InputError(f"dof: expected one of {DEGREES_OF_FREEDOM}, got {dof!r}")
    drill = Drill() if drill is None else drill
    settings = PlannerSettings() if settings is None else settings
    clock = time.perf_counter()
    check_orthogonal(volume)
    modified = modified_volume(
        volume,
        drill.burr_radius,
        boundary_connectivity=settings.boundary_connectivity,
        finishing=settings.finishing,
    )
    approach = find_approach(volume) if approach is None else check_direction(approach)
    if settings.cutting_depth > drill.burr_radius:
        raise InputError(
            f"cutting_depth: expected at most the burr's radius of {drill.burr_radius:g} mm, "
            f"got {settings.cutting_depth:g} mm"
        )

    reach_burr = np.floor(drill.burr_radius / volume.spacing + 0.5).astype(int) + 1
    reach_super = supervoxel_reach(settings.cutting_depth, volume.spacing)
    padding = int(max(reach_burr.max(), 2 * reach_super.max() + 2))
    canonical = _choose_frame(modified, approach, drill, settings, padding, dof)
    frame = canonical.frame
    sim, accessible = _build(canonical, drill, settings)
    search = _search_arrays(sim.solid.size)

    start = _first_accessible(canonical, sim, settings)
    if strategy == "3d":
        terms = compile_terms(settings.terms, volume, frame)
        strategies.run_3d(sim, search, start, settings.weights.as_array(), terms, 0)
    else:
        targeted = canonical.modified.astype(np.bool_)
        extent = np.ptp(np.argwhere(targeted), axis=0) * frame.steps
        row_axis = 2 if extent[2] >= extent[0] else 0
        across = sim.reach[0] if row_axis == 2 else sim.reach[2]
        row_pitch = settings.row_pitch or int(across + 1)
        layer_pitch = settings.layer_pitch or int(sim.reach[1] + 1)
        strategies.run_zigzag(sim, search, start, targeted, row_axis, row_pitch, layer_pitch)
    if sim.counters[state.FULL]:
        raise PlanningError(
            f"the plan exceeds {len(sim.path)} positions for {np.count_nonzero(accessible)} targeted voxels"
        )
    elapsed = time.perf_counter() - clock

    rows = sim.path[: sim.counters[state.ROWS]]
    labels = volume.labels.copy()
    solid = frame.original(sim.solid)
    labels[volume.mask("target") & (solid == 0)] = volume.names["air"]
    plan = Plan(
        points=volume.points(frame.to_indices(rows[:, :3])),
        axes=frame.shaft_axes(rows[:, 3], volume.directions, rows[:, 4]),
        removed=rows[:, 5] * volume.voxel_volume,
        strategy=strategy,
        dof=dof,
        approach=frame.into_bone * volume.directions[:, frame.depth_axis],
        rotation_axis=frame.rotation_axis,
        drill=drill,
        settings=settings,
        modified=modified,
        remaining=volume.with_labels(labels),
        accessible=accessible,
        left=frame.original(sim.modified) != 0,
        planning_time_s=elapsed,
    )
    if plan.left_fraction > 0.001:
        warnings.warn(
            f"the plan leaves {100 * plan.left_fraction:.1f} % of the accessible modified target: no way "
            "leads there with windows and overlaps of the asked width",
            IncompletePlanWarning,
            stacklevel=2,
        )
    return plan


def _build(canonical: _Canonical, drill: Drill, settings: PlannerSettings):
    """The simulations at their start, and the mask of accessible targeted voxels in the volume's order."""
    frame = canonical.frame
    steps = frame.steps
    reach = supervoxel_reach(settings.cutting_depth, steps)
    element, top_rows, swept = _burr_geometry(
        float(drill.burr_radius), tuple(steps.tolist()), tuple(int(r) for r in reach)
    )
    shape = canonical.solid.shape
    labels = canonical.modified
    covers = np.zeros(shape, np.uint16)
    crowded = np.ones(shape, np.bool_)
    near = _box(labels, 2 * reach + 1) if labels.any() else np.zeros((2, 3), np.int64)
    simulation.count_covers(labels, canonical.allowed, reach, near, covers, crowded)
    top = np.zeros(shape, np.uint16)
    simulation.count_top(canonical.solid, top_rows, labels, top)
    n_targeted = int(np.count_nonzero(labels))
    random = np.random.default_rng(settings.seed).integers(0, 2**32, 1 << 16, dtype=np.uint32)
    shaft = _shaft(canonical, drill, settings)
    sim = state.Simulation(
        solid=canonical.solid,
        modified=labels.copy(),
        allowed=canonical.allowed,
        crowded=crowded,
        covers=covers,
        top=top,
        live=live_bone(settings.terms, canonical.solid, frame, drill.burr_radius),
        element=element,
        top_rows=top_rows,
        sweep_first=swept[0],
        sweep_count=swept[1],
        sweep_offsets=swept[2],
        reach=reach,
        steps=steps,
        shaft=shaft,
        min_window=canonical.min_window,
        min_overlap=float(np.deg2rad(settings.min_overlap_deg)),
        known=np.zeros((*shape, 3)),
        path=np.empty((40 * n_targeted + 20000, 6)),
        counters=np.array([0, n_targeted, 0, 0], dtype=np.int64),
        left_at_depth=np.count_nonzero(labels, axis=(0, 2)).astype(np.int64),
        random=random,
    )
    return sim, frame.original(labels) != 0


def _shaft(canonical: _Canonical, drill: Drill, settings: PlannerSettings):
    """What bars the shaft at the start: collapsed slabs for 4 degrees of freedom, free space for 5."""
    steps, max_tilt = canonical.frame.steps, np.deg2rad(settings.max_tilt_deg)
    if canonical.dof == 4:
        return build_shaft(canonical.solid, steps, drill, max_tilt)
    half = np.deg2rad(settings.window_half_deg)
    grounds = np.empty(GROUNDS, np.int32)
    grounds[0] = 1
    return pointing.Pointing(
        space=build_free_space(
            canonical.solid, steps, drill, max_tilt, np.deg2rad(settings.direction_step_deg)
        ),
        max_rotation=float(np.deg2rad(settings.max_rotation_deg)),
        published=settings.method == "published",
        offsets=np.linspace(-half, half, settings.window_samples),
        least_free=int(np.ceil(settings.free_share * settings.window_samples**2)),
        cut_turn=float(np.deg2rad(settings.cut_turn_deg)),
        least_gain=float(settings.least_incidence_gain),
        shut=np.zeros(canonical.solid.size, np.int32),
        grounds=grounds,
    )


def _search_arrays(size: int):
    """Scratch of `find_way`."""
    return Search(
        stamp=np.zeros(size, np.int32),
        came=np.empty(size, np.int8),
        low=np.empty(size),
        high=np.empty(size),
        queue=np.empty(size, np.int32),
        floods=np.zeros(1, np.int32),
    )
