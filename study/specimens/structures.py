"""What the structures of a segmented temporal bone are called, here and in public data sets."""

from __future__ import annotations

import numpy as np

from study.errors import LabelError
from study.volumes import LabelVolume

#: A structure's name -> the label names that stand for it or for a part of it, in lower case with
#: underscores. A label may stand for several (the public set has one label for sinus and dura).
SYNONYMS: dict[str, tuple[str, ...]] = {
    "air": ("air", "background", "background_or_air", "exterior"),
    "air_cells": ("air_cells", "mastoid_air_cells", "antrum"),
    "middle_ear": ("middle_ear", "tympanic_cavity"),
    "bone": ("bone", "temporal_bone"),
    "facial_nerve": ("facial_nerve", "facial", "fn"),
    "chorda_tympani": ("chorda_tympani", "chorda"),
    "external_auditory_canal": ("external_auditory_canal", "eac", "ear_canal"),
    "internal_auditory_canal": (
        "internal_auditory_canal",
        "iac",
        "superior_vestibular_nerve",
        "inferior_vestibular_nerve",
        "cochlear_nerve",
    ),
    "sigmoid_sinus": ("sigmoid_sinus", "sinus", "sinus_dura", "sigmoid_sinus_and_dura"),
    "dura": ("dura", "tegmen", "sinus_dura", "sigmoid_sinus_and_dura"),
    "labyrinth": ("labyrinth", "bony_labyrinth", "cochlea", "vestibule", "semicircular_canals"),
    "ossicles": ("ossicles", "malleus", "incus", "stapes"),
    "carotid_artery": ("carotid_artery", "ica", "internal_carotid_artery"),
    "temporomandibular_joint": ("temporomandibular_joint", "tmj"),
    "vestibular_aqueduct": ("vestibular_aqueduct",),
    "intracranial": ("intracranial", "brain"),
}

#: Label numbers of the public set of temporal bones, for a label file without its description.
PUBLIC_LABELS = {
    "Background_or_air": 0,
    "Bone": 1,
    "Malleus": 2,
    "Incus": 3,
    "Stapes": 4,
    "Bony_Labyrinth": 5,
    "IAC": 6,
    "Superior_Vestibular_Nerve": 7,
    "Inferior_Vestibular_Nerve": 8,
    "Cochlear_Nerve": 9,
    "Facial_Nerve": 10,
    "Chorda_Tympani": 11,
    "ICA": 12,
    "Sinus_Dura": 13,
    "Vestibular_Aqueduct": 14,
    "TMJ": 15,
    "EAC": 16,
}


def _plain(name: str) -> str:
    return name.strip().lower().replace(" ", "_").replace("-", "_")


def labels_of(volume: LabelVolume, structure: str) -> tuple[str, ...]:
    """Names of the labels in `volume` that stand for a structure or a part of it, possibly none.

    Parameters
    ----------
    volume : LabelVolume
    structure : str
        A key of `SYNONYMS`.

    Raises
    ------
    LabelError
        If `structure` is not in the table.
    """
    if structure not in SYNONYMS:
        raise LabelError(f"structure: expected one of {sorted(SYNONYMS)}, got {structure!r}")
    return tuple(name for name in volume.names if _plain(name) in SYNONYMS[structure])


def structure_mask(volume: LabelVolume, structure: str) -> np.ndarray:
    """Where a structure is, under whatever name and in however many labels.

    Parameters
    ----------
    volume : LabelVolume
        A segmented temporal bone with names of this package or of the public set.
    structure : str
        A key of `SYNONYMS`, such as ``"facial_nerve"``.

    Returns
    -------
    (nx, ny, nz) bool array
        With at least one voxel set.

    Raises
    ------
    LabelError
        If the volume has no such label, or no voxel of it.
    """
    names = labels_of(volume, structure)
    if not names:
        raise LabelError(
            f"expected a label for {structure!r} (one of {', '.join(SYNONYMS[structure])}), "
            f"got {sorted(volume.names)}"
        )
    mask = volume.mask(*names)
    if not mask.any():
        raise LabelError(f"no voxel is labelled {' or '.join(names)}: expected a {structure!r} in the volume")
    return mask
