"""What surrounds a drill to the cochlea, from a segmented temporal bone, and where it has to go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from study.errors import GeometryError, LabelError
from study.guidance.access.settings import AccessSettings
from study.registration.sources import checked_vector
from study.specimens.structures import labels_of, structure_mask
from study.volumes import LabelVolume

#: mm: ossicles farther from the labyrinth have no footplate in the oval window.
_FOOTPLATE = 1.5


def structure_points(anatomy: LabelVolume, *names: str) -> dict[str, np.ndarray]:
    """Voxel centres of structures, (m, 3) mm each, under whatever label names.

    Structures that share a label (one for sinus and dura in the public set) are one, under a common name.
    Those that the volume does not have are left out.

    Parameters
    ----------
    anatomy : LabelVolume
    *names : str
        Keys of `study.specimens.structures.SYNONYMS`.
    """
    owners: dict[tuple[str, ...], list[str]] = {}
    for name in names:
        owners.setdefault(labels_of(anatomy, name), []).append(name)
    out = {}
    for labels, shared in owners.items():
        mask = anatomy.mask(*labels) if labels else None
        if mask is not None and mask.any():
            out["_and_".join(shared)] = anatomy.points(np.argwhere(mask))
    return out


def outermost(points: np.ndarray, anatomy: LabelVolume) -> np.ndarray:
    """Those of a structure's (m, 3) voxel centres that have one of six neighbours outside the structure."""
    places = np.rint(anatomy.indices(points)).astype(int)
    low = places.min(axis=0) - 1
    places -= low
    inside = np.zeros(places.max(axis=0) + 2, bool)
    inside[tuple(places.T)] = True
    enclosed = inside.copy()
    for axis in range(3):
        moved, still = np.moveaxis(enclosed, axis, 0), np.moveaxis(inside, axis, 0)
        moved[1:] &= still[:-1]
        moved[:-1] &= still[1:]
    return points[~enclosed[tuple(places.T)]]


def oval_window(anatomy: LabelVolume) -> np.ndarray:
    """(3,) mm, where the ossicles meet the labyrinth: the mean of the labyrinth's voxels next to them.

    Only the stapes does, so that one label for all ossicles serves as well as one for each.

    Raises
    ------
    LabelError
        If labyrinth or ossicles are missing, or do not meet.
    """
    labyrinth, ossicles = (
        anatomy.points(np.argwhere(structure_mask(anatomy, name))) for name in ("labyrinth", "ossicles")
    )
    distances, _ = cKDTree(ossicles).query(labyrinth)
    if distances.min() > _FOOTPLATE:
        raise LabelError(
            f"expected ossicles that meet the labyrinth at the oval window, got {distances.min():.1f} mm "
            "between them; give a target"
        )
    within = distances <= distances.min() + float(anatomy.spacing.max())
    return labyrinth[within].mean(axis=0)


def round_window_target(anatomy: LabelVolume, below: float = AccessSettings.below_oval_window) -> np.ndarray:
    """(3,) mm, a point of the cochlea's basal turn near the round window.

    The promontory, the first part of the basal turn, bulges into the middle ear right below the oval window,
    and the round window lies at its lower back end. The rule: of the labyrinth's voxels that lie at least
    `below` mm below the oval window, the one nearest to it. It needs no label for the cochlea or the
    windows; a user who sees the round window gives its place instead.

    Parameters
    ----------
    anatomy : LabelVolume
        LPS; with labyrinth and ossicles.
    below : float
        mm.

    Raises
    ------
    LabelError
        See `oval_window`.
    GeometryError
        If the labyrinth does not reach so far down.
    """
    window = oval_window(anatomy)
    labyrinth = anatomy.points(np.argwhere(structure_mask(anatomy, "labyrinth")))
    lower = labyrinth[labyrinth[:, 2] <= window[2] - below]
    if not len(lower):
        raise GeometryError(
            f"expected a labyrinth that reaches {below:g} mm below the oval window, got "
            f"{window[2] - labyrinth[:, 2].min():.1f} mm; give a target"
        )
    return lower[np.argmin(((lower - window) ** 2).sum(axis=1))]


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What a drill to a target may meet.

    Attributes
    ----------
    target : (3,) array
        mm.
    keep : mapping of str to (m, 3) array
        Structures to stay away from, voxel centres in mm.
    surfaces : mapping of str to (k, 3) array
        Those voxels of each that have a neighbour outside it. What is nearest to a line is one of them,
        unless the line runs inside the structure.
    opening : (m, 3) array
        The part of the labyrinth that is to be opened.
    acceptable : mapping of str to float
        For each of `keep`: probability of being touched that is accepted.
    missing : tuple of str
        Structures to stay away from for which the volume has no label: nothing is known of them.
    """

    target: np.ndarray
    keep: Mapping[str, np.ndarray]
    surfaces: Mapping[str, np.ndarray]
    opening: np.ndarray
    acceptable: Mapping[str, float]
    missing: tuple[str, ...]


def surroundings(
    anatomy: LabelVolume, target: ArrayLike | None = None, settings: AccessSettings | None = None
) -> Surroundings:
    """Structures around a target, the labyrinth divided into what is to be opened and what is to be spared.

    Raises
    ------
    LabelError
        If facial nerve or labyrinth is missing, or what the target's rule needs.
    GeometryError
        If the target is farther from the labyrinth than the opening is wide.
    """
    settings = settings or AccessSettings()
    for name in ("facial_nerve", "labyrinth"):
        structure_mask(anatomy, name)
    if target is None:
        target = round_window_target(anatomy, settings.below_oval_window)
    target = checked_vector("target", target, "mm")
    keep = structure_points(anatomy, *settings.acceptable)
    labyrinth = keep["labyrinth"]
    distances = np.linalg.norm(labyrinth - target, axis=1)
    if distances.min() > settings.opening:
        raise GeometryError(
            f"target: expected a point within {settings.opening:g} mm of the labyrinth, got "
            f"{target.tolist()}, {distances.min():.1f} mm from it"
        )
    within = distances <= settings.opening
    if within.all():
        keep.pop("labyrinth")
    else:
        keep["labyrinth"] = labyrinth[~within]
    acceptable = {
        name: min(settings.acceptable[part] for part in settings.acceptable if part in name.split("_and_"))
        for name in keep
    }
    surfaces = {name: outermost(points, anatomy) for name, points in keep.items()}
    missing = tuple(name for name in settings.acceptable if not labels_of(anatomy, name))
    return Surroundings(target, keep, surfaces, labyrinth[within], acceptable, missing)
