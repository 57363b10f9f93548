"""Alignment of a swab with a surface when no start is known: a multi-start search by halving."""

from study.registration.alignment.search import Alignment, align_surface
from study.registration.alignment.settings import AlignmentSettings

__all__ = ["Alignment", "AlignmentSettings", "align_surface"]
