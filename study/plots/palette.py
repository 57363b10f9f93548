"""Colours of everything drawn, in 2-D and 3-D; they differ in lightness as well as in hue."""

from __future__ import annotations

from dataclasses import dataclass

from study.specimens.structures import SYNONYMS


@dataclass(frozen=True)
class Style:
    """How a label is drawn.

    Attributes
    ----------
    colour : str
        Hexadecimal red, green, blue.
    opacity : float
        Of its surface in 3-D, 0 to 1.
    title : str
        What a legend calls it.
    """

    colour: str
    opacity: float
    title: str


#: Labels of planning volumes and of segmented temporal bones, under this package's names.
STYLES = {
    "air": Style("#dcebf5", 0.15, "air"),
    "protected": Style("#d9cdb0", 1.0, "protected bone"),
    "target": Style("#c8322d", 0.45, "targeted bone"),
    "target_boundary": Style("#f2a024", 1.0, "target boundary"),
    "removed": Style("#8cc5e3", 1.0, "removed"),
    "eroded": Style("#8f6fb5", 1.0, "eroded target"),
    "unreachable": Style("#3d2260", 1.0, "eroded target: unreachable bone"),
    "into_air": Style("#56b4e9", 1.0, "target dilated into air"),
    "supervoxel": Style("#111111", 0.25, "supervoxel"),
    "burr": Style("#4a4f57", 1.0, "burr"),
    "shaft": Style("#8b929c", 1.0, "shaft, chuck and barrel"),
    "path": Style("#0055a4", 1.0, "path of the burr's centre"),
    "bone": Style("#e8dcc0", 1.0, "bone"),
    "facial_nerve": Style("#f2d600", 1.0, "facial nerve"),
    "chorda_tympani": Style("#2e9e3f", 1.0, "chorda tympani"),
    "external_auditory_canal": Style("#c79a6b", 1.0, "external auditory canal"),
    "internal_auditory_canal": Style("#e57f1e", 1.0, "internal auditory canal"),
    "sigmoid_sinus": Style("#2a63b0", 1.0, "sigmoid sinus"),
    "dura": Style("#6fa3d8", 1.0, "dura"),
    "sigmoid_sinus_and_dura": Style("#3f7cc4", 1.0, "sigmoid sinus and dura"),
    "labyrinth": Style("#7a4bb0", 1.0, "labyrinth"),
    "ossicles": Style("#e0559b", 1.0, "ossicles"),
    "carotid_artery": Style("#8e1b1b", 1.0, "carotid artery"),
    "temporomandibular_joint": Style("#a89a86", 1.0, "temporomandibular joint"),
    "vestibular_aqueduct": Style("#4a8f8f", 1.0, "vestibular aqueduct"),
    "air_cells": Style("#bcd9e8", 0.3, "air cells"),
    "middle_ear": Style("#a7c4cf", 0.4, "middle ear"),
    "intracranial": Style("#d3b8c4", 0.3, "brain"),
    "margin": Style("#35b0a2", 0.35, "safety margin"),
    "spared": Style("#0b6e63", 1.0, "margin in the target: spared"),
    "analyzed_shell": Style("#c9ccd1", 1.0, "analyzed shell"),
    "chosen": Style("#d1372c", 1.0, "chosen: riskiest voxels of the shell"),
    "fiducial": Style("#23262b", 1.0, "fiducial"),
    "kidney": Style("#a8574a", 0.5, "kidney"),
    "tumour": Style("#e3b53a", 1.0, "tumour"),
    "swab": Style("#159a37", 1.0, "swab points"),
    "removed_margin": Style("#86c5ee", 0.4, "safety margin: removed too"),
    "rim": Style("#cfb7e8", 0.5, "rim of the tumour to stay clear of"),
    "surely_inside": Style("#4b2a7b", 1.0, "inside the tumour as surely as accepted"),
    "violated": Style("#d1372c", 1.0, "chosen: most often overlapped"),
    "enclosed": Style("#f2a024", 1.0, "added by the closing"),
}

_OTHER = ("#7f7f7f", "#b07aa1", "#499894", "#b6992d", "#79706e", "#d37295")


def structure_of(label: str) -> str:
    """Our name for a label: ``"EAC"`` is ``"external_auditory_canal"``; itself if unknown."""
    plain = label.strip().lower().replace(" ", "_").replace("-", "_")
    if plain in STYLES:
        return plain
    homes = [structure for structure, names in SYNONYMS.items() if plain in names]
    if {"sigmoid_sinus", "dura"} <= set(homes):
        return "sigmoid_sinus_and_dura"
    return homes[0] if homes else plain


def style_of(label: str) -> Style:
    """How to draw a label, under whatever name; unknown labels get one of a few further colours."""
    name = structure_of(label)
    if name in STYLES:
        return STYLES[name]
    return Style(_OTHER[sum(name.encode()) % len(_OTHER)], 1.0, label.replace("_", " "))


def colour_of(label: str) -> str:
    """The colour of a label."""
    return style_of(label).colour
