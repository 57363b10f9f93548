"""Pictures in three dimensions: static and off screen in batch, turned with the mouse in a notebook.

A `Scene` collects surfaces, paths and drills; `show` makes a viewer or an image of it; the figures of
chapter 2 return matplotlib figures made of such images.
"""

from study.rendering.chapter2 import (
    anatomy,
    candidates,
    drill_figure,
    milling_strip,
    modified_segmentation,
    path_in_region,
    plan_scene,
    scene_figure,
    segmentation,
    short_path_in_space,
    supervoxel,
)
from study.rendering.milling import MillingFrame, milling_frames
from study.rendering.octree import (
    octree_levels,
    octree_section,
    shaft_against_octree,
    shaft_range,
    whole_octree,
)
from study.rendering.panels import panels
from study.rendering.scene import Scene, draw, is_interactive, off_screen, show
from study.rendering.surfaces import mask_surface, mask_surface_exact
from study.rendering.views import View, approach_view, side_view
from study.rendering.voxels import box_edges, voxel_cubes

__all__ = [
    "MillingFrame",
    "Scene",
    "View",
    "anatomy",
    "approach_view",
    "box_edges",
    "candidates",
    "draw",
    "drill_figure",
    "is_interactive",
    "mask_surface",
    "mask_surface_exact",
    "milling_frames",
    "milling_strip",
    "modified_segmentation",
    "octree_levels",
    "octree_section",
    "off_screen",
    "panels",
    "path_in_region",
    "plan_scene",
    "scene_figure",
    "segmentation",
    "shaft_against_octree",
    "shaft_range",
    "short_path_in_space",
    "show",
    "side_view",
    "supervoxel",
    "voxel_cubes",
    "whole_octree",
]
