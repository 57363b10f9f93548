"""Straight lines that could lead to a target: where they leave the bone, what they pass, how near.

Directions are looked at in a cone about straight lateral. Each is followed from the target outwards to the
last voxel of bone: there the drill enters. A line is a candidate when it passes through the facial recess,
the gap between the facial nerve behind and the chorda tympani in front (2.1). Without that condition the
widest way leads from below, past both nerves, through the neck.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from study.errors import LabelError
from study.guidance.access import _kernels
from study.guidance.access.axes import axes_of_lines
from study.guidance.access.collision import normal_probabilities
from study.guidance.access.settings import AccessSettings
from study.guidance.access.structures import Surroundings
from study.specimens.orientation import lateral_direction
from study.specimens.structures import labels_of
from study.threads import in_threads
from study.volumes import LabelVolume

#: What the facial recess lies behind: the chorda, or, where none is labelled, the ear canal.
IN_FRONT = ("chorda_tympani", "external_auditory_canal")


def directions_of(posterior: np.ndarray, superior: np.ndarray, side: str) -> np.ndarray:
    """(n, 3) unit vectors out of the head, turned backwards and upwards from straight lateral; rad."""
    body = np.array([lateral_direction(side), [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    steps = [np.cos(posterior) * np.cos(superior), np.sin(posterior) * np.cos(superior), np.sin(superior)]
    return np.stack(steps, axis=-1) @ body


def fan(settings: AccessSettings) -> np.ndarray:
    """(n, 2) degrees backwards and upwards of all directions of the cone."""
    reach = np.floor(settings.fan_deg / settings.step_deg)
    steps = settings.step_deg * np.arange(-reach, reach + 1)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    cosines = np.cos(np.deg2rad(grid)).prod(axis=1)
    return grid[cosines >= np.cos(np.deg2rad(settings.fan_deg)) - 1e-12]


def finer(around: np.ndarray, settings: AccessSettings) -> np.ndarray:
    """(n, 2) degrees of directions between those of `fan` around some, each once."""
    count = int(np.ceil(settings.step_deg / settings.fine_step_deg))
    steps = np.linspace(-settings.step_deg, settings.step_deg, 2 * count + 1)
    square = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    return np.unique((around[:, None] + square[None]).reshape(-1, 2).round(9), axis=0)


def entries(
    anatomy: LabelVolume, target: np.ndarray, directions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where lines from a target leave the bone.

    Parameters
    ----------
    anatomy : LabelVolume
        With a label for bone.
    target : (3,) array
        mm.
    directions : (n, 3) array
        Unit vectors.

    Returns
    -------
    points : (n, 3) array
        mm, the outermost sample of the line that lies in bone; nan where there is none.
    cut_off : (n,) bool array
        Whether the line leaves the image there, still in bone: the true surface lies farther out.

    Raises
    ------
    LabelError
        If no label stands for bone.
    """
    names = labels_of(anatomy, "bone")
    if not names:
        raise LabelError(
            f"expected a label for 'bone' to find where a drill enters, got {sorted(anatomy.names)}"
        )
    step = float(anatomy.spacing.min()) / 2
    longest = float(np.linalg.norm(anatomy.spacing * anatomy.shape))
    along = np.arange(0.0, longest, step)
    start, turned = anatomy.indices(target[None])[0], directions @ np.linalg.inv(anatomy.affine[:3, :3]).T
    places = np.rint(start + along[:, None, None] * turned).astype(int)
    inside = ((places >= 0) & (places < anatomy.shape)).all(axis=-1)
    places = np.where(inside[..., None], places, 0)
    bone = anatomy.mask(*names)[places[..., 0], places[..., 1], places[..., 2]] & inside
    last = len(along) - 1 - np.argmax(bone[::-1], axis=0)
    end_of_image = len(along) - 1 - np.argmax(inside[::-1], axis=0)
    points = target + along[last][:, None] * directions
    points[~bone.any(axis=0)] = np.nan
    return points, last >= end_of_image - 1


def nearest_on_lines(
    points: np.ndarray, starts: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance (n,) mm, share of the way (n,) and index (n,) of the point nearest to each of n segments.

    Parameters
    ----------
    points : (m, 3) array
        mm.
    starts : (n, 3) array
        mm; all segments have one `end`.
    end : (3,) array
    """
    count = len(starts)
    distances, shares, indices = np.empty(count), np.empty(count), np.empty(count, np.int64)
    points, starts = np.ascontiguousarray(points), np.ascontiguousarray(starts)
    ends = np.ascontiguousarray(np.broadcast_to(end, starts.shape))

    def part(piece: slice) -> None:
        _kernels.nearest_points(
            points, starts[piece], ends[piece], distances[piece], shares[piece], indices[piece]
        )

    in_threads(part, count, least=20)
    return distances, shares, indices


@dataclass(frozen=True, eq=False)
class Lines:
    """Lines to a target through the facial recess.

    Attributes
    ----------
    names : tuple of str
        Structures.
    angles : (n, 2) array
        Degrees backwards and upwards from straight lateral.
    entries : (n, 3) array
        mm.
    cut_off : (n,) bool array
        Whether the image ends where the drill enters.
    clearances : (n, s) array
        mm between the planned drill's surface and each structure.
    recess_width : (n,) array
        mm between facial nerve and chorda, or ear canal, as the drill sees them.
    damage : (n,) array
        Expected damage by normal theory: sum of probability over accepted probability.
    """

    names: tuple[str, ...]
    angles: np.ndarray
    entries: np.ndarray
    cut_off: np.ndarray
    clearances: np.ndarray
    recess_width: np.ndarray
    damage: np.ndarray

    def __len__(self) -> int:
        return len(self.angles)

    def joined(self, other: Lines) -> Lines:
        """Both, the same direction once."""
        both = [np.concatenate([getattr(self, name), getattr(other, name)]) for name in _ARRAYS]
        _, kept = np.unique(both[0].round(6), axis=0, return_index=True)
        return Lines(self.names, *(array[np.sort(kept)] for array in both))

    def table(self) -> pd.DataFrame:
        """One row a line."""
        return pd.DataFrame(
            {
                "posterior_deg": self.angles[:, 0],
                "superior_deg": self.angles[:, 1],
                **{f"entry_{axis}_mm": self.entries[:, n] for n, axis in enumerate("xyz")},
                "leaves_the_image": self.cut_off,
                "recess_width_mm": self.recess_width,
                **{f"{name}_mm": self.clearances[:, n] for n, name in enumerate(self.names)},
                "expected_damage": self.damage,
            }
        )


_ARRAYS = ("angles", "entries", "cut_off", "clearances", "recess_width", "damage")


def recess_widths(
    around: Surroundings, starts: np.ndarray, settings: AccessSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Which lines pass between facial nerve and chorda tympani, and how far apart they are there.

    Parameters
    ----------
    around : Surroundings
    starts : (n, 3) array
        mm, where the lines enter; all end at the target.
    settings : AccessSettings

    Returns
    -------
    between : (n,) bool array
    widths : (n,) array
        mm, the sum of the axis' distances from the nearest voxel centres of both.

    Raises
    ------
    LabelError
        If the anatomy has neither chorda tympani nor ear canal.
    """
    front = next((name for name in IN_FRONT if name in around.keep), None)
    if front is None:
        raise LabelError(f"expected a label for {' or '.join(IN_FRONT)} to know the facial recess, got none")
    lines = around.target - starts
    lengths = np.linalg.norm(lines, axis=1)
    offsets, depths, distances = [], [], []
    for name in ("facial_nerve", front):
        points = around.surfaces[name]
        distance, share, index = nearest_on_lines(points, starts, around.target)
        offsets.append(points[index] - starts - share[:, None] * lines)
        depths.append(share * lengths)
        distances.append(distance)
    sides = [np.linalg.norm(offset, axis=1) for offset in offsets]
    opposite = np.cos(np.deg2rad(settings.recess_angle_deg))
    between = np.einsum("ni,ni->n", *offsets) <= opposite * sides[0] * sides[1]
    between &= np.abs(depths[0] - depths[1]) <= settings.recess_gap
    # Beside the drill, not in front of its tip.
    between &= (depths[0] < lengths - 1e-9) & (depths[1] < lengths - 1e-9)
    return between, distances[0] + distances[1]


def lines_through_recess(
    anatomy: LabelVolume,
    around: Surroundings,
    angles: np.ndarray,
    side: str,
    mean: np.ndarray,
    covariance: np.ndarray,
    settings: AccessSettings,
    reach: float,
) -> Lines:
    """Follow directions outwards; keep those through the facial recess, with what they pass.

    Parameters
    ----------
    anatomy : LabelVolume
    around : Surroundings
    angles : (n, 2) array
        Degrees backwards and upwards.
    side : {"right", "left"}
    mean, covariance : (6,) and (6, 6) arrays
        Of the errors of entry and target in the axes of the drill.
    settings : AccessSettings
    reach : float
        mm by which a voxel counts as nearer than its centre.

    Returns
    -------
    Lines
        Possibly none.
    """
    starts, cut_off = entries(anatomy, around.target, directions_of(*np.deg2rad(angles).T, side))
    known = np.linalg.norm(starts - around.target, axis=1) > 2.0 * settings.drill_diameter
    angles, starts, cut_off = angles[known], starts[known], cut_off[known]
    between, widths = recess_widths(around, starts, settings)
    angles, starts, cut_off, widths = angles[between], starts[between], cut_off[between], widths[between]
    names, surface = tuple(around.keep), settings.drill_radius + reach
    distances, nearest = np.empty((len(angles), len(names))), np.empty((len(angles), len(names), 3))
    for column, name in enumerate(names):
        points = around.surfaces[name]
        distances[:, column], _, index = nearest_on_lines(points, starts, around.target)
        nearest[:, column] = points[index]
    weights = 1.0 / np.array([around.acceptable[name] for name in names])
    axes = axes_of_lines(around.target - starts)
    damage = normal_probabilities(nearest, starts, around.target, mean, covariance, surface, axes) @ weights
    widths = widths - float(anatomy.spacing.mean())  # from face to face of the voxels, not centre to centre
    return Lines(names, angles, starts, cut_off, distances - surface, widths, damage)
