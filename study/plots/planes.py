"""Any plane through volumes, sampled in mm: grids of several voxel sizes and oblique cuts in one picture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.patheffects import withStroke

from study.errors import InputError
from study.volumes import LabelVolume

_HALO = [withStroke(linewidth=2.5, foreground="white")]
#: Ends of the LPS axes: negative, positive.
_ENDS = (("R", "L"), ("A", "P"), ("I", "S"))


@dataclass(frozen=True, eq=False)
class Plane:
    """A rectangle in the mm frame.

    Parameters
    ----------
    centre : (3,) mm
    right, down : (3,) arrays
        Perpendicular unit vectors along the picture's rows and columns.
    half_width, half_height : float
        mm.
    pixels : int
        Along the longer side.
    """

    centre: np.ndarray
    right: np.ndarray
    down: np.ndarray
    half_width: float
    half_height: float
    pixels: int = 500

    def __post_init__(self) -> None:
        axes = np.array([self.right, self.down], float)
        if not np.allclose(axes @ axes.T, np.eye(2), atol=1e-6):
            raise InputError(f"Plane: expected perpendicular unit vectors, got {axes.tolist()}")

    @property
    def normal(self) -> np.ndarray:
        """(3,) unit vector towards the viewer."""
        return np.cross(self.down, self.right)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """For `Axes.imshow`: left, right, bottom, top in mm from the centre."""
        return (-self.half_width, self.half_width, self.half_height, -self.half_height)

    @cached_property
    def points(self) -> np.ndarray:
        """(n, m, 3) mm of the pixels."""
        step = 2 * max(self.half_width, self.half_height) / self.pixels
        x = np.arange(-self.half_width + step / 2, self.half_width, step)
        y = np.arange(-self.half_height + step / 2, self.half_height, step)
        flat = x[None, :, None] * np.asarray(self.right) + y[:, None, None] * np.asarray(self.down)
        return flat + np.asarray(self.centre)

    def of(self, volume: LabelVolume, array: np.ndarray) -> np.ndarray:
        """(n, m) values of a volume-shaped array at the pixels, 0 beyond the volume."""
        key = (volume.shape, volume.affine.tobytes())
        if key not in self._indices:
            self._indices[key] = _indices(volume, self.points)
        return _taken(array, *self._indices[key]).reshape(self.points.shape[:2])

    @cached_property
    def _indices(self) -> dict:
        """Voxels at the pixels, for every grid that was asked for."""
        return {}

    def place(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) mm right, down and towards the viewer of (n, 3) points."""
        return (np.asarray(points, float) - self.centre) @ np.array([self.right, self.down, self.normal]).T

    def show(
        self, axes: Axes, layers, title: str = "", background: str = "#ffffff", sides: bool = True
    ) -> None:
        """Draw layers, (n, m) masks with a colour and an opacity, one over the other, and name the sides.

        Parameters
        ----------
        axes : Axes
        layers : iterable of (mask, colour, opacity)
        title : str
        background : str
        sides : bool
            Name the sides of the body.
        """
        image = np.ones((*self.points.shape[:2], 3)) * to_rgb(background)
        for mask, colour, opacity in layers:
            image[mask] = (1 - opacity) * image[mask] + opacity * np.array(to_rgb(colour))
        axes.imshow(image, extent=self.extent, interpolation="nearest")
        self.frame(axes, title, sides)

    def frame(self, axes: Axes, title: str = "", sides: bool = True) -> None:
        """Limits, labels and the letters of the sides of axes in which the plane is drawn."""
        left, right, bottom, top = self.extent
        axes.set(xlim=(left, right), ylim=(bottom, top), xlabel="mm", ylabel="mm", title=title)
        axes.set_aspect("equal")
        up, right = (side_name(direction) for direction in (-np.asarray(self.down), self.right))
        text = "   ".join(arrow + name for arrow, name in (("↑ ", up), ("→ ", right)) if name and sides)
        axes.text(0.03, 0.975, text, transform=axes.transAxes, fontsize=8.5, va="top", path_effects=_HALO)


def look_up(volume: LabelVolume, array: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(...) values of a volume-shaped array at (..., 3) mm, 0 beyond the volume."""
    return _taken(array, *_indices(volume, points)).reshape(points.shape[:-1])


def _indices(volume: LabelVolume, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    index = np.floor(volume.indices(points.reshape(-1, 3)) + 0.5).astype(int)
    within = ((index >= 0) & (index < volume.shape)).all(axis=1)
    return np.ravel_multi_index(tuple(index[within].T), volume.shape), within


def _taken(array: np.ndarray, flat: np.ndarray, within: np.ndarray) -> np.ndarray:
    out = np.zeros(len(within), array.dtype)
    out[within] = np.take(array, flat)
    return out


def side_name(direction: np.ndarray) -> str:
    """The letter of the side of the body a direction points at, within 30 degrees; nothing if none."""
    axis = int(np.argmax(np.abs(direction)))
    if abs(direction[axis]) < np.cos(np.pi / 6):
        return ""
    return _ENDS[axis][int(direction[axis] > 0)]


def axial(
    centre: np.ndarray, approach: np.ndarray, half_width: float, half_height: float = 0.0, pixels: int = 500
) -> Plane:
    """Across the body's long axis: outside on top, posterior on the right.

    Parameters
    ----------
    centre : (3,) mm
    approach : (3,) array
        Outside -> bone.
    half_width, half_height : float
        mm; square if the second is 0.
    pixels : int
        Along the longer side.
    """
    return _upright(centre, approach, np.array([0.0, 1.0, 0.0]), half_width, half_height, pixels)


def coronal(
    centre: np.ndarray, approach: np.ndarray, half_width: float, half_height: float = 0.0, pixels: int = 500
) -> Plane:
    """Across the direction of view: outside on top, superior on the right."""
    return _upright(centre, approach, np.array([0.0, 0.0, 1.0]), half_width, half_height, pixels)


def _upright(centre, approach, right, half_width, half_height, pixels) -> Plane:
    down = np.asarray(approach, float) / np.linalg.norm(approach)
    right = right - (right @ down) * down
    if np.linalg.norm(right) < 0.3:
        raise InputError(f"approach: expected a direction across this plane's columns, got {approach}")
    right = right / np.linalg.norm(right)
    return Plane(np.asarray(centre, float), right, down, half_width, half_height or half_width, pixels)
