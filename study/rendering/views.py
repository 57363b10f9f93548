"""Where the camera stands: the surgeon's view from the side, along the approach, around a point."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from study.errors import InputError

#: Letters at the ends of the LPS axes: negative, positive.
LETTERS = (("R", "L"), ("A", "P"), ("I", "S"))


@dataclass(frozen=True, eq=False)
class View:
    """A camera with parallel projection, so that a scale bar holds anywhere in the picture.

    Parameters
    ----------
    looking : (3,) array
        Direction of view in the mm frame.
    up : (3,) array
        Direction that is up in the picture; made perpendicular to `looking`.
    centre : (3,) array, optional
        mm, the middle of the picture; that of the scene by default.
    half_height : float
        mm from the middle to the upper edge; 0 fits the scene.

    Raises
    ------
    InputError
        If the directions are parallel or not finite.
    """

    looking: np.ndarray
    up: np.ndarray
    centre: np.ndarray | None = None
    half_height: float = 0.0

    def __post_init__(self) -> None:
        looking, up = np.asarray(self.looking, float), np.asarray(self.up, float)
        if looking.shape != (3,) or up.shape != (3,) or not np.isfinite([looking, up]).all():
            raise InputError(f"View: expected two finite (3,) directions, got {self.looking}, {self.up}")
        length = np.linalg.norm(looking)
        looking = looking / length if length else looking
        up = up - (up @ looking) * looking
        if not length or np.linalg.norm(up) < 1e-6:
            raise InputError(
                f"View: expected directions that are not parallel, got {self.looking}, {self.up}"
            )
        object.__setattr__(self, "looking", looking)
        object.__setattr__(self, "up", up / np.linalg.norm(up))

    @property
    def right(self) -> np.ndarray:
        """(3,) unit vector that points right in the picture."""
        return np.cross(self.looking, self.up)

    def turned(self, right_deg: float = 0.0, up_deg: float = 0.0) -> View:
        """The view after the camera has walked around the scene to its right and upwards."""
        a, b = np.deg2rad(right_deg), np.deg2rad(up_deg)
        looking = np.cos(a) * self.looking - np.sin(a) * self.right
        looking = np.cos(b) * looking - np.sin(b) * self.up
        return replace(self, looking=looking)

    def around(self, centre: np.ndarray, half_height: float) -> View:
        """The same direction, another middle and size."""
        return replace(self, centre=np.asarray(centre, float), half_height=float(half_height))

    def compass(self) -> list[tuple[str, str, np.ndarray]]:
        """Letters and in-picture direction (right, up) of the body axes that do not point at the viewer."""
        out = []
        for axis, (negative, positive) in enumerate(LETTERS):
            unit = np.eye(3)[axis]
            flat = np.array([unit @ self.right, unit @ self.up])
            if np.linalg.norm(flat) > 0.5:
                out.append((negative, positive, flat))
        return out


def approach_view(approach: np.ndarray, *, oblique: bool = False) -> View:
    """Look along the approach, as the surgeon does; superior is up (posterior, if that is the approach).

    Parameters
    ----------
    approach : (3,) array
        Unit vector in mm, outside -> bone.
    oblique : bool
        From a little above and behind, so that a cavity shows its depth.
    """
    approach = np.asarray(approach, float)
    along = abs(approach[2]) / max(float(np.linalg.norm(approach)), 1e-12)
    view = View(approach, [0.0, 0.0, 1.0] if along < 0.9 else [0.0, -1.0, 0.0])
    behind = 1.0 if view.right[1] >= 0 else -1.0
    return view.turned(18 * behind, 14) if oblique else view


def side_view(approach: np.ndarray) -> View:
    """Across the approach, outside on top: the view in which burr and shaft stand upright."""
    approach = np.asarray(approach, float)
    up = -approach / np.linalg.norm(approach)
    across = np.array([0.0, 0.0, 1.0]) if abs(up[2]) < 0.9 else np.array([0.0, 1.0, 0.0])
    return View(across - (across @ up) * up, up)


def posterior_on_right(approach: np.ndarray) -> float:
    """1 if posterior is on the right of the view along the approach, else -1."""
    return 1.0 if approach_view(approach).right[1] >= 0 else -1.0
