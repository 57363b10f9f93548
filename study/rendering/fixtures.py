"""A guided tool over a temporal bone: what the hand asked for, where the tool went, and when it was held."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pyvista as pv
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.files import written_whole
from study.fixtures import MeshFixture, ShaftTool, SphereTool
from study.rendering.panels import panels
from study.rendering.scene import Scene, _quiet_about_displays, off_screen
from study.rendering.views import View
from study.specimens.structures import labels_of
from study.volumes import LabelVolume

#: Colours of a tool by what its controller answered.
STATUS = {
    "free": "#1b9e77",
    "constrained": "#e8590c",
    "led out": "#0fb5c9",
    "inside": "#b5179e",
    "infeasible": "#111111",
    "unsettled": "#8d8d8d",
    "refused": "#8d8d8d",
}
HAND = "#2b2f36"
SOLID = ("facial_nerve", "chorda_tympani", "labyrinth", "ossicles", "internal_auditory_canal")
VEILED = {"external_auditory_canal": 0.45, "sigmoid_sinus": 0.45, "dura": 0.14}


@dataclass(frozen=True, eq=False)
class Track:
    """Where a tool was and what the hand wanted of it.

    Attributes
    ----------
    poses : (n, 3) or (n, 6) array
        mm, and rotation vectors, rad.
    status : (n,) sequence of str
        Keys of `STATUS`: how the tool arrived there.
    hand : (m, 3) array
        mm, where the hand wanted the tip; drawn as a line. In an animation m is n, row by row.
    tool : SphereTool or ShaftTool
    """

    poses: np.ndarray
    status: Sequence[str]
    hand: np.ndarray
    tool: SphereTool | ShaftTool

    def __post_init__(self) -> None:
        if len(self.poses) != len(self.status) or len(self.poses) < 2:
            raise InputError(
                f"a track: expected a status for each of at least two poses, got {len(self.poses)} poses "
                f"and {len(self.status)} statuses"
            )
        unknown = sorted(set(self.status) - set(STATUS))
        if unknown:
            raise InputError(f"status: expected one of {', '.join(STATUS)}, got {', '.join(unknown)}")


def fixture_body(fixture: MeshFixture) -> pv.PolyData:
    """A fixture's triangles as something to draw."""
    faces = fixture.mesh.faces
    body = pv.PolyData(fixture.mesh.vertices, np.c_[np.full(len(faces), 3), faces].ravel())
    return body.clean()


def bone_scene(
    anatomy: LabelVolume,
    view: View,
    solid: Iterable[str] = SOLID,
    veiled: Mapping[str, float] | None = None,
) -> Scene:
    """Structures of a temporal bone: small ones solid, large ones to be seen through."""
    scene = Scene(view)
    opacities = dict.fromkeys(solid, 1.0) | dict(VEILED if veiled is None else veiled)
    for name, opacity in opacities.items():
        labels = labels_of(anatomy, name)
        if labels:
            style = labels[0] if len(labels) == 1 else name
            scene.mask(anatomy.mask(*labels), anatomy.affine, style, opacity=opacity)
    return scene


def tool_meshes(tool: SphereTool | ShaftTool, length: float = 45.0) -> list[pv.PolyData]:
    """The tip and the capsules behind it, in the tool's frame; drawn up to `length` mm from the tip."""
    meshes = []
    for n, row in enumerate(tool.bodies):
        start, end, radius = row[:3], row[3:6].copy(), max(row[6], 0.05)
        end[2] = min(end[2], length)
        if start[2] > length:
            continue
        ball = pv.Sphere(radius=radius, center=start, theta_resolution=32, phi_resolution=32)
        if n > 0 and end[2] > start[2]:
            other = pv.Sphere(radius=radius, center=end, theta_resolution=32, phi_resolution=32)
            barrel = pv.Line(start, end).tube(radius=radius, n_sides=32)
            ball = pv.merge([ball, barrel, other]).extract_surface(algorithm="dataset_surface")
        meshes.append(ball)
    return meshes


def matrix_of(pose: np.ndarray) -> np.ndarray:
    """(4, 4) tool frame in the mesh's frame of a pose."""
    out = np.eye(4)
    out[:3, 3] = pose[:3]
    if len(pose) == 6:
        out[:3, :3] = Rotation.from_rotvec(pose[3:]).as_matrix()
    return out


def add_tool(
    scene: Scene, tool: SphereTool | ShaftTool, pose: np.ndarray, status: str = "", opacity: float = 1.0
) -> Scene:
    """A tool at a pose, its tip in the colour of a status."""
    for n, mesh in enumerate(tool_meshes(tool)):
        placed = mesh.transform(matrix_of(pose), inplace=False)
        style = {"colour": STATUS[status]} if n == 0 and status else {}
        scene.mesh(placed, "shaft" if n else "burr", opacity=opacity, title="" if status else None, **style)
    return scene


def add_track(scene: Scene, track: Track, radius: float = 0.16) -> Scene:
    """The hand's path and the tool's, the latter coloured by status."""
    scene.path(track.hand, radius=0.6 * radius, colour=HAND, title="where the hand wants the tip")
    points = np.asarray(track.poses)[:, :3]
    colours = np.array([STATUS[name] for name in track.status])
    steps = np.flatnonzero(np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)
    for colour in dict.fromkeys(STATUS.values()):
        # a step has the colour of the pose that it leads to; one mesh a colour, however often it changes
        mine = steps[colours[steps + 1] == colour]
        if len(mine):
            cuts = np.flatnonzero(np.diff(mine) > 1) + 1
            runs = [np.r_[run, run[-1] + 1] for run in np.split(mine, cuts)]
            cells = np.concatenate([np.r_[len(run), run] for run in runs])
            tube = pv.PolyData(points, lines=cells).tube(radius=radius, n_sides=6, capping=True)
            scene.mesh(tube, "path", colour=colour, title="")
    return scene


def status_patches(track: Track) -> list[Patch]:
    """Legend entries of the statuses that occur."""
    return [
        Patch(facecolor=STATUS[name], edgecolor="#555555", linewidth=0.5, label=f"tool: {name}")
        for name in STATUS
        if name in set(track.status)
    ]


def guided_scene(anatomy: LabelVolume, track: Track, view: View, at: int = -1) -> Scene:
    """Bone, paths, and the tool at one of its poses: for `study.rendering.show` too."""
    scene = bone_scene(anatomy, view)
    add_track(scene, track)
    return add_tool(scene, track.tool, track.poses[at], track.status[at])


def guided_figure(
    anatomy: LabelVolume, track: Track, views: Mapping[str, View], at: int = -1, half_height: float = 17.0
) -> Figure:
    """The same from several sides.

    Parameters
    ----------
    anatomy : LabelVolume
    track : Track
    views : mapping of str to View
        Title -> where to look from; centred between the places of the hand.
    at : int
        Which pose the tool is drawn at.
    half_height : float
        mm.
    """
    centre = 0.5 * (track.hand.min(axis=0) + track.hand.max(axis=0))
    scenes = [guided_scene(anatomy, track, view.around(centre, half_height), at) for view in views.values()]
    return panels(scenes, list(views), columns=len(scenes), width=13.0, extra=status_patches(track))


def animate(
    anatomy: LabelVolume,
    track: Track,
    view: View,
    path: str | os.PathLike[str],
    frames: int = 40,
    size: Sequence[int] = (480, 360),
    frame_ms: int = 90,
) -> None:
    """Write an animation (GIF) of the tool on its way, whole or not at all.

    Parameters
    ----------
    anatomy : LabelVolume
    track : Track
        With a place of the hand for each pose: it is drawn as a small ball.
    view : View
        With centre and half height, which do not move.
    path : path-like
        Ending in ``.gif``. The same track gives the same bytes on the same machine.
    frames : int
        Evenly spaced over the track.
    size : (2,) ints
        Pixels.
    frame_ms : int
        How long each is shown.

    Raises
    ------
    InputError
        If the hand has not as many rows as the poses, or there are fewer than two frames.
    """
    from PIL import Image

    if len(track.hand) != len(track.poses) or frames < 2:
        raise InputError(
            f"expected at least two frames and a place of the hand for each of {len(track.poses)} poses, "
            f"got {frames} and {len(track.hand)}"
        )
    rows = np.unique(np.linspace(0, len(track.poses) - 1, frames).round().astype(int))
    pictures = []
    with off_screen(size) as plotter, _quiet_about_displays():
        # one rendering a frame: each costs a tenth of a second or more without a graphics card
        plotter.suppress_rendering = True
        bone_scene(anatomy, view, veiled={name: VEILED[name] for name in VEILED if name != "dura"})(plotter)
        still = set(plotter.actors)
        for row in rows:
            for name in set(plotter.actors) - still:
                plotter.remove_actor(name, render=False)
            upto = slice(0, max(row + 1, 2))
            part = Track(track.poses[upto], track.status[upto], track.hand[upto], track.tool)
            scene = add_track(Scene(view), part)
            add_tool(scene, track.tool, track.poses[row], track.status[row])
            scene.mesh(pv.Sphere(radius=0.45, center=track.hand[row]), "path", colour=HAND, title="")
            scene(plotter)
            plotter.suppress_rendering = False
            plotter.render()
            pictures.append(Image.fromarray(np.array(plotter.screenshot(return_img=True))))
            plotter.suppress_rendering = True
    # one palette for all frames, or colours would flicker
    mosaic = Image.fromarray(np.concatenate([np.asarray(p)[::3, ::3] for p in pictures]))
    palette = mosaic.quantize(255, method=Image.Quantize.MEDIANCUT)
    indexed = [p.quantize(palette=palette, dither=Image.Dither.NONE) for p in pictures]
    with written_whole(path) as temporary:
        indexed[0].save(
            temporary, save_all=True, append_images=indexed[1:], duration=frame_ms, loop=0, optimize=False
        )


def tilt_figure(
    wall: MeshFixture, anatomy: LabelVolume, tool: ShaftTool, poses: Mapping[str, np.ndarray], view: View
) -> Figure:
    """Feature 3: a drill in a milled cavity that is cut open through the tip, one panel a controller.

    Parameters
    ----------
    wall : MeshFixture
        What is left of the bone.
    anatomy : LabelVolume
    tool : ShaftTool
    poses : mapping of str to (6,) array
        Title -> where the tool is.
    view : View
        Across the plane in which the drill was tilted.
    """
    scenes = []
    for pose in poses.values():
        scene = Scene(view.around(pose[:3] + 4.0 * np.array([0, 0, 1.0]) * np.sign(view.up[2]), 19.0))
        half = fixture_body(wall).clip_closed_surface(normal=view.looking, origin=pose[:3])
        scene.mesh(half, "bone", smooth_shading=False)
        for name in SOLID[:3]:
            labels = labels_of(anatomy, name)
            if labels:
                scene.mask(anatomy.mask(*labels), anatomy.affine, name)
        add_tool(scene, tool, pose)
        scenes.append(scene)
    return panels(scenes, list(poses), columns=len(scenes), width=13.0)
