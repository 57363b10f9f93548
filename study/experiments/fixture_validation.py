"""Random hands among hard meshes: how deep a tool gets in, what it loses on a plate, how often it stops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from study.experiments import fixture_meshes as meshes
from study.experiments.fixture_distances import CapsuleDistance, VtkDistance
from study.fixtures import Controller, MeshFixture, ShaftTool, SphereTool, Step, moved

#: "none" gives the hand all it asks for, to show that what is asked for would go in.
METHODS = ("exact", "published", "none")
#: What counts as having entered, mm.
ENTERED_MM = 1e-3
#: Nearer than this a point is on the surface, on neither side, mm.
TOUCHING_MM = 1e-6
TOOLS = {
    "point": SphereTool(0.0),
    "tip 0.5 mm": SphereTool(0.5),
    "tip 1 mm": SphereTool(1.0),
    "tip 2.5 mm": SphereTool(2.5),
    "tip and shaft": ShaftTool(0.6, 0.4, 15.0),
}


@dataclass(frozen=True)
class HandSettings:
    """A hand that mostly presses towards the nearest surface and trembles.

    Attributes
    ----------
    cycles : int
        From one place on; then it starts at another.
    course : int
        Cycles until it looks anew for where the surface is.
    push_mm, tremor_mm : float
        Of a cycle: its even part, and the standard deviation of what is added on each axis. Both are
        multiplied by one of `scales`, drawn in every cycle.
    astray : tuple of float
        Standard deviation of the course's direction, of a unit vector; one is drawn for each course.
    max_step, max_turn : float
        Bounds of the controller, mm and rad.
    """

    cycles: int = 60
    course: int = 20
    push_mm: float = 0.1
    tremor_mm: float = 0.05
    scales: tuple[float, ...] = (0.02, 0.3, 1.0, 2.0)
    astray: tuple[float, ...] = (0.3, 1.0, 3.0)
    max_step: float = 0.25
    max_turn: float = 0.02


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh to push against.

    Attributes
    ----------
    name : str
    mesh : tuple of arrays
        What the fixture is made of.
    even : tuple of arrays
        The same triangles, turned evenly where that is possible; for measuring.
    closed : bool
        Whether `even` is closed and tells inside from outside.
    """

    name: str
    mesh: meshes.Mesh
    even: meshes.Mesh
    closed: bool
    _tools: dict[ShaftTool, CapsuleDistance] = field(default_factory=dict, repr=False)

    @cached_property
    def fixture(self) -> MeshFixture:
        """Of the mesh as it is."""
        return MeshFixture(self.mesh, self.name)

    @cached_property
    def other(self) -> VtkDistance:
        """Distances by another library."""
        return VtkDistance(self.even)

    def starts(self, tool: SphereTool | ShaftTool, count: int, rng: np.random.Generator) -> np.ndarray:
        """(count, 3 or 6) poses at random near the surface where a tool is outside, by the other library."""
        vertices, faces = self.mesh
        found: list[np.ndarray] = []
        while len(found) < count:
            corners = vertices[faces[rng.integers(len(faces), size=2 * count)]]
            tips = (corners * rng.dirichlet(np.ones(3), 2 * count)[:, :, None]).sum(axis=1)
            tips = tips + rng.normal(size=tips.shape) * (tool.radius + 0.3)
            free = self.other.distances(tips) > max(tool.radius, ENTERED_MM) + ENTERED_MM
            tips = tips[free]
            if self.closed and len(tips):
                tips = tips[~self.other.inside(tips)]
            for tip in tips:
                pose = tip
                if tool.freedoms == 6:
                    pose = np.r_[tip, Rotation.random(random_state=rng).as_rotvec()]
                    if self.touching(tool)(pose) < ENTERED_MM:
                        continue
                found.append(pose)
        return np.array(found[:count])

    def touching(self, tool: SphereTool | ShaftTool) -> CapsuleDistance:
        """Distances of a tool with a shaft by another library."""
        if tool not in self._tools:
            self._tools[tool] = CapsuleDistance(self.even, tool.bodies)
        return self._tools[tool]


@dataclass(frozen=True, eq=False)
class Wander:
    """What a hand asked for and what it was given, cycle by cycle.

    Attributes
    ----------
    poses, desired, motions : (n, 3) or (n, 6) arrays
        Pose before the cycle; what was asked for, no longer than allowed; what was given.
    statuses : (n,) array of str
        `study.fixtures.Step.status`; without a controller "free".
    clipped : (n,) bool array
        Whether more was asked for than is allowed.
    first : (n,) bool array
        Whether the cycle starts from a new place.
    """

    poses: np.ndarray
    desired: np.ndarray
    motions: np.ndarray
    statuses: np.ndarray
    clipped: np.ndarray
    first: np.ndarray

    @property
    def stopped(self) -> np.ndarray:
        """(n,) whether the tool was not to move because no safe motion was known."""
        return np.isin(self.statuses, ("inside", "infeasible", "unsettled"))


def _shortened(desired: np.ndarray, settings: HandSettings) -> np.ndarray:
    short = desired.copy()
    for part, most in ((slice(0, 3), settings.max_step), (slice(3, 6), settings.max_turn)):
        length = np.linalg.norm(short[part])
        if length > most:
            short[part] *= most / length
    return short


def wander(
    surface: Surface,
    tool: SphereTool | ShaftTool,
    method: str,
    steps: int,
    seed: int = 0,
    settings: HandSettings = HandSettings(),
) -> Wander:
    """Let a random hand push a tool against a surface; the same numbers are drawn for every method.

    Parameters
    ----------
    surface : Surface
    tool : SphereTool or ShaftTool
    method : str
        One of `METHODS`.
    steps : int
    seed : int
    settings : HandSettings
    """
    rng = np.random.default_rng(seed)
    starts = surface.starts(tool, -(-steps // settings.cycles), rng)
    tremors = rng.normal(size=(steps, 3)) * settings.tremor_mm
    scales = rng.choice(settings.scales, steps)
    directions, astray = rng.normal(size=(steps, 3)), rng.choice(settings.astray, steps)
    levers, turning = rng.uniform(0, 1, steps), rng.choice((0.3, 3.0), steps)
    control = None
    if method != "none":
        control = Controller(
            [surface.fixture], tool, settings.max_step, settings.max_turn, far_mm=0.0, method=method
        )
    freedoms = tool.freedoms
    poses, asked, motions = (np.zeros((steps, freedoms)) for _ in range(3))
    statuses, clipped = np.full(steps, "free", dtype="U12"), np.zeros(steps, bool)
    push, lever = np.zeros(3), np.zeros(3)
    for k in range(steps):
        start = k % settings.cycles == 0
        if start:
            pose = starts[k // settings.cycles]
        if start or (k % settings.cycles) % settings.course == 0:
            if freedoms == 6:
                along = Rotation.from_rotvec(pose[3:]).apply([0, 0, 1.0])
                lever = levers[k] * max(end for _, _, end in tool.cylinders) * along
            towards = surface.fixture.index.nearest((pose[:3] + lever)[None]).points[0] - pose[:3] - lever
            length = np.linalg.norm(towards)
            push = towards / length if length > 0 else towards
            push = push + astray[k] * directions[k]
            push *= settings.push_mm / np.linalg.norm(push)
        desired = (push + tremors[k]) * scales[k]
        if freedoms == 6:
            desired = np.r_[desired, np.cross(lever, desired) / (10 + lever @ lever) * turning[k]]
        poses[k], asked[k] = pose, _shortened(desired, settings)
        clipped[k] = bool((asked[k] != desired).any())
        if control is None:
            motions[k] = asked[k]
        else:
            step: Step = control.step(pose, desired)
            motions[k], statuses[k], clipped[k] = step.motion, step.status, step.clipped
        pose = moved(pose, motions[k])
    first = np.arange(steps) % settings.cycles == 0
    return Wander(poses, asked, motions, statuses, clipped, first)


@dataclass(frozen=True, eq=False)
class Depths:
    """How far a tool was in, cycle by cycle, by libraries that the controller does not use.

    Attributes
    ----------
    depths : (n,) array
        mm by which the tool was nearer than it may be, at worst of the middle and the end of the cycle;
        negative outside. Behind a closed surface by the distance as well.
    crossed : (n,) bool array
        Whether the tip's centre went through a triangle: the line crosses one, and both of its ends are
        further than `TOUCHING_MM` from the surface, as rounding decides about what slides on it.
    """

    depths: np.ndarray
    crossed: np.ndarray

    @property
    def entered(self) -> np.ndarray:
        """(n,) whether the tool was in by more than a micrometre, or its centre went through."""
        return (self.depths > ENTERED_MM) | self.crossed


def measured(
    surface: Surface, tool: SphereTool | ShaftTool, run: Wander, parts: Sequence[float] = (0.5, 1.0)
) -> Depths:
    """Measure a run.

    Parameters
    ----------
    surface : Surface
    tool : SphereTool or ShaftTool
    run : Wander
    parts : sequence of float
        Parts of each motion after which is measured.
    """
    depths = np.full(len(run.poses), -np.inf)
    crossed = np.zeros(len(run.poses), bool)
    capsules = surface.touching(tool) if tool.freedoms == 6 else None
    for part in parts:
        if capsules is None:
            points = run.poses + part * run.motions
            distances = surface.other.distances(points)
            if surface.closed:
                distances = np.where(surface.other.inside(points), -distances, distances)
            depth = tool.radius - distances
        else:
            pairs = zip(run.poses, part * run.motions, strict=True)
            depth = np.array([-capsules(moved(pose, motion)) for pose, motion in pairs])
        depths = np.maximum(depths, depth)
    for k in np.flatnonzero(depths > tool.radius - 1.1 * np.linalg.norm(run.motions[:, :3], axis=1)):
        ends = run.poses[k, :3], run.poses[k, :3] + run.motions[k, :3]
        crossed[k] = surface.other.crosses(*ends) and min(map(surface.other, ends)) > TOUCHING_MM
    return Depths(depths, crossed)


def surfaces(whole_bone: bool = True) -> list[Surface]:
    """The page's meshes: six that are made up, the bone of specimen CH01 and less of it."""
    ball, rough = meshes.rough(), meshes.bone(middle=not whole_bone)
    less = meshes.decimated(meshes.bone(middle=True), 0.97)
    made = {"plate": meshes.plate(), "spikes": meshes.spikes(), "fan": meshes.fan()}
    return [
        *(Surface(name, mesh, mesh, False) for name, mesh in made.items()),
        Surface("wall of 20 µm", meshes.wall(), meshes.wall(), True),
        Surface("rough ball", ball, ball, True),
        Surface("10 % turned round", meshes.flipped(ball), ball, True),
        Surface("bone CH01", rough, rough, True),
        Surface("bone, 3 % left", less, less, False),
    ]


@dataclass(frozen=True, eq=False)
class Validation:
    """Meshes by tools by methods.

    Attributes
    ----------
    rows : DataFrame
        Columns mesh, triangles, tool, method, steps, constrained_pct, stopped_pct, entered_pct (of the places
        started from), worst_mm (0 where it never was in), passed (cycles in which the tip's centre went
        through a triangle), clipped_pct.
    worst : dict
        (mesh, tool, method): (n,) depths of all cycles, mm.
    """

    rows: pd.DataFrame
    worst: dict[tuple[str, str, str], np.ndarray] = field(default_factory=dict)


def validation(
    cases: Sequence[Surface],
    steps: int,
    tools: Sequence[str] = tuple(TOOLS),
    methods: Sequence[str] = METHODS,
    shaft_steps: int | None = None,
    seed: int = 0,
    settings: HandSettings = HandSettings(),
) -> Validation:
    """All meshes by all tools by all methods.

    Parameters
    ----------
    cases : sequence of Surface
    steps : int
        Of each combination.
    tools, methods : sequence of str
        Of `TOOLS` and `METHODS`; the published method knows no shaft, and that combination is left out.
    shaft_steps : int, optional
        In place of `steps` for the tool with a shaft, which takes longer to measure.
    seed : int
    settings : HandSettings

    Returns
    -------
    Validation
    """
    rows, worst = [], {}
    for surface in cases:
        for name in tools:
            tool = TOOLS[name]
            for method in methods:
                if method == "published" and tool.freedoms == 6:
                    continue
                count = shaft_steps if shaft_steps and tool.freedoms == 6 else steps
                run = wander(surface, tool, method, count, seed, settings)
                found = measured(surface, tool, run)
                worst[surface.name, name, method] = found.depths
                places = np.cumsum(run.first) - 1
                entered = np.zeros(places[-1] + 1, bool)
                np.logical_or.at(entered, places, found.entered)
                rows.append(
                    {
                        "mesh": surface.name,
                        "triangles": len(surface.mesh[1]),
                        "tool": name,
                        "method": method,
                        "steps": count,
                        "constrained_pct": 100 * float(np.mean(run.statuses == "constrained")),
                        "stopped_pct": 100 * float(run.stopped.mean()),
                        "entered_pct": 100 * float(entered.mean()),
                        "worst_mm": max(0.0, float(found.depths.max())),
                        "passed": int(found.crossed.sum()),
                        "clipped_pct": 100 * float(run.clipped.mean()),
                    }
                )
    return Validation(pd.DataFrame(rows), worst)


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """The whole page in a few lines: by method and tool.

    Parameters
    ----------
    rows : DataFrame
        Of `Validation`.

    Returns
    -------
    pandas.DataFrame
        By method and tool: steps, the deepest and where it was, the cycles whose centre went through a
        triangle, the share of places from which it entered, and of steps that stopped.
    """
    out = []
    for (method, tool), part in rows.groupby(["method", "tool"], sort=False):
        deepest = part.loc[part["worst_mm"].idxmax()]
        out.append(
            {
                "method": method,
                "tool": tool,
                "steps": int(part["steps"].sum()),
                "worst_mm": deepest["worst_mm"],
                "on": deepest["mesh"] if deepest["worst_mm"] > 0 else "",
                "passed": int(part["passed"].sum()),
                "entered_pct": float(np.average(part["entered_pct"], weights=part["steps"])),
                "stopped_pct": float(np.average(part["stopped_pct"], weights=part["steps"])),
            }
        )
    return pd.DataFrame(out)
