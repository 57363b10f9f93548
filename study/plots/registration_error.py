"""What registration error does to distances, and how it varies over the bone: figure 3.5 and a map."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke

from study.margins import SafetyMargin
from study.margins.illustration import NearestPoints
from study.margins.point_risk import point_damage_risk
from study.plots.palette import STYLES, style_of
from study.plots.planes import Plane, axial, coronal, look_up
from study.plots.style import legend_below, new_axes, patches, styled
from study.registration import PointRegistration
from study.volumes import LabelVolume

_DARK = [withStroke(linewidth=3.5, foreground="#37476b")]
NAIVE, TRUE = "#b3261e", "#0055a4"


def plane_through(nearest: NearestPoints, approach: np.ndarray, half: float) -> Plane:
    """The plane of a voxel's centre and its two nearest points, the approach downwards as far as may be."""
    first, second = nearest.mahalanobis - nearest.voxel, nearest.euclidean - nearest.voxel
    normal = np.cross(first, second)
    if np.linalg.norm(normal) < 1e-6 * np.linalg.norm(first) * np.linalg.norm(second):
        # One line: any plane with the longest axis of the error.
        normal = np.cross(first, np.linalg.eigh(nearest.covariance)[1][:, 2])
    normal = normal / np.linalg.norm(normal)
    down = approach - (approach @ normal) * normal
    if np.linalg.norm(down) < 0.1:
        down = first - (first @ normal) * normal
    down = down / np.linalg.norm(down)
    right = np.cross(down, normal)
    if right[np.argmax(np.abs(right))] < 0:
        right = -right
    return Plane(nearest.voxel, right, down, half, half)


@styled()
def two_distances(margin: SafetyMargin, nearest: NearestPoints, approach: np.ndarray) -> Figure:
    """Figure 3.5: the nearest point in mm and in standard deviations, in the bone and whitened.

    Parameters
    ----------
    margin : SafetyMargin
    nearest : NearestPoints
        From `study.margins.illustration.telling_voxel`.
    approach : (3,) array
        Outside -> bone.
    """
    points = {NAIVE: nearest.euclidean, TRUE: nearest.mahalanobis}
    half = 1.7 * max(nearest.millimetres(p) for p in points.values())
    plane = plane_through(nearest, np.asarray(approach, float), half)
    axes_in_space = np.array([plane.right, plane.down])
    inside = axes_in_space @ np.linalg.solve(nearest.covariance, axes_in_space.T)
    weights, vectors = np.linalg.eigh(inside)
    whiten = vectors @ np.diag(np.sqrt(weights)) @ vectors.T
    reach = 1.7 * max(nearest.deviations(p) for p in points.values())
    figure, axes = new_axes(1, 2, (11, 5.9))
    volume = margin.volume
    layers = [(margin.mask, STYLES["margin"].colour, 0.6),
              (margin.structure_mask, style_of(margin.structure).colour, 1.0)]  # fmt: skip
    left, right = axes[0]
    title = "(a) in the bone, mm"
    plane.show(left, [(plane.of(volume, mask), colour, opacity) for mask, colour, opacity in layers], title)
    left.set(xlabel="mm from the voxel's centre", ylabel="mm from the voxel's centre")
    flat = np.linspace(-reach, reach, plane.pixels)
    grid = np.stack(np.meshgrid(flat, flat), axis=-1) @ np.linalg.inv(whiten).T
    image_plane = _Whitened(plane, grid @ axes_in_space + plane.centre, reach)
    image_plane.show(right, volume, layers)
    deviations = nearest.deviations(nearest.mahalanobis)
    turn = np.linspace(0, 2 * np.pi, 200)
    ring = deviations * np.array([np.cos(turn), np.sin(turn)])
    in_mm = np.linalg.inv(whiten) @ ring
    unit = in_mm / deviations
    left.plot(*in_mm, color=TRUE, lw=1.6)
    left.plot(*unit, color="black", lw=1.0, ls="--")
    right.plot(*ring, color=TRUE, lw=1.6)
    right.plot(*ring / deviations, color="black", lw=1.0, ls="--")
    radius = nearest.millimetres(nearest.euclidean)
    circle = radius * np.array([np.cos(turn), np.sin(turn)])
    left.plot(*circle, color=NAIVE, lw=1.2, ls=":")
    right.plot(*whiten @ circle, color=NAIVE, lw=1.2, ls=":")
    for colour, point in points.items():
        at = plane.place(point[None])[0, :2]
        for ax, end in ((left, at), (right, whiten @ at)):
            ax.plot(*np.stack([np.zeros(2), end], axis=1), color=colour, lw=2)
            ax.plot(*end, "o", color=colour, ms=6, mec="white", mew=0.7, zorder=4)
    for ax in (left, right):
        ax.plot(0, 0, "s", color="black", ms=6, zorder=5)
    handles = [
        *patches(margin.structure, "margin"),
        Line2D([], [], marker="s", ls="", color="black", ms=6, label="voxel in question"),
        Line2D([], [], color="black", lw=1.0, ls="--", label="one standard deviation"),
    ]
    for colour, name, point in ((NAIVE, "nearest in mm", nearest.euclidean),
                                (TRUE, "nearest in deviations", nearest.mahalanobis)):  # fmt: skip
        d = nearest.deviations(point)
        text = f"{name}: {nearest.millimetres(point):.2f} mm, {d:.2f} SD, risk {point_damage_risk(d):.1e}"
        handles.append(Line2D([], [], color=colour, lw=2, marker="o", mec="white", label=text))
    legend_below(figure, handles, 2)
    return figure


class _Whitened:
    """A plane sampled in standard deviations instead of mm."""

    def __init__(self, plane: Plane, points: np.ndarray, reach: float):
        self.plane, self.points, self.reach = plane, points, reach

    def show(self, axes: Axes, volume: LabelVolume, layers) -> None:
        image = np.ones((*self.points.shape[:2], 3))
        for mask, colour, opacity in layers:
            inside = look_up(volume, mask, self.points)
            rgb = np.array([int(colour[n : n + 2], 16) / 255 for n in (1, 3, 5)])
            image[inside] = (1 - opacity) * image[inside] + opacity * rgb
        reach = self.reach
        axes.imshow(image, extent=(-reach, reach, reach, -reach), interpolation="nearest")
        axes.set(title="(b) whitened, standard deviations", xlabel="SD from the voxel's centre")
        axes.set_ylabel("SD from the voxel's centre")


@styled()
def error_map(
    model: PointRegistration, volume: LabelVolume, planning: LabelVolume, approach: np.ndarray
) -> Figure:
    """Root mean squared target registration error over the bone, in two planes through the target.

    Parameters
    ----------
    model : PointRegistration
    volume : LabelVolume
        Anatomy.
    planning : LabelVolume
    approach : (3,) array
        Outside -> bone.
    """
    approach = np.asarray(approach, float)
    middle = planning.points(np.argwhere(planning.mask("target"))).mean(axis=0)
    fiducials = np.asarray(model.fiducials)
    corners = volume.points(np.array([[0, 0, 0], np.array(volume.shape) - 1], float))
    shown = np.concatenate([fiducials, corners])
    figure, axes = new_axes(1, 2, (12, 6.2))
    planes = []
    for build in (axial, coronal):
        plane = build(middle, approach, 10.0)
        place = plane.place(shown)
        low, high = place.min(axis=0)[:2] - 3, place.max(axis=0)[:2] + 3
        centre = middle + plane.right * (low[0] + high[0]) / 2 + plane.down * (low[1] + high[1]) / 2
        planes.append(build(centre, approach, (high[0] - low[0]) / 2, (high[1] - low[1]) / 2, 250))
    rms = [model.tre_rms(plane.points.reshape(-1, 3)).reshape(plane.points.shape[:2]) for plane in planes]
    levels = _levels(min(r.min() for r in rms), max(r.max() for r in rms))
    for ax, plane, values, title in zip(
        axes[0], planes, rms, ("(a) axial plane through the target", "(b) coronal plane"), strict=True
    ):
        drawn = ax.imshow(
            values,
            extent=plane.extent,
            cmap="cividis",
            vmin=levels[0],
            vmax=levels[-1],
            interpolation="nearest",
        )
        solid = plane.of(volume, ~volume.mask("air")) if "air" in volume.names else None
        for mask, colour, width in (
            (solid, "white", 1.0),
            (plane.of(planning, planning.mask("target")), STYLES["target"].colour, 1.8),
        ):
            if mask is not None and mask.any():
                ax.contour(*_pixels(plane), mask.astype(float), [0.5], colors=[colour], linewidths=width)
        lines = ax.contour(*_pixels(plane), values, levels, colors="black", linewidths=0.8)
        ax.clabel(lines, fmt="%.2g", fontsize=8)
        place = plane.place(fiducials)
        ax.plot(*place[:, :2].T, "o", ms=7, mfc="#23262b", mec="white", mew=1.0)
        plane.frame(ax, title)
    figure.colorbar(drawn, ax=axes[0].tolist(), label="target registration error, rms (mm)", shrink=0.8)
    handles = [
        Line2D([], [], color="white", lw=1.4, label="outline of the bone", path_effects=_DARK),
        Line2D([], [], color=STYLES["target"].colour, lw=2, label="targeted bone"),
        Line2D([], [], marker="o", ls="", ms=7, mfc="#23262b", mec="white", label="fiducials, projected"),
    ]
    legend_below(figure, handles, 3)
    return figure


def _levels(low: float, high: float) -> np.ndarray:
    step = 0.05 if high - low < 0.5 else 0.1
    return np.arange(np.floor(low / step), np.ceil(high / step) + 1) * step


def _pixels(plane: Plane) -> tuple[np.ndarray, np.ndarray]:
    n, m = plane.points.shape[:2]
    left, right, bottom, top = plane.extent
    return left + (np.arange(m) + 0.5) * (right - left) / m, top + (np.arange(n) + 0.5) * (bottom - top) / n
