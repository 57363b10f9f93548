"""Volumes as the surgeon sees them: first axis from lateral to medial, then backwards, then upwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import GeometryError, InputError
from study.specimens.structures import structure_mask
from study.volumes import LabelVolume

SIDES = ("right", "left")


def check_side(side: str) -> str:
    """Return `side` if it is one.

    Raises
    ------
    InputError
        Otherwise.
    """
    if side not in SIDES:
        raise InputError(f"side: expected 'right' or 'left', got {side!r}")
    return side


def lateral_direction(side: str) -> np.ndarray:
    """(3,) unit vector out of the ear in LPS: -x on the right, +x on the left."""
    return np.array([-1.0 if check_side(side) == "right" else 1.0, 0.0, 0.0])


def side_of(anatomy: LabelVolume) -> str:
    """Whether a segmented temporal bone is a right or a left one.

    The external auditory canal lies lateral of the labyrinth.

    Raises
    ------
    LabelError
        If either is missing.
    """
    centres = [
        anatomy.points(np.argwhere(structure_mask(anatomy, name)).mean(axis=0)[None])[0, 0]
        for name in ("external_auditory_canal", "labyrinth")
    ]
    return "right" if centres[0] < centres[1] else "left"


@dataclass(frozen=True)
class SurgicalView:
    """How to turn arrays of a volume to (medial, posterior, superior) order and back, without copying.

    Attributes
    ----------
    order : (3,) tuple of int
        Grid axis that runs along lateral-medial, anterior-posterior, inferior-superior.
    flips : (3,) tuple of bool
        Whether that grid axis runs the other way.
    spacing : (3,) array
        mm along the turned axes.
    """

    order: tuple[int, int, int]
    flips: tuple[bool, bool, bool]
    spacing: np.ndarray

    def turned(self, array: np.ndarray) -> np.ndarray:
        """`array` with its axes from lateral to medial, anterior to posterior, inferior to superior."""
        view = np.transpose(array, self.order)
        return view[tuple(slice(None, None, -1 if flip else 1) for flip in self.flips)]

    def back(self, array: np.ndarray) -> np.ndarray:
        """Undo `turned`."""
        view = array[tuple(slice(None, None, -1 if flip else 1) for flip in self.flips)]
        return np.transpose(view, np.argsort(self.order))


def surgical_view(volume: LabelVolume, side: str) -> SurgicalView:
    """The turn that puts a volume's axes in surgical order.

    Parameters
    ----------
    volume : LabelVolume
        Its grid axes within 15 degrees of the LPS axes, in any order and sense.
    side : {"right", "left"}

    Raises
    ------
    GeometryError
        If the grid is oblique; `study.volumes.resampled` or the scanner's own axes help.
    """
    wanted = np.array([-lateral_direction(side), [0, 1, 0], [0, 0, 1]])
    cosines = wanted @ volume.directions
    order = np.argmax(np.abs(cosines), axis=1)
    along = cosines[np.arange(3), order]
    if sorted(order) != [0, 1, 2] or (np.abs(along) < np.cos(np.deg2rad(15))).any():
        raise GeometryError(
            "expected grid axes within 15 degrees of left, posterior and superior, got directions "
            f"{np.round(volume.directions, 3).tolist()}"
        )
    return SurgicalView(
        tuple(int(axis) for axis in order), tuple(bool(a < 0) for a in along), volume.spacing[order]
    )
