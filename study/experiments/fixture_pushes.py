"""Algorithm 1, the exact method and simpler ones, pushed against the same surfaces from the same places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pyvista as pv

from study.experiments.fixture_algorithm import METHODS, all_planes, planned_motion
from study.fixtures import Controller, MeshFixture, SphereTool
from study.specimens import specimen
from study.tables import Claim
from study.volumes import LabelVolume, surface

#: What counts as having entered, mm.
ENTERED_MM = 1e-3


@dataclass(frozen=True)
class PushSettings:
    """How the methods are pushed against meshes.

    Attributes
    ----------
    starts : int
        Positions on each mesh from which the tip is pushed.
    cycles : int
        Of each push; one ends when the tool has stopped or entered.
    radius, max_step : float
        mm.
    push_mm, tremor_mm : float
        Of a cycle: towards the surface, more or less, and standard deviation of what is added on each axis.
    """

    starts: int = 60
    cycles: int = 15
    radius: float = 0.3
    max_step: float = 0.25
    push_mm: float = 0.2
    tremor_mm: float = 0.03


def winding_number(fixture: MeshFixture, x: np.ndarray) -> float:
    """How often a surface goes round a point: 1 inside, 0 outside, about so where it is not quite closed.

    By the solid angles of its triangles (van Oosterom and Strackee, 1983).
    """
    corners = fixture.mesh.vertices[fixture.mesh.faces] - x
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    over = (a * np.cross(b, c)).sum(axis=1)
    under = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return float(np.arctan2(over, under).sum() / (2 * np.pi))


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh to push against, and one of even orientation that tells where outside is; none for the bowl."""

    name: str
    fixture: MeshFixture
    whole: MeshFixture | None

    def outside(self, x: np.ndarray, radius: float) -> bool:
        """Whether a tip here is outside, in a bowl: within it."""
        if self.fixture.distances(x[None])[0] <= radius + ENTERED_MM:
            return False
        if self.whole is None:
            return bool(np.linalg.norm(x) < 5.0 and x[2] < -1.0)
        if self.whole.closed:
            return not self.whole.index.inside(x)
        return winding_number(self.whole, x) < 0.5


def surfaces(seed: int = 0) -> list[Surface]:
    """A smooth bowl and a smooth ball, a ball some of whose triangles are turned, a bone and less of it."""
    ball = pv.Icosphere(radius=5.0, nsub=4)
    vertices, faces = np.asarray(ball.points, dtype=np.float64), ball.regular_faces
    smooth = MeshFixture((vertices, faces), "ball")
    lower = vertices[faces].mean(axis=1)[:, 2] < -0.2
    bowl = MeshFixture((vertices, faces[lower][:, ::-1]), "bowl")
    coarse = pv.Icosphere(radius=5.0, nsub=3)
    vertices, faces = np.asarray(coarse.points, dtype=np.float64), coarse.regular_faces.copy()
    whole = MeshFixture((vertices, faces.copy()), "coarse ball")
    turned = np.random.default_rng(seed).random(len(faces)) < 0.1
    faces[turned] = faces[turned][:, ::-1]
    flipped = MeshFixture((vertices, faces), "flipped ball")
    mesh = surface(_block(specimen("CH01").anatomy), "bone", 0.0, None)
    corners, triangles = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces)
    bone = MeshFixture((corners, triangles), "bone")
    body = pv.PolyData(corners, np.c_[np.full(len(triangles), 3), triangles].ravel()).decimate(0.97)
    less = MeshFixture((np.asarray(body.points, dtype=np.float64), body.regular_faces), "decimated bone")
    return [
        Surface("smooth, concave", bowl, None),
        Surface("smooth, convex", smooth, smooth),
        Surface("10 % of the faces turned round", flipped, whole),
        Surface("bone, every voxel's surface", bone, bone),
        Surface("bone, 3 % of its triangles", less, less),
    ]


def _block(volume: LabelVolume) -> LabelVolume:
    """The middle half of a volume on each axis: so much of its surface is enough here."""
    quarter = np.array(volume.labels.shape) // 4
    x, y, z = (slice(a, -a) for a in quarter)
    affine = volume.affine.copy()
    affine[:3, 3] += affine[:3, :3] @ quarter
    return LabelVolume(volume.labels[x, y, z], affine, volume.names)


@dataclass(frozen=True, eq=False)
class Push:
    """What came of one push.

    Attributes
    ----------
    track : (n, 3) array
        Centres of the tip, mm.
    least : float
        Smallest distance less the radius, mm.
    steps, infeasible : int
        Cycles, and those that stopped.
    given, wanted : float
        Length of what was done and of what was asked, mm.
    """

    track: np.ndarray
    least: float
    steps: int
    infeasible: int
    given: float
    wanted: float


def push(case: Surface, method: str, settings: PushSettings, seed: int) -> list[Push]:
    """Push a tip against a surface from `settings.starts` places; the same places and pushes each method.

    Every other place is near an edge where more than two faces meet, if there is one.

    Parameters
    ----------
    case : Surface
    method : str
        One of `METHODS`.
    settings : PushSettings
    seed : int
    """
    fixture, radius = case.fixture, settings.radius
    adjacency, faces = fixture.mesh.adjacency, fixture.mesh.faces
    corners = fixture.mesh.vertices[np.unique(faces)]
    odd = (adjacency.edge_counts[adjacency.edges] > 2).any(axis=1)
    crowded = fixture.mesh.vertices[np.unique(faces[odd])] if odd.any() else corners
    tool = SphereTool(radius)
    control = None
    if method in ("published", "exact"):
        control = Controller([fixture], tool, settings.max_step, method=method)
    rng, pushes = np.random.default_rng(seed), []
    while len(pushes) < settings.starts:
        around = crowded if len(pushes) % 2 else corners
        x = around[rng.integers(len(around))] + rng.normal(size=3) * (radius + 0.3)
        aside, tremors = rng.normal(size=3), rng.normal(size=(settings.cycles, 3))
        if not case.outside(x, radius):
            continue
        towards = fixture.index.nearest(x[None]).points[0] - x
        course = towards / np.linalg.norm(towards) + 0.5 * aside
        course *= settings.push_mm / np.linalg.norm(course)
        track, least, infeasible, given, wanted = [x], np.inf, 0, 0.0, 0.0
        for tremor in tremors:
            desired = course + settings.tremor_mm * tremor
            desired *= min(1.0, settings.max_step / np.linalg.norm(desired))
            motion = _pushed(fixture, method, control, x, desired, settings)
            infeasible += motion is None
            motion = np.zeros(3) if motion is None else motion
            x = x + motion
            track.append(x)
            given, wanted = given + np.linalg.norm(motion), wanted + np.linalg.norm(desired)
            least = min(least, float(fixture.distances(x[None])[0]) - radius)
            if infeasible:  # planes that leave no motion leave none to the next push either
                wanted += settings.push_mm * (settings.cycles - len(track) + 1)
            if infeasible or least < -ENTERED_MM:
                break
        pushes.append(Push(np.array(track), least, len(track) - 1, infeasible, given, wanted))
    return pushes


def _pushed(fixture, method, control, x, desired, settings) -> np.ndarray | None:
    if control is not None:
        step = control.step(x, desired)
        return None if step.stopped else step.motion
    if method == "none":
        return desired
    normals, points = all_planes(fixture, x, settings.radius + settings.max_step)
    return planned_motion(normals, points, x, settings.radius, desired, settings.max_step)


def comparison(
    cases: list[Surface],
    settings: PushSettings = PushSettings(),
    seed: int = 0,
) -> pd.DataFrame:
    """All surfaces by all methods.

    Parameters
    ----------
    cases : list of Surface
    settings : PushSettings
    seed : int

    Returns
    -------
    pandas.DataFrame
        Columns surface, method, pushes, entered_pct (of the pushes, by more than a micrometre),
        deepest_mm (by how much the tip came nearer than its radius, at most its diameter, at the cycle in
        which it entered), stuck_pct (pushes that ended in a stop), progress_ratio (length of what was done
        over what was asked for).
    """
    rows = []
    for case in cases:
        for method in METHODS:
            pushes = push(case, method, settings, seed)
            rows.append(
                {
                    "surface": case.name,
                    "method": method,
                    "pushes": len(pushes),
                    "entered_pct": 100 * float(np.mean([p.least < -ENTERED_MM for p in pushes])),
                    "deepest_mm": round(max(0.0, -min(p.least for p in pushes)), 9),
                    "stuck_pct": 100 * float(np.mean([p.infeasible > 0 for p in pushes])),
                    "progress_ratio": sum(p.given for p in pushes) / sum(p.wanted for p in pushes),
                }
            )
    return pd.DataFrame(rows)


def pushing_claims(table: pd.DataFrame) -> list[Claim]:
    """What the text says of planes on meshes, and what is said here of both methods, by a `comparison`."""
    rows = table.set_index(["surface", "method"])
    smooth = [name for name in dict.fromkeys(table["surface"]) if name.startswith("smooth")]
    others = [name for name in dict.fromkeys(table["surface"]) if name not in smooth]

    def entered(names: list[str], method: str) -> float:
        return max(rows.loc[(name, method), "entered_pct"] for name in names)

    def stuck(names: list[str], method: str) -> float:
        return max(rows.loc[(name, method), "stuck_pct"] for name in names)

    unguided = min(rows.loc[(name, "none"), "entered_pct"] for name in smooth + others)
    concave, convex = smooth
    naive, ours = (rows.loc[(convex, method), "progress_ratio"] for method in ("all planes", "exact"))
    bowl, free = (rows.loc[(concave, method), "progress_ratio"] for method in ("all planes", "exact"))
    said = [
        ("without constraints most pushes enter", unguided > 50, f"at least {unguided:.0f} %"),
        (
            "on a concave surface all planes at once are safe and bar little",
            entered([concave], "all planes") == 0 and bowl > 0.95 * free,
            f"{entered([concave], 'all planes'):.0f} % entered, {bowl:.3f} of the way, exact {free:.3f}",
        ),
        (
            "on a convex surface all planes at once bar ways that are free",
            naive < ours,
            f"{naive:.3f} of the way asked for, exact {ours:.3f}",
        ),
        (
            "Algorithm 1 keeps the tip out of smooth surfaces",
            entered(smooth, "published") == 0,
            f"{entered(smooth, 'published'):.1f} % entered",
        ),
        (
            "Algorithm 1 keeps it out of all of these surfaces",
            entered(smooth + others, "published") == 0,
            f"up to {entered(smooth + others, 'published'):.1f} % entered",
        ),
        (
            "Algorithm 1 always leaves a motion",
            stuck(smooth + others, "published") == 0,
            f"up to {stuck(smooth + others, 'published'):.1f} % stuck",
        ),
        (
            "the exact method keeps it out of all of these surfaces and always leaves a motion",
            entered(smooth + others, "exact") == 0 and stuck(smooth + others, "exact") == 0,
            f"{entered(smooth + others, 'exact'):.1f} % entered, "
            f"{stuck(smooth + others, 'exact'):.1f} % stuck",
        ),
    ]
    return [Claim(text, bool(holds), evidence, "measured") for text, holds, evidence in said]
