"""Segmented images: `LabelVolume`, the files they come from and go to, structuring elements."""

from study.volumes.colours import ColourTable, read_colour_table
from study.volumes.elements import ball_element
from study.volumes.files import read_volume, write_volume
from study.volumes.label_volume import PLANNING_NAMES, LabelVolume
from study.volumes.png_stacks import read_png_stack, write_png_stack
from study.volumes.resampling import reoriented, resampled
from study.volumes.surfaces import read_surface, surface, volume_from_surface, write_surface

__all__ = [
    "PLANNING_NAMES",
    "ColourTable",
    "LabelVolume",
    "ball_element",
    "read_colour_table",
    "read_png_stack",
    "read_surface",
    "read_volume",
    "reoriented",
    "resampled",
    "surface",
    "volume_from_surface",
    "write_png_stack",
    "write_surface",
    "write_volume",
]
