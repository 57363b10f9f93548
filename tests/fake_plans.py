"""Plans without a planner: walks on a voxel grid with the attributes a robot reads."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np

from study.volumes import LabelVolume


@dataclass(frozen=True, eq=False)
class FakePlan:
    points: np.ndarray
    axes: np.ndarray
    removed: np.ndarray
    modified: SimpleNamespace
    rotation_axis: int = 0
    approach: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, -1.0]))
    dof: int = 4


def tilted(volume: LabelVolume, tilt: np.ndarray) -> np.ndarray:
    """Drill axes turned by `tilt` about grid axis 0 from grid axis 2."""
    directions = volume.directions
    side = np.cross(directions[:, 0], directions[:, 2])
    return np.cos(tilt)[:, None] * directions[:, 2] + np.sin(tilt)[:, None] * side


def fake_plan(voxels, labels=None, spacing=0.4, removed=None, tilt=None, burr_radius=2.5, affine=None):
    """A plan that visits `voxels` (n, 3); all air unless `labels` are given."""
    voxels = np.asarray(voxels)
    if labels is None:
        labels = np.zeros(np.maximum(voxels.max(axis=0) + 12, 24), np.uint8)
    if affine is None:
        affine = np.diag([*np.broadcast_to(np.asarray(spacing, float), 3), 1.0])
        affine[:3, 3] = [-7.0, 3.0, 11.0]
    volume = LabelVolume(labels, affine, {"air": 0, "protected": 1, "target": 2})
    modified = SimpleNamespace(volume=volume, burr_radius=burr_radius)
    tilt = np.zeros(len(voxels)) if tilt is None else np.asarray(tilt, float)
    removed = np.zeros(len(voxels)) if removed is None else np.asarray(removed, float)
    return FakePlan(
        volume.points(voxels.astype(float)),
        tilted(volume, tilt),
        removed,
        modified,
        approach=-volume.directions[:, 2],
    )


def random_walk(rng, steps, size=40, diagonal=False):
    """Voxels of a walk with straight runs and turns, inside a cube, one step at a time."""
    moves = np.vstack([np.eye(3, dtype=int), -np.eye(3, dtype=int)])
    if diagonal:
        moves = np.array([m for m in np.ndindex(3, 3, 3) if m != (1, 1, 1)]) - 1
    at, out, move = np.full(3, size // 2), [], moves[0]
    for _ in range(steps):
        out.append(at)
        if rng.random() < 0.5:
            move = moves[rng.integers(len(moves))]
        if ((at + move < 12) | (at + move >= size - 12)).any():
            move = -move
        at = at + move
    return np.array(out)
