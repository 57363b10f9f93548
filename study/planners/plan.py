"""The result of planning: where the burr goes, how the shaft points, what is removed."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from study.collision import Drill
from study.errors import FileFormatError, InputError, PlanningError
from study.files import written_whole
from study.planners.modified import ModifiedVolume
from study.planners.settings import PlannerSettings
from study.volumes import LabelVolume

CSV_COLUMNS = ("x_mm", "y_mm", "z_mm", "ax", "ay", "az", "removed_mm3")


@dataclass(frozen=True, eq=False)
class Plan:
    """A milling path with the volumes it was made from.

    Attributes
    ----------
    points : (n, 3) array
        Burr centre, mm, in the volume's frame. Consecutive points are at most one voxel step apart.
    axes : (n, 3) array
        Unit vectors from the burr's centre along the shaft towards the drill body. A row that repeats
        the point before it with another axis is a rotation in place.
    removed : (n,) array
        mm^3 of bone removed on arriving at each point.
    strategy, dof
        What made it.
    approach : (3,) array
        Unit vector in mm, outside -> bone, the grid axis that was used.
    rotation_axis : int
        Grid axis about which the drill tilts (4 DOF); -1 for a plan read from a file without its volume.
    drill : Drill
    settings : PlannerSettings
    modified : ModifiedVolume or None
        None for a plan read from a file without its volume, as are the next three.
    remaining : LabelVolume or None
        The volume after milling: milled target is air.
    accessible : bool array or None
        Targeted voxels of the modified volume that protected bone alone does not wall off (2.3.1).
    left : bool array or None
        Accessible targeted voxels that were not cleared.
    planning_time_s : float
        From volume to path.
    unmodified : LabelVolume or None
        The volume of a plan read from a file, when no modified volume can be made of it.
    """

    points: np.ndarray
    axes: np.ndarray
    removed: np.ndarray
    strategy: str = ""
    dof: int = 4
    approach: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    rotation_axis: int = -1
    drill: Drill = field(default_factory=Drill)
    settings: PlannerSettings = field(default_factory=PlannerSettings)
    modified: ModifiedVolume | None = None
    remaining: LabelVolume | None = None
    accessible: np.ndarray | None = None
    left: np.ndarray | None = None
    planning_time_s: float = float("nan")
    unmodified: LabelVolume | None = None

    def __post_init__(self) -> None:
        points, axes = np.asarray(self.points, float), np.asarray(self.axes, float)
        removed = np.asarray(self.removed, float)
        if points.ndim != 2 or points.shape[1] != 3 or axes.shape != points.shape:
            raise InputError(f"Plan: expected points and axes (n, 3), got {points.shape} and {axes.shape}")
        if removed.shape != (len(points),):
            raise InputError(f"Plan: expected removed ({len(points)},), got {removed.shape}")
        for name, value in (("points", points), ("axes", axes), ("removed", removed)):
            if not np.isfinite(value).all():
                raise InputError(f"Plan: {name} holds values that are not finite")
            value = value.view()
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def volume(self) -> LabelVolume:
        """The unmodified volume the plan was made for.

        Raises
        ------
        InputError
            If the plan was read from a file without it.
        """
        if self.modified is None and self.unmodified is not None:
            return self.unmodified
        if self.modified is None:
            raise InputError("this plan was read without its volume: pass volume= to Plan.read_csv")
        return self.modified.volume

    @property
    def step_lengths(self) -> np.ndarray:
        """(n - 1,) mm from each point to the next."""
        return np.linalg.norm(np.diff(self.points, axis=0), axis=1)

    @property
    def length_mm(self) -> float:
        """Length of the burr centre's path."""
        return float(self.step_lengths.sum())

    @property
    def left_fraction(self) -> float:
        """Share of the accessible modified target that was not cleared (modified final / initial)."""
        if self.left is None or self.accessible is None:
            raise InputError("this plan was read from a file: what it left is known only to the replay")
        return float(np.count_nonzero(self.left) / np.count_nonzero(self.accessible))

    def summary(self) -> pd.Series:
        """The planner's columns of Tables A.1-A.4, lengths truly in mm.

        A step is a move between consecutive points (rotations in place are none); it is in contact
        when it removes bone. What the robot adds (milling length, time, speed) comes from
        `study.robots.predict_milling`.
        """
        volume = self.volume
        moves = self.step_lengths > 0
        removed = self.removed[1:][moves]
        contact = removed > 0
        targeted = int(np.count_nonzero(self.accessible))
        voxel = volume.voxel_volume
        target_cm3 = targeted * voxel / 1000
        return pd.Series(
            {
                "predicted_path_length_mm": self.length_mm,
                "modified_final_over_initial_ratio": self.left_fraction,
                "unmodified_final_over_initial_ratio": (
                    self.remaining.volume_mm3("target") / volume.volume_mm3("target")
                ),
                "modified_initial_target_cm3": target_cm3,
                "simulation_time_s": self.planning_time_s,
                "steps_in_contact_over_path_length_ratio": contact.mean() if contact.size else 0.0,
                "average_voxels_per_step_in_contact_voxels": (
                    removed[contact].mean() / voxel if contact.any() else 0.0
                ),
                "path_length_over_volume_mm_per_cm3": self.length_mm / target_cm3,
            },
            name=self.strategy,
        )

    def to_frame(self) -> pd.DataFrame:
        """The path as a table: x_mm, y_mm, z_mm, ax, ay, az, removed_mm3."""
        return pd.DataFrame(np.column_stack([self.points, self.axes, self.removed]), columns=CSV_COLUMNS)

    def to_csv(self, path: str | Path) -> None:
        """Write the path as CSV; numbers keep every digit, so that reading gives the same bytes."""
        with written_whole(path) as temporary:
            self.to_frame().to_csv(temporary, index=False)

    @classmethod
    def read_csv(cls, path: str | Path, volume: LabelVolume | None = None, **known) -> Plan:
        """Read a path written by `to_csv`.

        Parameters
        ----------
        path : path-like
        volume : LabelVolume, optional
            The volume it was planned on; with it the plan can be verified.
        **known
            Further fields of `Plan` (drill, strategy, approach, ...).

        Raises
        ------
        FileFormatError
            If the file is not such a table.
        """
        from study.planners.modified import modified_volume

        try:
            table = pd.read_csv(path)
        except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
            raise FileFormatError(f"{path}: expected a plan as CSV, got {error}") from error
        missing = [column for column in CSV_COLUMNS if column not in table.columns]
        if missing:
            raise FileFormatError(
                f"{path}: expected columns {', '.join(CSV_COLUMNS)}; missing {', '.join(missing)}"
            )
        values = table[list(CSV_COLUMNS)].to_numpy(dtype=float)
        if volume is not None:
            drill, settings = known.get("drill", Drill()), known.get("settings", PlannerSettings())
            known["unmodified"] = volume
            try:
                modified = modified_volume(
                    volume,
                    drill.burr_radius,
                    boundary_connectivity=settings.boundary_connectivity,
                    finishing=settings.finishing,
                )
            except PlanningError:  # a later pass on little bone: can be verified all the same
                modified = None
            known.setdefault("modified", modified)
        return cls(values[:, :3], values[:, 3:6], values[:, 6], **known)

    def to_markups(self, path: str | Path, name: str = "milling path") -> None:
        """Write the path as a 3D Slicer markups curve (JSON, LPS)."""
        from study.planners.export import write_markups

        write_markups(self, path, name)

    def to_polyline(self, path: str | Path) -> None:
        """Write the path as a VTK polyline with axes and removed volume as point data (.vtp)."""
        from study.planners.export import write_polyline

        write_polyline(self, path)

    def verify(self) -> pd.Series:
        """Replay the plan independently of the planner; see `study.planners.verify.verify_plan`.

        Raises
        ------
        PlanViolation
            If the burr cuts protected bone, the shaft meets unmilled bone, or the removed volume differs.
        """
        from study.planners.verify import verify_plan

        return verify_plan(self)
