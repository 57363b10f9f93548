"""Algorithm 1 and the exact method in three dimensions: a tip, triangles near it, and their planes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pyvista as pv
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from study.experiments.fixture_algorithm import Cycle
from study.fixtures import MeshFixture
from study.plots.style import legend_below, new_axes, styled
from study.rendering.panels import scale_bar
from study.rendering.scene import Scene
from study.rendering.views import View

SURFACE, REACHED, PLANE, TIP, DESIRED, GIVEN = (
    "#cfc6b4",
    "#f2a024",
    "#c8322d",
    "#4a4f57",
    "#7d7d7d",
    "#0072b2",
)
#: As titles call them.
METHODS = {"published": "Algorithm 1", "exact": "exact"}


def _body(fixture: MeshFixture, faces: np.ndarray) -> pv.PolyData:
    corners = fixture.mesh.faces[faces]
    return pv.PolyData(fixture.mesh.vertices, np.c_[np.full(len(corners), 3), corners].ravel())


def planes_scene(cycle: Cycle, method: str, view: View) -> Scene:
    """A cycle of a guided tip: the surface, the triangles in reach, the planes and both motions.

    Parameters
    ----------
    cycle : Cycle
        Its motions are drawn four times as long.
    method : str
        "published" or "exact".
    view : View
    """
    fixture, position, radius = cycle.fixture, cycle.position, cycle.radius
    normals, points, motion = cycle.planes[method]
    near = fixture.index.within(position, cycle.reach).faces
    far = np.setdiff1d(np.arange(len(fixture.mesh.faces)), near)
    scene = Scene(view)
    lines = {"show_edges": True, "edge_color": "#6e6658", "line_width": 0.6, "smooth_shading": False}
    for faces, colour, title in ((far, SURFACE, "surface"), (near, REACHED, "triangles in reach")):
        if len(faces):
            scene.mesh(_body(fixture, faces), "bone", colour=colour, opacity=1.0, title=title, **lines)
    for way, colour, title in ((cycle.desired, DESIRED, "desired motion"), (motion, GIVEN, "motion given")):
        length = float(np.linalg.norm(way))
        if length > 0:
            arrow = pv.Arrow(
                start=position, direction=way, scale=4 * length, shaft_radius=0.035, tip_radius=0.09
            )
            scene.mesh(arrow, "path", colour=colour, opacity=1.0, title=title)
    for normal, point in zip(normals, points, strict=True):
        disc = pv.Disc(center=point, inner=0.0, outer=1.4 * radius, normal=normal, c_res=48)
        scene.mesh(disc, "chosen", colour=PLANE, opacity=0.35, title="planes", smooth_shading=False)
    tip = pv.Sphere(radius=radius, center=position, theta_resolution=48, phi_resolution=48)
    return scene.mesh(tip, "burr", colour=TIP, opacity=0.4, title="tip")


@styled()
def cycles_figure(cycles: Sequence[Cycle], pixels: int = 720) -> Figure:
    """Cycles in space, a row each: Algorithm 1 on the left, the exact method on the right.

    Parameters
    ----------
    cycles : sequence of Cycle
    pixels : int
        Width of a panel's rendering.
    """
    figure, axes = new_axes(len(cycles), 2, (10.0, 3.5 * len(cycles) + 0.4))
    size, titles = (pixels, int(0.66 * pixels)), {}
    for cycle, row in zip(cycles, axes, strict=True):
        for (method, name), ax in zip(METHODS.items(), row, strict=True):
            looking = np.array([0.25, 0.9, -0.42])
            view = View(looking, np.array([0.0, 0, 1]), cycle.position - [0, 0, 0.3], 2.2)
            scene = planes_scene(cycle, method, view)
            ax.imshow(scene.image(size), interpolation="antialiased")
            ax.set_axis_off()
            count = len(cycle.planes[method][0])
            ax.set_title(f"{cycle.title}; {name}: {count} plane{'s' * (count != 1)}")
            scale_bar(ax, scene.placed_view(size[0] / size[1]), size)
            titles |= {title: colour for title, colour, _ in scene.legend()}
    legend_below(figure, [Patch(color=colour, label=title) for title, colour in titles.items()], 6)
    return figure
