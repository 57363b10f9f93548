"""Whatever a notebook is pointed at: a specimen of the catalogue, a file, a folder of a public data set."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from study.collision import find_approach
from study.errors import GeometryError, InputError, LabelError
from study.paths import PROJECT
from study.specimens import (
    Specimen,
    TargetRule,
    catalogue,
    fiducial_ring,
    mastoidectomy_target,
    read_temporal_bone_case,
    specimen,
    structure_mask,
)
from study.specimens.orientation import side_of
from study.specimens.structures import PUBLIC_LABELS, SYNONYMS
from study.volumes import LabelVolume, read_volume


@dataclass(frozen=True, eq=False)
class Case:
    """Something to plan on.

    Attributes
    ----------
    name : str
        Of the specimen, the file (without suffix) or the folder.
    planning : LabelVolume
        With air and target; the rest is protected.
    anatomy : LabelVolume or None
        Anatomical labels on the same grid; None for a file that holds only a planning volume.
    approach : (3,) array or None
        Outside -> bone, where the anatomy says which side it is; else left to the planner.
    fiducials : (n, 3) array or None
        mm; those of the specimen or the folder, else `study.specimens.fiducial_ring` where the side is known.
    side : {"right", "left"} or None
    rule : TargetRule or None
        What made the target, if a rule did.
    """

    name: str
    planning: LabelVolume
    anatomy: LabelVolume | None = None
    approach: np.ndarray | None = None
    fiducials: np.ndarray | None = None
    side: str | None = None
    rule: TargetRule | None = None

    @classmethod
    def of(cls, bone: Specimen) -> Case:
        """A specimen as a case."""
        return cls(
            bone.name, bone.planning, bone.anatomy, bone.approach, bone.fiducials, bone.side, bone.rule
        )

    def with_clearance(self, mm: float, structures: Iterable[str]) -> Case:
        """The same bone with a target that keeps another distance from some of the structures.

        The rule behind chapter 2's targets keeps a millimetre or more from every structure by itself; where
        safety margins are to decide how near is near enough, the target has to go up to them.

        Parameters
        ----------
        mm : float
            Kept from each of `structures`; the rule's own distance from the others.
        structures : iterable of str
            Keys of `study.specimens.structures.SYNONYMS`.

        Raises
        ------
        InputError
            If the case has no anatomy to draw a target in, or a structure or distance is not known.
        LabelError, PlanningError
            From `study.specimens.mastoidectomy_target`.
        """
        if self.anatomy is None or self.side is None:
            raise InputError(
                f"{self.name}: expected a bone with labelled anatomy, got a planning volume only"
            )
        rule = self.rule or TargetRule()
        rule = replace(rule, clearances={**rule.clearances, **dict.fromkeys(structures, mm)})
        return replace(self, planning=mastoidectomy_target(self.anatomy, rule, self.side), rule=rule)

    def structure(self, name: str) -> np.ndarray | None:
        """(nx, ny, nz) mask of a structure such as ``"facial_nerve"``; None where it is unknown."""
        for volume in (self.anatomy, self.planning):
            if volume is not None:
                try:
                    return structure_mask(volume, name)
                except InputError:
                    continue
        return None

    def most_delicate(self) -> tuple[str, np.ndarray]:
        """Name and mask of what to stay away from most: the facial nerve, if it is known.

        Else the first of chorda, labyrinth, sigmoid sinus, dura that is; else all protected bone.
        """
        for name in ("facial_nerve", "chorda_tympani", "labyrinth", "sigmoid_sinus", "dura"):
            mask = self.structure(name)
            if mask is not None:
                return name.replace("_", " "), mask
        return "protected bone", ~(self.planning.mask("air") | self.planning.mask("target"))


def load_case(what: str | os.PathLike[str], rule: TargetRule | None = None) -> Case:
    """Load something to plan on.

    Parameters
    ----------
    what : str or path-like
        One of

        - a name of `study.specimens.catalogue`, such as ``"TB03"``;
        - a file ``.seg.nrrd``, ``.nrrd``, ``.nii.gz`` or ``.nii`` whose labels include ``air`` and
          ``target`` (unnamed labels 0, 1, 2 are air, protected, target): taken as it is;
        - such a file of a segmented temporal bone: the target comes from `mastoidectomy_target`;
        - a folder of a public data set, see `read_temporal_bone_case`.

        A relative path counts from the working directory, else from the root of the checkout.
    rule : TargetRule, optional
        For a segmented bone.

    Returns
    -------
    Case

    Raises
    ------
    InputError
        If it is none of these.
    FileNotFoundError, FileFormatError, GeometryError, LabelError, PlanningError
        From reading the file or making the target.
    """
    text = os.fspath(what)
    if text in catalogue():
        return Case.of(specimen(text))
    path = next((p for p in (Path(text), PROJECT / text) if text and p.exists()), None)
    if path is None:
        names = catalogue()
        raise InputError(
            f"expected a specimen ({names[0]} to {names[-1]}), a file or a folder; {text!r} is none of them"
        )
    if path.is_dir():
        return Case.of(read_temporal_bone_case(path, rule=rule))
    volume = read_volume(path)
    name = path.name.split(".")[0]
    if {"air", "target"} <= set(volume.names):
        side = _side_if_known(volume)
        return Case(name, volume, fiducials=fiducial_ring(volume, side) if side else None, side=side)
    if all(label.startswith("label_") for label in volume.names):
        if volume.labels.max() > max(PUBLIC_LABELS.values()):
            raise InputError(
                f"{path}: expected labels with names, 0 to 2 (air, protected, target), or 0 to "
                f"{max(PUBLIC_LABELS.values())} of the public set; got labels up to {volume.labels.max()}"
            )
        volume = LabelVolume(volume.labels, volume.affine, PUBLIC_LABELS)
    known = [label for label in volume.names if _is_structure(label)]
    if len(known) < 2:
        raise InputError(
            f"{path}: expected labels 'air' and 'target', or structures of a temporal bone such as "
            f"'facial_nerve'; got {sorted(volume.names)}"
        )
    rule = rule or TargetRule()
    planning = mastoidectomy_target(volume, rule)
    side = side_of(volume)
    return Case(name, planning, volume, fiducials=fiducial_ring(planning, side), side=side, rule=rule)


def _side_if_known(volume: LabelVolume) -> str | None:
    """The side of the head where a planning volume keeps the structures that tell it."""
    try:
        return side_of(volume) if volume.mask("target").any() else None
    except (GeometryError, LabelError):
        return None


def _is_structure(label: str) -> bool:
    plain = label.strip().lower().replace(" ", "_").replace("-", "_")
    return any(plain in names for names in SYNONYMS.values())


def parse_approach(text: str) -> np.ndarray | None:
    """A direction from a notebook's parameter: ``""`` for none, else three numbers in mm (LPS).

    Raises
    ------
    InputError
        If it is neither.
    """
    if not text.strip():
        return None
    try:
        values = np.array([float(part) for part in text.replace(",", " ").split()])
    except ValueError:
        values = np.empty(0)
    if values.shape != (3,) or not np.isfinite(values).all() or not values.any():
        raise InputError(f"approach: expected '' or three numbers such as '1 0 0', got {text!r}")
    return values


def undercut(
    volume: LabelVolume, rim_mm: float = 4.0, hole_mm: float = 14.0, approach: np.ndarray | None = None
) -> LabelVolume:
    """The volume with an overhang: its outermost target is protected but for a round hole.

    Parameters
    ----------
    volume : LabelVolume
        With air and target.
    rim_mm : float
        Depth of the overhang along the approach, from the outermost fiftieth of the target.
    hole_mm : float
        Diameter of the hole, around the median of the target.
    approach : (3,) array, optional
        Outside -> bone; found by `find_approach` and snapped to the grid when not given.

    Returns
    -------
    LabelVolume

    Raises
    ------
    InputError
        If a size is not positive.
    """
    for name, value in (("rim_mm", rim_mm), ("hole_mm", hole_mm)):
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"{name}: expected mm above 0, got {value}")
    target = volume.mask("target")
    points = volume.points(np.argwhere(target))
    if approach is None:
        along = volume.directions.T @ find_approach(volume)
        nearest = int(np.argmax(np.abs(along)))
        approach = np.sign(along[nearest]) * volume.directions[:, nearest]
    depth = points @ approach
    outer = depth < np.quantile(depth, 0.02) + rim_mm
    across = points - np.outer(depth, approach)
    aside = np.linalg.norm(across - np.median(across, axis=0), axis=1)
    names = {"protected": max(volume.names.values()) + 1, **volume.names}
    labels = volume.labels.copy()
    lid = np.argwhere(target)[outer & (aside > hole_mm / 2)]
    labels[tuple(lid.T)] = names["protected"]
    return volume.with_labels(labels, names)


def distance_from(mask: np.ndarray, spacing: np.ndarray, most_mm: float) -> np.ndarray:
    """Mm from every voxel centre to the nearest voxel centre of a mask, over `most_mm`, capped at 1.

    A field for `study.planners.FitnessTerm`: 0 on the structure, 1 at `most_mm` and beyond.

    Parameters
    ----------
    mask : (nx, ny, nz) bool array
    spacing : (3,) mm
    most_mm : float

    Raises
    ------
    InputError
        If no voxel is set or `most_mm` is not positive.
    """
    from scipy import ndimage

    if not mask.any():
        raise InputError("mask: expected at least one voxel of the structure, got none")
    if not (np.isfinite(most_mm) and most_mm > 0):
        raise InputError(f"most_mm: expected mm above 0, got {most_mm}")
    distance = ndimage.distance_transform_edt(~mask, sampling=spacing)
    return np.minimum(distance / most_mm, 1.0).astype(np.float32)
