"""What is in a picture, and how it becomes one: drawn off screen into an image, or turned with the mouse."""

from __future__ import annotations

import importlib.util
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyvista as pv

from study.collision import Drill
from study.errors import InputError
from study.files import written_whole
from study.plots.palette import style_of
from study.rendering.surfaces import mask_surface, mask_surface_exact
from study.rendering.views import View
from study.volumes import LabelVolume

SIZE = (1200, 900)


@dataclass(frozen=True, eq=False)
class Item:
    """One thing in a scene: a mesh in mm, how it looks, what the legend calls it (nothing if empty)."""

    mesh: pv.DataSet
    colour: str
    opacity: float
    title: str
    options: dict[str, Any] = field(default_factory=dict)


class Scene:
    """Surfaces, paths and drills in the mm frame, and a camera.

    Translucent surfaces are drawn in the order in which they were added: add the inner one first.
    (Sorting every pixel by depth is lost without a graphics card.)

    Parameters
    ----------
    view : View
        Its centre and size fit what is in the scene unless it says otherwise.
    """

    def __init__(self, view: View):
        self.view = view
        self.items: list[Item] = []

    def mesh(
        self, mesh: pv.DataSet, label: str, *, opacity=None, colour=None, title=None, **options
    ) -> Scene:
        """Add a mesh in the style of a label."""
        style = style_of(label)
        self.items.append(
            Item(
                mesh,
                colour or style.colour,
                style.opacity if opacity is None else opacity,
                style.title if title is None else title,
                options,
            )
        )
        return self

    def mask(
        self,
        mask: np.ndarray,
        affine: np.ndarray,
        label: str,
        *,
        exact: bool = False,
        smooth: int = 30,
        **style,
    ) -> Scene:
        """Add the surface of a mask, smoothed or (`exact`) voxel by voxel; an empty mask adds nothing."""
        if np.any(mask):
            mesh = mask_surface_exact(mask, affine) if exact else mask_surface(mask, affine, smooth=smooth)
            self.mesh(mesh, label, **style)
        return self

    def label(self, volume: LabelVolume, *names: str, **style) -> Scene:
        """Add the surfaces of a volume's labels, each in its own colour."""
        for name in names:
            self.mask(volume.mask(name), volume.affine, name, **style)
        return self

    def path(self, points: np.ndarray, *, radius: float = 0.12, values=None, title=None, **options) -> Scene:
        """Add a path as a tube, coloured by one value a point if `values` is given."""
        points = np.asarray(points, float)
        moved = np.r_[True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9]
        points = points[moved]
        if len(points) < 2:
            return self
        line = pv.PolyData(points, lines=np.concatenate([[len(points)], np.arange(len(points))]))
        if values is not None:
            line["value"] = np.asarray(values, float)[moved]
            options = {"scalars": "value", "show_scalar_bar": False, **options}
        tube = line.tube(radius=radius, n_sides=6, capping=True)
        return self.mesh(tube, "path", title=title, **options)

    def drill(
        self, drill: Drill, position: np.ndarray, axis: np.ndarray, length: float = 30.0, **style
    ) -> Scene:
        """Add burr and shaft at a pose; the shaft is cut `length` mm from the burr's centre."""
        position, axis = np.asarray(position, float), np.asarray(axis, float)
        burr = pv.Sphere(radius=drill.burr_radius, center=position, theta_resolution=40, phi_resolution=40)
        self.mesh(burr, "burr", **style)
        for n, (radius, start, end) in enumerate(drill.cylinders):
            end = min(end, length)
            if start < end:
                centre = position + axis * (start + end) / 2
                body = pv.Cylinder(
                    center=centre, direction=axis, radius=radius, height=end - start, resolution=48
                )
                self.mesh(body, "shaft", title=None if n == 0 else "", smooth_shading=False, **style)
        return self

    def legend(self) -> list[tuple[str, str, float]]:
        """Title, colour and opacity of what is in the scene, each title once."""
        seen: dict[str, tuple[str, str, float]] = {}
        for item in self.items:
            if item.title:
                seen.setdefault(item.title, (item.title, item.colour, item.opacity))
        return list(seen.values())

    def placed_view(self, aspect: float) -> View:
        """The view with centre and half height filled in, for a picture of this width over height."""
        if not self.items:
            raise InputError("expected at least one thing in the scene, got none")
        if self.view.centre is not None and self.view.half_height > 0:
            return self.view
        corners = np.concatenate([_some_points(item.mesh) for item in self.items])
        aside, above = corners @ self.view.right, corners @ self.view.up
        centre = self.view.centre
        if centre is None:
            centre = (
                self.view.right * (aside.min() + aside.max()) / 2
                + self.view.up * (above.min() + above.max()) / 2
                + self.view.looking * np.mean(corners @ self.view.looking)
            )
        wide = np.abs(aside - centre @ self.view.right).max() / aspect
        high = np.abs(above - centre @ self.view.up).max()
        return self.view.around(centre, self.view.half_height or 1.06 * max(wide, high))

    def __call__(self, plotter: pv.Plotter) -> None:
        """Put everything into a plotter and aim its camera."""
        for item in sorted(self.items, key=lambda item: item.opacity < 1):
            given = {} if "scalars" in item.options else {"color": item.colour}
            flat = item.mesh.point_data.active_normals is None
            plotter.add_mesh(
                item.mesh,
                opacity=item.opacity,
                **(
                    {"smooth_shading": not flat, "ambient": 0.22, "diffuse": 0.85, "specular": 0.05}
                    | given
                    | item.options
                ),
            )
        width, height = plotter.window_size
        view = self.placed_view(width / height)
        distance = 500.0
        plotter.camera.position = view.centre - distance * view.looking
        plotter.camera.focal_point = view.centre
        plotter.camera.up = view.up
        plotter.camera.parallel_projection = True
        plotter.camera.parallel_scale = view.half_height
        plotter.reset_camera_clipping_range()

    def image(self, size: Sequence[int] = SIZE) -> np.ndarray:
        """(height, width, 3) uint8 picture, drawn off screen."""
        return draw(self, size)


def _some_points(mesh: pv.DataSet, n: int = 4000) -> np.ndarray:
    points = np.asarray(mesh.points, float)
    return points[:: max(1, len(points) // n)]


@contextmanager
def off_screen(size: Sequence[int] = SIZE) -> Iterator[pv.Plotter]:
    """An off-screen plotter that is closed whatever happens; it needs no display.

    Without a display VTK tries X first and complains on stderr before it turns to EGL: it is kept quiet.
    """
    with _quiet_about_displays():
        plotter = pv.Plotter(off_screen=True, window_size=list(size), lighting=None)
    try:
        _light(plotter)
        yield plotter
    finally:
        plotter.close()
        plotter.deep_clean()


def _light(plotter: pv.Plotter) -> None:
    """White ground; a headlight, so that nothing in view is dark, and a key light from the upper left."""
    plotter.set_background("white")
    for position, intensity in (((0.0, 0.0, 1.0), 0.5), ((-0.55, 0.55, 0.65), 0.5)):
        light = pv.Light(light_type="camera light", intensity=intensity)
        light.position, light.focal_point = position, (0.0, 0.0, 0.0)
        plotter.add_light(light)


@contextmanager
def _quiet_about_displays() -> Iterator[None]:
    if not sys.platform.startswith("linux") or os.environ.get("DISPLAY"):
        yield
        return
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(before)


def draw(build: Callable[[pv.Plotter], None], size: Sequence[int] = SIZE) -> np.ndarray:
    """Let `build` fill a plotter and return the (height, width, 3) uint8 picture."""
    with off_screen(size) as plotter:
        build(plotter)
        with _quiet_about_displays():
            return np.array(plotter.screenshot(return_img=True))


def is_interactive() -> bool:
    """Whether somebody sits in front of a notebook that can show a view to be turned.

    A Jupyter kernel that is not a batch run (``STUDY_BATCH``), with pyvista's backend ``trame_pyvista``.
    """
    if os.environ.get("STUDY_BATCH") or importlib.util.find_spec("trame_pyvista") is None:
        return False
    shell = sys.modules["IPython"].get_ipython() if "IPython" in sys.modules else None
    return shell is not None and "IPKernelApp" in shell.config


def show(
    build: Callable[[pv.Plotter], None],
    path: str | os.PathLike[str] | None = None,
    interactive: bool | str = "auto",
    size: Sequence[int] = SIZE,
) -> Any:
    """Show a scene: to be turned with the mouse in a notebook, as a picture elsewhere.

    Parameters
    ----------
    build : callable of a pyvista.Plotter
        A `Scene`, or anything else that fills a plotter.
    path : path-like, optional
        Where to write the picture (PNG), in either case.
    interactive : bool or "auto"
        "auto" asks `is_interactive`.
    size : (2,) ints
        Pixels.

    Returns
    -------
    A Jupyter viewer, or a `PIL.Image.Image`; both show themselves at the end of a notebook's cell.
    """
    from PIL import Image

    wanted = is_interactive() if interactive == "auto" else bool(interactive)
    image = None
    if path is not None or not wanted:
        image = Image.fromarray(draw(build, size))
    if path is not None:
        with written_whole(path) as temporary:
            image.save(temporary)
    if not wanted:
        return image
    with _quiet_about_displays():
        plotter = pv.Plotter(notebook=True, window_size=list(size), lighting=None)
        _light(plotter)
        build(plotter)
        plotter.add_axes(xlabel="L", ylabel="P", zlabel="S")
        return plotter.show(jupyter_backend="trame", return_viewer=True)
