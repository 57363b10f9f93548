"""Errors of a drilled line: in the drill's own axes, in image axes, and as rigid transforms.

An error is an array (2, 3) in mm: by how much the axis misses its entry, then its target. A robot's errors
are known across and along the drill; anatomy lies in image axes; safety margins ask for transforms.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from study.errors import GeometryError, InputError
from study.guidance.frames import rigid
from study.registration.sources import checked_vector

#: mm: a shorter line has no direction worth the name.
_SHORTEST = 1.0


def checked_line(entry: ArrayLike, target: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    """Entry and target, (3,) mm each.

    Raises
    ------
    InputError
        If they are not of three finite numbers.
    GeometryError
        If they are nearer to each other than a millimetre.
    """
    entry, target = checked_vector("entry", entry, "mm"), checked_vector("target", target, "mm")
    length = float(np.linalg.norm(target - entry))
    if length < _SHORTEST:
        raise GeometryError(
            f"entry, target: expected points at least {_SHORTEST:g} mm apart, got {length:.3g} mm"
        )
    return entry, target


def checked_errors(errors: ArrayLike, name: str = "errors") -> np.ndarray:
    """(n, 2, 3) finite float array of at least one error.

    Raises
    ------
    InputError
        If it is not.
    """
    errors = np.ascontiguousarray(errors, dtype=float)
    if errors.ndim != 3 or errors.shape[1:] != (2, 3) or not len(errors):
        raise InputError(
            f"{name}: expected shape (n, 2, 3), mm at entry and target, n at least 1; got {errors.shape}"
        )
    if not np.isfinite(errors).all():
        raise InputError(f"{name}: expected finite numbers, got {int((~np.isfinite(errors)).sum())} others")
    return errors


def drill_axes(entry: ArrayLike, target: ArrayLike, roll: float = 0.0) -> np.ndarray:
    """(3, 3) unit vectors of a drill in image axes, one a column: across, across and upwards, along.

    z runs from the body to the tip, as in the frame of the tool centre point; y is the direction nearest to
    superior (nearest to anterior, for a drill that runs along the body's axis).

    Parameters
    ----------
    entry, target : (3,) arrays
        mm, LPS.
    roll : float
        rad, by which x and y are turned about z: how the robot's own axes lie about the drill.

    Raises
    ------
    InputError, GeometryError
        See `checked_line`.
    """
    entry, target = checked_line(entry, target)
    axes = axes_of_lines(target - entry)
    x, y, z = axes.T
    return np.column_stack([np.cos(roll) * x + np.sin(roll) * y, np.cos(roll) * y - np.sin(roll) * x, z])


def axes_of_lines(lines: np.ndarray) -> np.ndarray:
    """(..., 3, 3) axes as those of `drill_axes` of lines (..., 3) from entry to target."""
    z = lines / np.linalg.norm(lines, axis=-1, keepdims=True)
    up = np.where(np.abs(z[..., 2:]) < 0.99, [0.0, 0.0, 1.0], [0.0, -1.0, 0.0])
    y = up - (up * z).sum(axis=-1, keepdims=True) * z
    y /= np.linalg.norm(y, axis=-1, keepdims=True)
    return np.stack([np.cross(y, z), y, z], axis=-1)


def to_image_axes(errors: ArrayLike, entry: ArrayLike, target: ArrayLike, roll: float = 0.0) -> np.ndarray:
    """(n, 2, 3) errors in image axes of errors in the axes of the drill, see `drill_axes`."""
    return checked_errors(errors) @ drill_axes(entry, target, roll).T


def to_drill_axes(errors: ArrayLike, entry: ArrayLike, target: ArrayLike, roll: float = 0.0) -> np.ndarray:
    """(n, 2, 3) errors in the axes of the drill of errors in image axes; undoes `to_image_axes`."""
    return checked_errors(errors) @ drill_axes(entry, target, roll)


def transforms(errors: ArrayLike, entry: ArrayLike, target: ArrayLike) -> np.ndarray:
    """Rigid transforms that carry the planned line to the erring ones.

    The target goes to the erring target; about it the line turns the shortest way into its new direction.
    The entry lands on the erring axis, at its planned distance from the target: a rigid drill does not
    become longer. A turn about the drill's own axis is not known from the line, and is none.

    Parameters
    ----------
    errors : (n, 2, 3) array
        mm at entry and target, image axes.
    entry, target : (3,) arrays
        mm.

    Returns
    -------
    (n, 4, 4) array
        Where a point of the plan is drilled instead of itself: mm, image axes, as `study.margins` asks.

    Raises
    ------
    InputError, GeometryError
        If an array has another shape, or an error turns the line round.
    """
    entry, target = checked_line(entry, target)
    errors = checked_errors(errors)
    along = (target - entry) / np.linalg.norm(target - entry)
    erring = (target + errors[:, 1]) - (entry + errors[:, 0])
    lengths = np.linalg.norm(erring, axis=1)
    cosines = erring @ along / np.maximum(lengths, 1e-12)
    if (cosines <= 0).any():
        row = int(np.argmin(cosines))
        raise GeometryError(
            f"errors[{row}]: expected a line that still runs from entry to target, got {errors[row].tolist()}"
        )
    normals = np.cross(along, erring / lengths[:, None])
    sines = np.linalg.norm(normals, axis=1)
    angles = np.arctan2(sines, cosines)
    share = np.divide(angles, sines, out=np.ones_like(sines), where=sines > 1e-12)
    turns = Rotation.from_rotvec(share[:, None] * normals)
    return rigid(turns, target + errors[:, 1] - turns.apply(target))


@dataclass(frozen=True, eq=False)
class LineErrors:
    """Errors of a drilled line as an error source of `study.registration`: what `grow_margin` takes.

    Parameters
    ----------
    model : object with ``sample(n, rng)``
        Draws (n, 2, 3) mm in the axes of the drill, such as `NormalErrors`.
    entry, target : (3,) arrays
        mm, the planned line.
    roll : float
        rad, see `drill_axes`.
    """

    model: object
    entry: ArrayLike
    target: ArrayLike
    roll: float = 0.0

    def __post_init__(self) -> None:
        entry, target = checked_line(self.entry, self.target)
        object.__setattr__(self, "entry", entry)
        object.__setattr__(self, "target", target)

    def sample(self, n: int, rng: object = None) -> np.ndarray:
        """(n, 4, 4) transforms, see `transforms`."""
        drawn = self.model.sample(n, np.random.default_rng(rng))
        return transforms(to_image_axes(drawn, self.entry, self.target, self.roll), self.entry, self.target)
