"""Temporal bones and kidneys: procedural, catalogued, or read from public data sets."""

from study.specimens.kidney import KIDNEY_NAMES, kidney
from study.specimens.kidney_cases import KidneyCase, kidney_surface, read_kidney_case
from study.specimens.kidney_catalogue import kidney_case, kidney_catalogue, load_kidney
from study.specimens.kidney_measures import exophytic_share, tumour_sections
from study.specimens.kidney_parameters import KidneyParameters
from study.specimens.kidney_raw import affected_kidney
from study.specimens.kidney_reach import reachable_vertices
from study.specimens.kidney_swab import SwabRule, trace_swab
from study.specimens.named_specimens import catalogue, specimen
from study.specimens.parameters import TemporalBoneParameters
from study.specimens.public_cases import read_temporal_bone_case
from study.specimens.specimen import Specimen, fiducial_ring
from study.specimens.structures import structure_mask
from study.specimens.target import MASTOIDECTOMY, TRANSLABYRINTHINE, TargetRule, mastoidectomy_target
from study.specimens.temporal_bone import ANATOMY_NAMES, temporal_bone

__all__ = [
    "ANATOMY_NAMES",
    "KIDNEY_NAMES",
    "MASTOIDECTOMY",
    "TRANSLABYRINTHINE",
    "KidneyCase",
    "KidneyParameters",
    "Specimen",
    "SwabRule",
    "TargetRule",
    "TemporalBoneParameters",
    "affected_kidney",
    "catalogue",
    "exophytic_share",
    "fiducial_ring",
    "kidney",
    "kidney_case",
    "kidney_catalogue",
    "kidney_surface",
    "load_kidney",
    "mastoidectomy_target",
    "reachable_vertices",
    "read_kidney_case",
    "read_temporal_bone_case",
    "specimen",
    "structure_mask",
    "temporal_bone",
    "trace_swab",
    "tumour_sections",
]
