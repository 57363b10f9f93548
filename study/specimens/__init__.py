"""Temporal bones and kidneys: procedural, catalogued, or read from public data sets."""

from study.specimens.named_specimens import catalogue, specimen
from study.specimens.parameters import TemporalBoneParameters
from study.specimens.public_cases import KidneyCase, read_kidney_case, read_temporal_bone_case
from study.specimens.specimen import Specimen, fiducial_ring
from study.specimens.structures import structure_mask
from study.specimens.target import MASTOIDECTOMY, TRANSLABYRINTHINE, TargetRule, mastoidectomy_target
from study.specimens.temporal_bone import ANATOMY_NAMES, temporal_bone

__all__ = [
    "ANATOMY_NAMES",
    "MASTOIDECTOMY",
    "TRANSLABYRINTHINE",
    "KidneyCase",
    "Specimen",
    "TargetRule",
    "TemporalBoneParameters",
    "catalogue",
    "fiducial_ring",
    "mastoidectomy_target",
    "read_kidney_case",
    "read_temporal_bone_case",
    "specimen",
    "structure_mask",
    "temporal_bone",
]
