"""The planner's canonical frame: layers along the rotation axis, depth along the approach."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.collision.drill import Drill
from study.errors import GeometryError, InputError, TargetUnreachableError
from study.volumes import LabelVolume


@dataclass(frozen=True)
class CanonicalFrame:
    """How a volume's index axes become ``[layer, depth, lateral]``: cropped, flipped, padded by air.

    Parameters
    ----------
    shape : (3,) ints
        Of the volume.
    spacing : (3,) floats
        Of the volume, mm.
    depth_axis, rotation_axis : int
        Grid axis along which the drill enters, and about which a 4-DOF robot tilts it.
    into_bone : int
        +1 when the drill enters along growing indices of `depth_axis`, -1 otherwise.
    padding : int
        Voxels added on every side, so that loops need no bounds checks.
    low, high : (3,) ints
        The part of the volume that matters, in its own indices; see `working_box`.
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    depth_axis: int
    rotation_axis: int
    into_bone: int
    padding: int
    low: tuple[int, int, int]
    high: tuple[int, int, int]

    @property
    def axes(self) -> tuple[int, int, int]:
        """Grid axes that become layer, depth, lateral."""
        return (self.rotation_axis, self.depth_axis, 3 - self.rotation_axis - self.depth_axis)

    @property
    def steps(self) -> np.ndarray:
        """(3,) mm between layers, depths, laterals."""
        return np.array([self.spacing[axis] for axis in self.axes])

    @property
    def _box(self) -> tuple[slice, ...]:
        return tuple(slice(a, z) for a, z in zip(self.low, self.high, strict=True))

    def canonical(self, array: np.ndarray, fill: int = 0) -> np.ndarray:
        """A volume-shaped array in canonical order, padded with `fill`, contiguous."""
        out = np.transpose(array[self._box], self.axes)
        if self.into_bone < 0:
            out = out[:, ::-1]
        return np.ascontiguousarray(np.pad(out, self.padding, constant_values=fill))

    def original(self, array: np.ndarray) -> np.ndarray:
        """The inverse of `canonical`; zero outside the box."""
        p = self.padding
        part = array[p : array.shape[0] - p, p : array.shape[1] - p, p : array.shape[2] - p]
        if self.into_bone < 0:
            part = part[:, ::-1]
        out = np.zeros(self.shape, dtype=array.dtype)
        out[self._box] = np.transpose(part, np.argsort(self.axes))
        return out

    def to_indices(self, positions: np.ndarray) -> np.ndarray:
        """(n, 3) volume indices of (n, 3) canonical positions."""
        out = np.empty((len(positions), 3))
        out[:, self.axes] = np.asarray(positions, dtype=float) - self.padding
        out += np.array(self.low)
        if self.into_bone < 0:
            n = self.depth_axis
            out[:, n] = self.low[n] + self.high[n] - 1 - out[:, n]
        return out

    def from_indices(self, indices: np.ndarray) -> np.ndarray:
        """(n, 3) canonical positions of (n, 3) volume indices."""
        out = np.array(indices, dtype=float)
        if self.into_bone < 0:
            n = self.depth_axis
            out[:, n] = self.low[n] + self.high[n] - 1 - out[:, n]
        return (out - np.array(self.low))[:, self.axes] + self.padding

    def shaft_axes(
        self, tilts: np.ndarray, directions: np.ndarray, tips: np.ndarray | float = 0.0
    ) -> np.ndarray:
        """(n, 3) mm unit vectors from the burr towards the drill body.

        `tilts` (n,) radians turn about the layer axis, `tips` out of the plane across it.
        """
        tilts = np.asarray(tilts, dtype=float)
        tips = np.broadcast_to(np.asarray(tips, dtype=float), tilts.shape)
        outward = -self.into_bone * directions[:, self.depth_axis]
        layer, lateral = directions[:, self.axes[0]], directions[:, self.axes[2]]
        in_plane = np.cos(tilts)[:, None] * outward + np.sin(tilts)[:, None] * lateral
        return np.cos(tips)[:, None] * in_plane + np.sin(tips)[:, None] * layer


def check_direction(approach: np.ndarray) -> np.ndarray:
    """The approach as (3,) floats; `InputError` unless it is three finite numbers that are not all zero."""
    try:
        direction = np.asarray(approach, dtype=float)
    except (TypeError, ValueError):
        direction = np.full(1, np.nan)
    if direction.shape != (3,) or not np.isfinite(direction).all() or not direction.any():
        raise InputError(f"approach: expected a (3,) direction in mm, got {approach!r}")
    return direction


def check_orthogonal(volume: LabelVolume) -> None:
    """Raise `GeometryError` unless the index axes are at right angles (flips and rotations are fine)."""
    skew = volume.directions.T @ volume.directions - np.eye(3)
    if np.abs(skew).max() > 1e-3:
        raise GeometryError(
            "expected index axes at right angles to plan in, got directions "
            f"{np.round(volume.directions, 4).tolist()}; resample the segmentation onto an orthogonal grid"
        )


def find_approach(volume: LabelVolume) -> np.ndarray:
    """Direction from outside into the bone in which the target is seen best.

    Every line of voxels along a grid axis that meets target before any other solid voxel votes, by
    the area it stands for, for entering along it; the votes add up as vectors.

    Returns
    -------
    (3,) array
        Unit vector in mm, outside -> bone.

    Raises
    ------
    TargetUnreachableError
        If no target is seen along any grid axis, or the votes cancel.
    """
    air, target = volume.mask("air"), volume.mask("target")
    spacing = volume.spacing
    votes = np.zeros(3)
    for axis in range(3):
        extent = target.any(axis=axis)
        rows = np.moveaxis(~air, axis, -1)[extent]
        aims = np.moveaxis(target, axis, -1)[extent]
        area = float(np.prod(np.delete(spacing, axis)))
        for sign in (1, -1):
            first = rows[:, ::sign].argmax(axis=1)
            seen = aims[:, ::sign][np.arange(len(first)), first]
            # a line whose first voxel is already solid starts inside the bone, not outside
            votes[axis] += sign * area * np.count_nonzero(seen & (first > 0))
    direction = volume.directions @ votes
    length = np.linalg.norm(direction)
    if length < 1e-9 * max(1.0, float(np.abs(votes).max())) or not votes.any():
        raise TargetUnreachableError(
            "the target meets no outside air along any grid axis: expected a target open to the outside"
        )
    return direction / length


def working_box(
    target: np.ndarray,
    spacing: np.ndarray,
    axes: tuple[int, int, int],
    into_bone: int,
    drill: Drill,
    max_tilt: float,
    cone: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """The part of a volume that a burr in the target, or its shaft at any tilt allowed, can meet.

    With `cone` the shaft tilts about both axes across the approach, else about the layer axis only.

    Returns
    -------
    (3,), (3,) int arrays
        First index and one past the last, per grid axis.
    """
    shape = np.array(target.shape)
    low, high = np.empty(3, int), np.empty(3, int)
    for axis in range(3):
        filled = np.flatnonzero(target.any(axis=tuple({0, 1, 2} - {axis})))
        low[axis], high[axis] = filled[0], filled[-1] + 1
    layer, depth, lateral = axes
    burr = np.ceil(drill.burr_radius / spacing).astype(int) + 2
    low, high = low - 2 * burr, high + 2 * burr  # the burr in the air around the target, and its reach
    widest, length = max(radius for radius, _, _ in drill.cylinders), drill.cylinders[-1][2]
    outside = int(np.ceil((length + widest) / spacing[depth]))
    if into_bone > 0:
        low[depth] -= outside
    else:
        high[depth] += outside
    low, high = np.maximum(low, 0), np.minimum(high, shape)
    rise = min(length, (high[depth] - low[depth]) * spacing[depth])
    tilted = rise * np.tan(max_tilt) + widest / np.cos(max_tilt)
    sideways = np.array([tilted if cone else widest, tilted])
    for axis, reach in zip((layer, lateral), sideways, strict=True):
        voxels = int(np.ceil(reach / spacing[axis])) + 3
        low[axis], high[axis] = low[axis] - voxels, high[axis] + voxels
    return np.maximum(low, 0), np.minimum(high, shape)


def canonical_frame(
    volume: LabelVolume,
    approach: np.ndarray,
    rotation_axis: int,
    padding: int,
    drill: Drill | None = None,
    max_tilt: float = np.pi / 4,
    cone: bool = False,
) -> CanonicalFrame:
    """The frame for an approach direction in mm, snapped to the nearest grid axis.

    With a drill only what it can meet while milling the target is kept (`working_box`, which `cone` is
    for), else all.

    Raises
    ------
    InputError
        If `approach` is not three finite numbers or zero, or `rotation_axis` is the approach axis.
    """
    approach = check_direction(approach)
    along = volume.directions.T @ approach
    depth_axis = int(np.argmax(np.abs(along)))
    if rotation_axis == depth_axis:
        raise InputError(
            f"rotation_axis: expected a grid axis across the approach axis {depth_axis}, got {rotation_axis}"
        )
    into_bone = 1 if along[depth_axis] > 0 else -1
    low, high = np.zeros(3, int), np.array(volume.shape)
    if drill is not None:
        axes = (rotation_axis, depth_axis, 3 - rotation_axis - depth_axis)
        low, high = working_box(volume.mask("target"), volume.spacing, axes, into_bone, drill, max_tilt, cone)
    return CanonicalFrame(
        shape=tuple(int(n) for n in volume.shape),
        spacing=tuple(float(s) for s in volume.spacing),
        depth_axis=depth_axis,
        rotation_axis=int(rotation_axis),
        into_bone=into_bone,
        padding=int(padding),
        low=tuple(int(n) for n in low),
        high=tuple(int(n) for n in high),
    )
