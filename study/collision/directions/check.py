"""The 5-DOF collision check for anyone: positions and directions in, yes or no out."""

from __future__ import annotations

import numpy as np

from study.collision.directions.field import _kernels as field
from study.collision.directions.search import _kernels as search
from study.collision.directions.space import build_free_space
from study.collision.drill import Drill
from study.errors import InputError


class DirectionCheck:
    """Can the drill's shaft be where it would have to be? Exact, and valid while bone is removed.

    A pose is blocked when one of the shaft's three finite cylinders overlaps the cube of a solid voxel
    that the burr's ball does not overlap; touching is not overlapping.

    Parameters
    ----------
    solid : (nx, ny, nz) array
        Non-zero where there is unmilled bone, protected or targeted. Copied.
    spacing : (3,) array
        mm.
    drill : Drill, optional
    burr : bool
        False counts the voxels in the burr's ball too.

    Raises
    ------
    InputError
        If the arguments have other shapes or are not finite.
    """

    def __init__(self, solid: np.ndarray, spacing: np.ndarray, drill: Drill | None = None, burr: bool = True):
        solid = np.asarray(solid)
        spacing = np.asarray(spacing, dtype=float)
        if solid.ndim != 3 or 0 in solid.shape:
            raise InputError(f"solid: expected an array (nx, ny, nz), got shape {solid.shape}")
        if spacing.shape != (3,) or not np.isfinite(spacing).all() or (spacing <= 0).any():
            raise InputError(f"spacing: expected three positive mm, got {spacing}")
        self.spacing = spacing
        self.drill = Drill() if drill is None else drill
        self._solid = np.ascontiguousarray(solid != 0, dtype=np.uint8)
        self.space = build_free_space(self._solid, spacing, self.drill, np.pi / 4, sweep=0.0)
        if not burr:
            self.space = self.space._replace(burr_radius=0.0)

    def widened(self, by: float) -> DirectionCheck:
        """The same bone for a drill whose cylinders are `by` mm thicker, and longer at both ends."""
        other = object.__new__(DirectionCheck)
        other.__dict__.update(self.__dict__)
        other.space = self.space._replace(cylinders=np.add(self.space.cylinders, [by, -by, by]))
        return other

    def _position(self, position: np.ndarray) -> np.ndarray:
        position = np.asarray(position, dtype=float)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise InputError(f"position: expected (3,) finite mm, got {position}")
        return position / self.spacing

    @staticmethod
    def _axes(axes: np.ndarray) -> np.ndarray:
        axes = np.asarray(axes, dtype=float)
        if axes.ndim != 2 or axes.shape[1] != 3 or not np.isfinite(axes).all():
            raise InputError(f"axes: expected (n, 3) finite unit vectors, got shape {axes.shape}")
        lengths = np.linalg.norm(axes, axis=1)
        if np.abs(lengths - 1).max(initial=0.0) > 1e-6:
            raise InputError(
                f"axes: expected unit vectors, got lengths {lengths.min():g} to {lengths.max():g}"
            )
        return np.ascontiguousarray(axes / lengths[:, None])

    def is_free(self, position: np.ndarray, axis: np.ndarray) -> bool:
        """Whether the shaft is free.

        Parameters
        ----------
        position : (3,) array
            Burr centre in mm of the index frame (voxel centre = index x spacing).
        axis : (3,) array
            Unit vector from the burr's centre towards the drill body, along the index axes.
        """
        return bool(self.free(position, np.asarray(axis, dtype=float)[None])[0])

    def free(self, position: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """Which of many directions are free at one position: (n,) bool for (n, 3) unit vectors."""
        at, axes = self._position(position), self._axes(axes)
        out = np.empty(len(axes), np.bool_)
        search.directions_free(self.space, *at, axes, out)
        return out

    def window(self, position: np.ndarray, tilts: np.ndarray, tips: np.ndarray) -> np.ndarray:
        """Which directions of a square grid are free: (n, n) bool for n tilts and n tips in radians.

        A direction is (sin tip, -cos tip cos tilt, cos tip sin tilt) along the index axes. Tilts and
        tips must not decrease.
        """
        tilts = np.ascontiguousarray(tilts, dtype=float)
        tips = np.ascontiguousarray(tips, dtype=float)
        if tilts.ndim != 1 or tilts.shape != tips.shape or not tilts.size:
            raise InputError(f"window: expected as many tilts as tips, got {tilts.shape} and {tips.shape}")
        for name, angles in (("tilts", tilts), ("tips", tips)):
            # A tile of directions is looked at between its first and last.
            if not np.isfinite(angles).all() or (np.diff(angles) < 0).any():
                raise InputError(f"window: expected finite {name} that do not decrease, got {angles}")
        free = np.empty((tilts.size, tips.size), np.int8)
        search.window_of_directions(self.space, *self._position(position), tilts, tips, free)
        return free.astype(bool)

    def remove(self, voxels: np.ndarray) -> None:
        """Take (n, 3) voxels out of the bone."""
        voxels = np.asarray(voxels)
        if voxels.ndim != 2 or voxels.shape[1] != 3 or not np.issubdtype(voxels.dtype, np.integer):
            raise InputError(f"voxels: expected (n, 3) whole numbers, got {voxels.dtype} {voxels.shape}")
        if ((voxels < 0) | (voxels >= self._solid.shape)).any():
            raise InputError(f"voxels: expected indices inside {self._solid.shape}, got others")
        for i, j, k in voxels:
            if self._solid[i, j, k]:
                self._solid[i, j, k] = 0
                field.remove_voxel(self.space, i, j, k)

    def refresh(self) -> None:
        """Bring the distance field up to date. Changes no answer, only how fast it comes."""
        field.refresh(self.space, 4.0, 6.0)
