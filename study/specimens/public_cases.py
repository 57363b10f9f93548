"""Temporal bones of public data sets, as files that the user has obtained."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from study.errors import FileFormatError, LabelError
from study.specimens.case_files import json_object, label_file
from study.specimens.orientation import SIDES, side_of, surgical_view
from study.specimens.specimen import Specimen, fiducial_ring
from study.specimens.structures import PUBLIC_LABELS, labels_of
from study.specimens.target import TargetRule, mastoidectomy_target
from study.volumes import PLANNING_NAMES, LabelVolume, read_volume

#: mm of air that a burr needs lateral of the bone.
LATERAL_AIR = 12.0
_LABEL_FILES = ("labels_0p38.nrrd", "labels_native.nrrd")
#: Names in the public set that have a name of this package. One label holds sinus and dura there.
_RENAMED = {
    "background_or_air": "air",
    "background": "air",
    "bony_labyrinth": "labyrinth",
    "iac": "internal_auditory_canal",
    "eac": "external_auditory_canal",
    "ica": "carotid_artery",
    "tmj": "temporomandibular_joint",
    "sinus_dura": "sigmoid_sinus_and_dura",
    "sinus": "sigmoid_sinus",
}


def _names_of_case(case: dict, path: Path) -> dict[str, int] | None:
    if "labels" not in case:
        return None
    try:
        names = {str(name): int(value) for value, name in case["labels"].items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: expected labels as an object of number to name, got {case['labels']!r}"
        ) from error
    return names


def _with_our_names(volume: LabelVolume) -> LabelVolume:
    names = {}
    for name, value in volume.names.items():
        plain = name.strip().lower().replace(" ", "_").replace("-", "_")
        names[_RENAMED.get(plain, plain)] = value
    return LabelVolume(volume.labels, volume.affine, names)


def _with_lateral_air(anatomy: LabelVolume, side: str) -> LabelVolume:
    """Add air laterally where the image was cut off before it."""
    view = surgical_view(anatomy, side)
    air = labels_of(anatomy, "air")
    if not air:
        raise LabelError(f"expected a label for 'air' in a temporal bone, got {sorted(anatomy.names)}")
    solid = ~view.turned(anatomy.mask(*air))
    empty = int(np.argmax(solid.any(axis=(1, 2)))) * view.spacing[0]
    if empty >= LATERAL_AIR:
        return anatomy
    sides = np.zeros((3, 2), bool)
    sides[view.order[0], 1 if view.flips[0] else 0] = True
    return anatomy.padded(LATERAL_AIR - empty, air[0], sides)


def read_temporal_bone_case(
    folder: str | os.PathLike[str], *, labels: str | None = None, rule: TargetRule | None = None
) -> Specimen:
    """Read a segmented temporal bone and make it a specimen.

    Parameters
    ----------
    folder : path-like
        Holds ``labels_0p38.nrrd``, ``labels_native.nrrd`` or one image file of any name. Read if
        present: ``case.json`` (``case``, ``side``, ``labels`` from number to name),
        ``fiducials.json`` (``positions``), ``planning*.nrrd`` on the same grid. Without ``case.json``
        the file's own names count, else the public set's numbers (`PUBLIC_LABELS`).
    labels : str, optional
        Name of the label file in the folder.
    rule : TargetRule, optional
        Makes the target, even if the folder holds a planning volume. If there is none and no rule is
        given: the default rule.

    Returns
    -------
    Specimen
        Its anatomy under this package's names, with at least 12 mm of air on the lateral side (added
        if the image ends before). Fiducials are those of the file, else `fiducial_ring`.

    Raises
    ------
    FileNotFoundError
        If there is no such folder or file.
    FileFormatError
        If a file is not what it should be; the message names it.
    LabelError, GeometryError, PlanningError
        If the target cannot be made, see `mastoidectomy_target`.
    """
    folder = Path(folder)
    path = label_file(folder, labels, _LABEL_FILES)
    case_path = folder / "case.json"
    case = json_object(case_path) if case_path.is_file() else {}
    names = _names_of_case(case, case_path)
    raw = read_volume(path, names=names)
    if names is None and all(name.startswith("label_") for name in raw.names):
        if raw.labels.max() > max(PUBLIC_LABELS.values()):
            raise LabelError(
                f"{path}: expected label names, or numbers 0 to {max(PUBLIC_LABELS.values())} of the public "
                f"set, got labels up to {raw.labels.max()} without names"
            )
        raw = LabelVolume(raw.labels, raw.affine, PUBLIC_LABELS)
    anatomy = _with_our_names(raw)
    side = case.get("side") or side_of(anatomy)
    if side not in SIDES:
        raise FileFormatError(f"{case_path}: expected side 'right' or 'left', got {side!r}")
    anatomy = _with_lateral_air(anatomy, side)

    planning = None if rule else _planning_on_grid(folder, anatomy)
    if planning is None:
        rule = rule or TargetRule()
        planning = mastoidectomy_target(anatomy, rule, side)
    return Specimen(
        str(case.get("case", folder.name)),
        side,
        anatomy,
        planning,
        _fiducials(folder, planning, side),
        rule,
    )


def _planning_on_grid(folder: Path, anatomy: LabelVolume) -> LabelVolume | None:
    for path in sorted(folder.glob("planning*.nrrd")):
        planning = read_volume(path, names=PLANNING_NAMES)
        if planning.shape == anatomy.shape and np.allclose(planning.affine, anatomy.affine, atol=1e-3):
            return planning
    return None


def _fiducials(folder: Path, planning: LabelVolume, side: str) -> np.ndarray:
    path = folder / "fiducials.json"
    if not path.is_file():
        return fiducial_ring(planning, side)
    try:
        positions = np.array(json_object(path)["positions"], dtype=float).reshape(-1, 3)
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(
            f"{path}: expected positions, a list of x, y, z in mm; got {error!r}"
        ) from error
    if len(positions) < 3 or not np.isfinite(positions).all():
        raise FileFormatError(f"{path}: expected three or more finite positions, got {len(positions)}")
    return positions
