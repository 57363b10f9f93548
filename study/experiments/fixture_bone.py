"""A temporal bone as virtual fixtures, a hand that reaches for every structure, and what a tool kept."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from study.fixtures import MeshFixture, ShaftTool, Slack, moved
from study.fixtures.hands import Hand
from study.fixtures.mesh import FixtureMesh, checked_mesh
from study.fixtures.simulation import Run
from study.specimens import Specimen
from study.specimens.structures import labels_of
from study.tables import Claim
from study.volumes import LabelVolume, surface

#: Structures of a mastoidectomy that no tool may touch, and what is kept from them, mm.
GUARDED = {
    "facial_nerve": 0.5,
    "labyrinth": 0.3,
    "external_auditory_canal": 0.3,
    "sigmoid_sinus": 0.3,
    "dura": 0.3,
}
_SMOOTH_MM = 0.3  # hides the voxels' steps; what it shrinks a nerve by is less than what is kept from it


def guard(
    anatomy: LabelVolume, structure: str, clearance_mm: float = 0.0, slack: Slack | None = None
) -> MeshFixture:
    """A structure of a segmented bone as a fixture."""
    mesh = surface(anatomy, labels_of(anatomy, structure), smooth_mm=_SMOOTH_MM)
    return MeshFixture(checked_mesh(mesh, structure), clearance_mm=clearance_mm, slack=slack)


def guards(anatomy: LabelVolume, clearances: Mapping[str, float] | None = None) -> list[MeshFixture]:
    """All structures that a bone has of those to be guarded."""
    clearances = GUARDED if clearances is None else clearances
    return [
        guard(anatomy, name, clearance) for name, clearance in clearances.items() if labels_of(anatomy, name)
    ]


@lru_cache(maxsize=2)
def _cavity_mesh(bone: Specimen) -> FixtureMesh:
    solid = ~(bone.planning.mask("air") | bone.planning.mask("target"))
    volume = bone.planning.with_labels(solid.astype(np.uint8), {"air": 0, "bone": 1})
    return checked_mesh(surface(volume, "bone", smooth_mm=_SMOOTH_MM), "bone")


def cavity(bone: Specimen, slack: Slack | None = None) -> MeshFixture:
    """What is left of a bone whose target has been milled: all that is neither air nor target."""
    return MeshFixture(_cavity_mesh(bone), slack=slack)


def middle(bone: Specimen, deep: float = 0.5) -> np.ndarray:
    """(3,) mm; the middle of the target's section at a depth, 0 its outermost and 1 its innermost."""
    points = bone.planning.points(np.argwhere(bone.planning.mask("target")))
    along = points @ bone.approach
    level = along.min() + deep * np.ptp(along)
    return points[np.abs(along - level) < bone.planning.spacing.max()].mean(axis=0)


def outside(bone: Specimen, away_mm: float = 6.0) -> np.ndarray:
    """(3,) mm in the air before the target."""
    start = middle(bone, 0.2)
    points = bone.planning.points(np.argwhere(bone.planning.mask("target")))
    return start + ((points @ bone.approach).min() - start @ bone.approach - away_mm) * bone.approach


def upright_pose(bone: Specimen) -> np.ndarray:
    """(3,) rotation vector of a drill that is held along the approach, its body outside."""
    turn, _ = Rotation.align_vectors(-bone.approach[None], [[0.0, 0.0, 1.0]])
    return turn.as_rotvec()


def turned(rotation: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """A rotation vector after a turn about the mesh's axes."""
    return (Rotation.from_rotvec(turn) * Rotation.from_rotvec(rotation)).as_rotvec()


def offset(goal: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """The motion from one pose to another, see `study.fixtures.moved`."""
    apart = np.asarray(goal, dtype=float) - pose
    if len(pose) == 6:
        turn = Rotation.from_rotvec(goal[3:]) * Rotation.from_rotvec(pose[3:]).inv()
        apart[3:] = turn.as_rotvec()
    return apart


def nearest_of(anatomy: LabelVolume, structure: str, point: np.ndarray) -> np.ndarray:
    """(3,) mm, the voxel of a structure nearest to a point."""
    voxels = anatomy.points(np.argwhere(anatomy.mask(*labels_of(anatomy, structure))))
    return voxels[np.argmin(np.linalg.norm(voxels - point, axis=1))]


def reaching_waypoints(bone: Specimen, structures: Iterable[str], too_far_mm: float = 2.0) -> np.ndarray:
    """(n, 3) mm: from outside into the target, then for each structure too far and back.

    Parameters
    ----------
    bone : Specimen
    structures : iterable of str
        Those that the bone does not have are passed over.
    too_far_mm : float
        How far beyond a structure's nearest voxel the hand means to go.
    """
    home = middle(bone, 0.5)
    way = [outside(bone), home]
    for name in structures:
        if labels_of(bone.anatomy, name):
            found = nearest_of(bone.anatomy, name, home)
            way += [found + too_far_mm * (found - home) / np.linalg.norm(found - home), home]
    return np.array([*way, way[0]])


def unguided(hand: Hand, start: np.ndarray, seconds: float, cycle_s: float = 1 / 200) -> np.ndarray:
    """(n + 1, 3 or 6) poses of a tool that does whatever the hand asks."""
    pose, poses = np.asarray(start, dtype=float), [np.asarray(start, dtype=float)]
    for k in range(round(seconds / cycle_s)):
        pose = moved(pose, np.asarray(hand.desired(k * cycle_s, pose)) * cycle_s)
        poses.append(pose)
    return np.array(poses)


def signed_distances(fixture: MeshFixture, points: np.ndarray) -> np.ndarray:
    """(n,) mm to a closed surface, negative inside, by the index's search and a ray's parity."""
    points = np.asarray(points, dtype=float)
    distances = fixture.distances(points)
    return np.array([-d if fixture.index.inside(p) else d for d, p in zip(distances, points, strict=True)])


def tip_gaps(fixtures: Sequence[MeshFixture], points: np.ndarray, radius: float) -> pd.DataFrame:
    """Distance of a ball's surface to each fixture, mm, one row a place; negative where it is entered."""
    return pd.DataFrame({f.name: signed_distances(f, points) - radius for f in fixtures})


def shaft_gap(fixture: MeshFixture, tool: ShaftTool, pose: np.ndarray, pitch_mm: float = 0.1) -> float:
    """Least distance of a shaft's surface to a fixture, mm, from samples of its axis; negative inside.

    Too large by no more than ``pitch_mm**2 / (8 distance)``, and not below minus the radius minus how deep
    the axis itself is inside.
    """
    turn = Rotation.from_rotvec(pose[3:]).as_matrix()
    least = np.inf
    for row in tool.bodies[1:]:
        start, end = row[:3] @ turn.T + pose[:3], row[3:6] @ turn.T + pose[:3]
        n = int(np.ceil(np.linalg.norm(end - start) / pitch_mm)) + 1
        axis = np.linspace(start, end, n)
        least = min(least, float((signed_distances(fixture, axis) - row[6]).min()))
    return least


def summary_table(gaps: Mapping[str, pd.DataFrame], clearances: Mapping[str, float]) -> pd.DataFrame:
    """How near the tip came to each structure, with and without fixture.

    Parameters
    ----------
    gaps : mapping of str to pandas.DataFrame
        Title -> `tip_gaps`.
    clearances : mapping of str to float
        What was to be kept from each structure.
    """
    rows = []
    for title, table in gaps.items():
        for name in table:
            values = table[name].to_numpy()
            rows.append(
                {
                    "tool": title,
                    "structure": name,
                    "to_be_kept_mm": clearances[name],
                    "least_mm": values.min(),
                    "1_pct_mm": np.quantile(values, 0.01),
                    "time_inside_pct": 100 * (values < 0).mean(),
                }
            )
    return pd.DataFrame(rows)


def status_table(run: Run) -> pd.DataFrame:
    """One row a status: share of cycles, quantiles of the clearance, and planes."""
    rows = []
    for status, part in run.log.groupby("status", sort=True):
        seen = part["clearance_mm"].to_numpy()
        near = seen[np.isfinite(seen)]
        rows.append(
            {
                "status": status,
                "cycles": len(part),
                "share_pct": 100 * len(part) / len(run.log),
                "least_clearance_mm": near.min() if len(near) else np.nan,
                "median_clearance_mm": np.median(near) if len(near) else np.nan,
                "most_planes": int(part["planes"].max()),
            }
        )
    return pd.DataFrame(rows)


def compute_times(run: Run) -> pd.Series:
    """Quantiles of what a cycle's computation took, µs: of this machine on this day, for no file."""
    return run.log["compute_us"].quantile([0.5, 0.99, 1.0]).rename("µs").rename_axis("quantile")


def simulation_claims(run: Run, near: pd.DataFrame) -> list[Claim]:
    """What a fixture promises in a simulated operation, and that the hand put it to the test."""
    guided = near[near["tool"] == "with fixtures"]
    free = near[near["tool"] == "without"]
    least = float((guided["least_mm"] - guided["to_be_kept_mm"]).min())
    stopped = float((~run.log["status"].isin(["free", "constrained"])).mean())
    return [
        Claim("without fixtures the burr enters structures", bool((free["least_mm"] < 0).any()),
              f"{int((free['least_mm'] < 0).sum())} of {len(free)} structures, "
              f"{-float(free['least_mm'].min()):.2f} mm deep", "measured"),
        Claim("with fixtures it keeps its distance to all, within 1 µm", least >= -1e-3,
              f"least distance beyond what is kept {1e3 * least:.3f} µm", "measured"),
        Claim("and is not stopped for it", stopped == 0.0, f"{100 * stopped:.2f} % of cycles", "measured"),
    ]  # fmt: skip
