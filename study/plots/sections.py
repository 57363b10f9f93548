"""Plane sections of a volume as the chapter draws them: outside on top, the drill coming from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import InputError
from study.volumes import LabelVolume


@dataclass(frozen=True)
class Section:
    """One grid plane that holds the approach axis; rows go from outside into the bone.

    Attributes
    ----------
    normal, index : int
        Grid axis the plane is perpendicular to, and which plane.
    depth : int
        Grid axis of the rows.
    into_bone : int
        +1 if the drill enters along growing indices.
    box : (2, 2) ints
        First and last + 1 row and column shown, counted in the turned plane.
    shape : (2,) ints
        Of the whole turned plane.
    spacing : (2,) mm
        Between rows and between columns.
    """

    normal: int
    index: int
    depth: int
    into_bone: int
    box: tuple[tuple[int, int], tuple[int, int]]
    shape: tuple[int, int]
    spacing: tuple[float, float]

    @property
    def lateral(self) -> int:
        """Grid axis of the columns."""
        return 3 - self.normal - self.depth

    def whole(self, array: np.ndarray) -> np.ndarray:
        """The turned plane of a volume-shaped array."""
        plane = np.take(array, self.index, axis=self.normal)
        if self.depth > self.lateral:
            plane = plane.T
        return plane[::-1] if self.into_bone < 0 else plane

    def of(self, array: np.ndarray) -> np.ndarray:
        """What is shown of a volume-shaped array."""
        (top, bottom), (left, right) = self.box
        return self.whole(array)[top:bottom, left:right]

    def place(self, index: np.ndarray) -> np.ndarray:
        """(..., 2) right and down, mm, from the first voxel shown, of (..., 3) fractional voxel indices."""
        index = np.asarray(index, float)
        row = index[..., self.depth]
        if self.into_bone < 0:
            row = self.shape[0] - 1 - row
        row, column = row - self.box[0][0], index[..., self.lateral] - self.box[1][0]
        return np.stack([column * self.spacing[1], row * self.spacing[0]], axis=-1)


def section(
    volume: LabelVolume,
    approach: np.ndarray,
    *,
    normal: int = -1,
    index: int = -1,
    around: np.ndarray | None = None,
    margin_mm: float = 4.0,
) -> Section:
    """A section along the approach through a mask.

    Parameters
    ----------
    volume : LabelVolume
    approach : (3,) array
        Outside -> bone, mm frame; snapped to the nearest grid axis.
    normal : int
        Grid axis the plane is perpendicular to; -1 takes the one nearer to superior-inferior.
    index : int
        Which plane; -1 takes the one that cuts most of `around`.
    around : bool array, optional
        What has to be in the picture; the target by default.
    margin_mm : float
        Shown around it.

    Raises
    ------
    InputError
        If `normal` is the approach axis, or the plane does not cut `around`.
    """
    along = volume.directions.T @ np.asarray(approach, float)
    depth = int(np.argmax(np.abs(along)))
    if normal < 0:
        upright = np.abs(volume.directions[2])
        upright[depth] = -1
        normal = int(np.argmax(upright))
    if normal == depth:
        raise InputError(f"normal: expected a grid axis across the approach axis {depth}, got {normal}")
    around = volume.mask("target") if around is None else around
    if index < 0:
        index = int(np.argmax(np.count_nonzero(around, axis=tuple({0, 1, 2} - {normal}))))
    lateral = 3 - normal - depth
    shape = (volume.shape[depth], volume.shape[lateral])
    steps = (float(volume.spacing[depth]), float(volume.spacing[lateral]))
    into = 1 if along[depth] > 0 else -1
    everything = ((0, shape[0]), (0, shape[1]))
    plane = Section(normal, index, depth, into, everything, shape, steps)
    cut = plane.whole(around)
    if not cut.any():
        raise InputError(f"index: plane {index} of grid axis {normal} does not cut what is to be shown")
    box = []
    for axis in (0, 1):
        found = np.flatnonzero(cut.any(axis=1 - axis))
        margin = int(np.ceil(margin_mm / steps[axis]))
        box.append((max(0, int(found[0]) - margin), min(shape[axis], int(found[-1]) + 1 + margin)))
    return Section(normal, index, depth, into, (box[0], box[1]), shape, steps)
