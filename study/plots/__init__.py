"""Pictures in two dimensions: sections of volumes, windows, short paths, in one style and palette."""

from study.plots.boundary import boundary_figure, mill_plane, pocket
from study.plots.freedom import bone_by_bone, bone_left, degree_ratios, over_holes, shaft_directions
from study.plots.margin_tables import margin_volumes, risk_curves, stopping_rules
from study.plots.modified import burr_and_voxels, dilation_into_air, modified_steps
from study.plots.palette import STYLES, colour_of, style_of
from study.plots.sections import Section, section
from study.plots.short_path import descending_path, flow_chart, manhattan_labels, short_path_plane
from study.plots.steps import simulations_in_step
from study.plots.style import legend_below, new_axes, new_figure, patches, show_labels, styled
from study.plots.windows import accessible_window, slab_collapse

__all__ = [
    "STYLES",
    "Section",
    "accessible_window",
    "bone_by_bone",
    "bone_left",
    "boundary_figure",
    "burr_and_voxels",
    "colour_of",
    "degree_ratios",
    "descending_path",
    "dilation_into_air",
    "flow_chart",
    "legend_below",
    "manhattan_labels",
    "margin_volumes",
    "mill_plane",
    "modified_steps",
    "new_axes",
    "new_figure",
    "over_holes",
    "patches",
    "pocket",
    "risk_curves",
    "section",
    "shaft_directions",
    "short_path_plane",
    "show_labels",
    "simulations_in_step",
    "slab_collapse",
    "stopping_rules",
    "style_of",
    "styled",
]
