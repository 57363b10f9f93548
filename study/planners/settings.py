"""What a planner can be told, with the printed values as defaults."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from study.errors import InputError


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
    terms : tuple of study.planners.FitnessTerm
        Further terms of the fitness, added to the five.
    max_tilt_deg : float
        Largest angle between shaft and approach axis for 4 DOF. Not printed; 45 degrees.
    min_window_deg : float
        Smallest range of accessible angles of a voxel (2.3.3, not printed; 5 degrees).
    min_overlap_deg : float
        Smallest overlap of a voxel's range with the current one (2.3.3, not printed; 2 degrees.
        10 degrees of overlap left 65 voxels behind on a real bone).
    row_pitch, layer_pitch : int
        Zigzag only: voxels between rows and between layers. Not printed, and decisive for the length.
        0 takes the supervoxel's reach and one more, the farthest the 3-D planner itself steps, so that
        both planners take the same depth of cut; rows up to the supervoxel's size apart leave no residue.
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
        for name in ("row_pitch", "layer_pitch", "rotation_axis", "boundary_connectivity", "seed"):
            require(whole(name), name, "a whole number")
        require(np.isfinite(self.cutting_depth) and self.cutting_depth > 0, "cutting_depth", "mm above 0")
        require(0 < self.max_tilt_deg <= 80, "max_tilt_deg", "degrees above 0 and at most 80")
        require(
            0 <= self.min_window_deg <= 2 * self.max_tilt_deg, "min_window_deg", "0 to twice max_tilt_deg"
        )
        require(0 <= self.min_overlap_deg <= self.min_window_deg, "min_overlap_deg", "0 to min_window_deg")
        require(self.row_pitch >= 0, "row_pitch", "voxels, 0 for the supervoxel's reach and one more")
        require(self.layer_pitch >= 0, "layer_pitch", "voxels, 0 for the supervoxel's reach and one more")
        require(self.rotation_axis in (-1, 0, 1, 2), "rotation_axis", "0, 1, 2 or -1 to choose")
        require(self.boundary_connectivity in (6, 26), "boundary_connectivity", "6 or 26")
        require(self.seed >= 0, "seed", "an integer of at least 0")
