"""What a planner can be told, with the printed values as defaults."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from study.errors import InputError

METHODS = ("exact", "published")


@dataclass(frozen=True)
class FitnessWeights:
    """Weights of the five terms of the fitness metric (2.4.1: F = (1) + (2) + 10 (3) + 5 (4) + (5))."""

    direction: float = 1.0
    coverage: float = 1.0
    boundary: float = 10.0
    top_half: float = 5.0
    upward: float = 1.0

    def as_array(self) -> np.ndarray:
        """(5,) floats in the text's order."""
        return np.array([self.direction, self.coverage, self.boundary, self.top_half, self.upward], float)


@dataclass(frozen=True)
class PlannerSettings:
    """Settings of `study.planners.plan_path`.

    Parameters
    ----------
    cutting_depth : float
        mm from the burr's centre to the side of the supervoxel (2.2.4: 1 mm). The supervoxel's size
        is the odd number of voxels nearest to twice this, per axis: 5 at 0.4 mm.
    weights : FitnessWeights
        Of the five printed terms.
    terms : tuple of study.planners.FitnessTerm, CuttingForce, IncidenceAngle
        Further terms of the fitness, added to the five; 3-D only. See `study.planners.fitness`.
    max_tilt_deg : float
        Largest angle between shaft and approach axis: to both sides for 4 DOF, the cone's half angle for
        5. Not printed; 45 degrees.
    min_window_deg : float
        4 DOF only. Smallest range of accessible angles of a voxel (2.3.3, not printed; 5 degrees).
    min_overlap_deg : float
        4 DOF only. Smallest overlap of a voxel's range with the current one (2.3.3, not printed; 2 degrees.
        10 degrees of overlap left 65 voxels behind on a real bone).
    row_pitch, layer_pitch : int
        Zigzag only: voxels between rows and between layers. Not printed, and decisive for the length.
        0 takes the supervoxel's reach and one more, the farthest the 3-D planner itself steps, so that
        both planners take the same depth of cut; rows up to the supervoxel's size apart leave no residue.
    method : {"exact", "published"}
        5 DOF only. ``"exact"`` searches all directions of the robot's cone: the shaft keeps its direction
        while that is free, else it turns, by a verified way, to the nearest direction that is; and it
        turns towards cutting with the burr's equator where that gains enough. ``"published"`` looks only
        at a window of 18 x 18 directions around the present one and asks that a share of them be free
        (2.3.3, 2.5.1); the one nearest to the middle of the free ones is taken, by a verified turn.
    max_rotation_deg : float
        5 DOF only. Largest turn of the shaft between consecutive points of the path.
    direction_step_deg : float
        5 DOF, exact: degrees between the directions by which the cone is searched.
    cut_turn_deg : float
        5 DOF, exact: how far the shaft may turn before a step only to cut better; 0 never does. On bones
        tried the mean sine of the incidence angle rose from 0.55-0.58 without to 0.60-0.62 with 20
        degrees, at the same path length.
    least_incidence_gain : float
        5 DOF, exact: what such a turn must add to the sine of the incidence angle (between shaft and the
        bone about to be cut: 1 cuts with the equator, 0 with the pole).
    window_half_deg, window_samples, free_share : float, int, float
        5 DOF, published: half width of the window (2.5 degrees), directions along each side (18), and
        the share that must be free (not printed; a tenth, 33 of 324: between 1 and 162 the path's length
        changed by less than 1 % in a prototype).
    rotation_axis : int
        Grid axis about which the 4-DOF robot tilts the drill; -1 chooses the one of the two axes
        across the approach that reaches more of the target (then the one with the wider windows).
    boundary_connectivity : {6, 26}
        Target boundary shares a face (2.2.5) or any vertex (Table 2.1) with the solid around it.
    finishing : bool
        Visit also what a larger burr left; see `study.planners.modified_volume`. `plan_passes` sets it.
    seed : int
        Breaks ties between equal Manhattan labels (2.2.6).

    Raises
    ------
    InputError
        If a value is outside its range.
    """

    cutting_depth: float = 1.0
    weights: FitnessWeights = field(default_factory=FitnessWeights)
    terms: tuple = ()
    max_tilt_deg: float = 45.0
    min_window_deg: float = 5.0
    min_overlap_deg: float = 2.0
    method: str = "exact"
    max_rotation_deg: float = 5.0
    direction_step_deg: float = 2.5
    cut_turn_deg: float = 20.0
    least_incidence_gain: float = 0.1
    window_half_deg: float = 2.5
    window_samples: int = 18
    free_share: float = 0.1
    row_pitch: int = 0
    layer_pitch: int = 0
    rotation_axis: int = -1
    boundary_connectivity: int = 6
    finishing: bool = False
    seed: int = 0

    def __post_init__(self) -> None:
        def require(condition: bool, name: str, expected: str) -> None:
            if not condition:
                raise InputError(f"{name}: expected {expected}, got {getattr(self, name)!r}")

        def whole(name: str) -> bool:
            value = getattr(self, name)
            return isinstance(value, int | np.integer) and not isinstance(value, bool)

        require(bool(np.isfinite(self.weights.as_array()).all()), "weights", "five finite numbers")
        for name in (
            "row_pitch", "layer_pitch", "rotation_axis", "boundary_connectivity", "seed", "window_samples",
        ):  # fmt: skip
            require(whole(name), name, "a whole number")
        require(np.isfinite(self.cutting_depth) and self.cutting_depth > 0, "cutting_depth", "mm above 0")
        require(0 < self.max_tilt_deg <= 80, "max_tilt_deg", "degrees above 0 and at most 80")
        require(
            0 <= self.min_window_deg <= 2 * self.max_tilt_deg, "min_window_deg", "0 to twice max_tilt_deg"
        )
        require(0 <= self.min_overlap_deg <= self.min_window_deg, "min_overlap_deg", "0 to min_window_deg")
        require(self.method in METHODS, "method", f"one of {METHODS}")
        require(0.5 <= self.max_rotation_deg <= 45, "max_rotation_deg", "degrees from 0.5 to 45")
        require(0.5 <= self.direction_step_deg <= 15, "direction_step_deg", "degrees from 0.5 to 15")
        require(0 <= self.cut_turn_deg <= 90, "cut_turn_deg", "degrees from 0 to 90")
        require(0 < self.least_incidence_gain <= 1, "least_incidence_gain", "above 0 and at most 1")
        require(0 < self.window_half_deg <= 15, "window_half_deg", "degrees above 0 and at most 15")
        require(2 <= self.window_samples <= 64, "window_samples", "2 to 64")
        require(0 < self.free_share <= 1, "free_share", "above 0 and at most 1")
        require(self.row_pitch >= 0, "row_pitch", "voxels, 0 for the supervoxel's reach and one more")
        require(self.layer_pitch >= 0, "layer_pitch", "voxels, 0 for the supervoxel's reach and one more")
        require(self.rotation_axis in (-1, 0, 1, 2), "rotation_axis", "0, 1, 2 or -1 to choose")
        require(self.boundary_connectivity in (6, 26), "boundary_connectivity", "6 or 26")
        require(self.seed >= 0, "seed", "an integer of at least 0")
