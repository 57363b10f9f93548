"""The four features of a virtual fixture (Zheng, sections 3.4 to 3.7), each with a number."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from study.experiments.fixture_bone import (
    cavity,
    guard,
    middle,
    nearest_of,
    offset,
    shaft_gap,
    turned,
    upright_pose,
)
from study.fixtures import Controller, MeshFixture, ShaftTool, Slack, SphereTool, moved
from study.fixtures.control.tools import PUBLISHED_SPACING
from study.specimens import Specimen
from study.tables import Claim


@dataclass(frozen=True, eq=False)
class Way:
    """A tool that follows a hand for a while.

    Attributes
    ----------
    poses : (n + 1, 3) or (n + 1, 6) array
        mm, and rotation vectors, rad.
    status : tuple of n + 1 str
        How the tool arrived; the first is "free".
    clearance : (n + 1,) array
        mm; infinite beyond the controller's reach and at the start.
    depths : (n + 1, m) array
        mm within what is to be kept from each of m fixtures.
    """

    poses: np.ndarray
    status: tuple[str, ...]
    clearance: np.ndarray
    depths: np.ndarray


def follow(control: Controller, start: np.ndarray, wanted: Iterable[np.ndarray]) -> Way:
    """Ask a controller for the way to one place after the other, a cycle each.

    Parameters
    ----------
    control : Controller
    start : (3,) or (6,) array
    wanted : iterable of arrays of the same shape
        Where the hand wants the tool in each cycle.
    """
    pose = np.asarray(start, dtype=float)
    poses, status, clearance = [pose], ["free"], [np.inf]
    depths = [np.zeros(len(control.fixtures))]
    for goal in wanted:
        step = control.step(pose, offset(goal, pose))
        pose = moved(pose, step.motion)
        poses.append(pose)
        status.append(step.status)
        clearance.append(step.clearance)
        depths.append(step.depths if len(step.depths) else depths[0])
    return Way(np.array(poses), tuple(status), np.array(clearance), np.array(depths))


def press(control: Controller, start: np.ndarray, push: np.ndarray, cycles: int) -> Way:
    """Push a sphere with the same motion in each cycle."""
    pose = np.asarray(start, dtype=float)
    poses, status, clearance, depths = [pose], ["free"], [np.inf], [np.zeros(len(control.fixtures))]
    for _ in range(cycles):
        step = control.step(pose, push)
        pose = pose + step.motion
        poses.append(pose)
        status.append(step.status)
        clearance.append(step.clearance)
        depths.append(step.depths if len(step.depths) else depths[0])
    return Way(np.array(poses), tuple(status), np.array(clearance), np.array(depths))


def groove(opening_deg: float = 90.0, width: float = 12.0, length: float = 16.0) -> MeshFixture:
    """Two flat walls that meet in the line x = z = 0; the groove opens towards +z."""
    half = np.deg2rad(opening_deg) / 2
    x, z, y = width * np.sin(half), width * np.cos(half), length / 2
    vertices = [[-x, -y, z], [-x, y, z], [0, -y, 0], [0, y, 0], [x, -y, z], [x, y, z]]
    faces = [[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]]
    return MeshFixture((np.array(vertices, dtype=float), np.array(faces)), name="groove")


def tips_in_groove(
    radii: Sequence[float], opening_deg: float = 90.0, cycles: int = 240
) -> tuple[dict[float, Way], np.ndarray, pd.DataFrame]:
    """Feature 1: the same way of a hand through a groove, for tips of several radii.

    Parameters
    ----------
    radii : sequence of float
        mm; 0 is a point.
    opening_deg : float
        Of the groove.
    cycles : int

    Returns
    -------
    ways : dict of float to Way
    wanted : (cycles, 3) array
        The hand, which passes below the groove's floor.
    table : pandas.DataFrame
        One row a radius: how near the centre came to the walls and to the line in which they meet, and how
        near a ball could come, r / sin(half the opening).
    """
    fixture = groove(opening_deg)
    across = np.linspace(-6.0, 6.0, cycles)
    wanted = np.column_stack([across, np.zeros(cycles), np.full(cycles, -1.0)])
    ways, rows = {}, []
    for radius in radii:
        start = np.array([0.0, 0.0, 9.5])
        control = Controller([fixture], SphereTool(radius))
        lead = np.linspace(start, wanted[0], 80)
        ways[radius] = way = follow(control, start, np.concatenate([lead, wanted]))
        to_walls = fixture.distances(way.poses).min()
        to_line = np.hypot(way.poses[:, 0], way.poses[:, 2]).min()
        rows.append(
            {
                "radius_mm": radius,
                "centre_to_wall_mm": to_walls,
                "centre_to_corner_mm": to_line,
                "possible_to_corner_mm": radius / np.sin(np.deg2rad(opening_deg) / 2),
                "cycles_constrained": sum(name == "constrained" for name in way.status),
                "cycles_stopped": sum(name not in ("free", "constrained") for name in way.status),
            }
        )
    return ways, wanted, pd.DataFrame(rows)


def plate(size: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a square at z = 0."""
    half = size / 2
    corners = [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]]
    return np.array(corners, dtype=float), np.array([[0, 1, 2], [0, 2, 3]])


def slack_depths(
    pushes: Sequence[float], slacks: Sequence[Slack | None], radius: float = 2.5, cycles: int = 300
) -> tuple[pd.DataFrame, dict[str, np.ndarray]]:
    """Feature 2: how deep a tip goes into a plate, against how hard the hand presses.

    Parameters
    ----------
    pushes : sequence of float
        mm that the hand asks for in each cycle, straight into the plate.
    slacks : sequence of Slack or None
        None is a structure that may not be touched.
    radius : float
        Of the tip, mm.
    cycles : int
        For so long the hand presses.

    Returns
    -------
    table : pandas.DataFrame
        One row a slack and push: depth after a third of the cycles and at the end, the deepest, and what
        min(push / weight, depth) says.
    over_time : dict of str to (cycles + 1,) array
        Depth in mm of the hardest push.
    """
    rows, over_time = [], {}
    for slack in slacks:
        title = slack_title(slack)
        fixture = MeshFixture(plate(), "plate", slack=slack)
        control = Controller([fixture], SphereTool(radius))
        for push in pushes:
            way = press(control, np.array([0.3, 0.2, radius + 0.4]), np.array([0.0, 0, -push]), cycles)
            depth = radius - way.poses[:, 2]
            rows.append(
                {
                    "structure": title,
                    "push_mm": push,
                    "depth_after_a_third_mm": depth[cycles // 3],
                    "depth_mm": depth[-1],
                    "deepest_mm": depth.max(),
                    "expected_mm": 0.0 if slack is None else min(push / slack.weight, slack.depth_mm),
                }
            )
            over_time[title] = depth
    return pd.DataFrame(rows), over_time


def slack_title(slack: Slack | None) -> str:
    """What figures call a slack."""
    return "no slack" if slack is None else f"{slack.depth_mm:g} mm, weight {slack.weight:g}"


def wall_and_nerve(bone: Specimen, wall_mm: float, radius: float = 1.5, cycles: int = 300) -> pd.DataFrame:
    """The wall of a milled cavity may be cut to a depth, the nerve behind it may not be touched.

    Parameters
    ----------
    bone : Specimen
        Its target is taken as milled.
    wall_mm : float
        Slack of the wall.
    radius : float
        Of the tip, mm, which is pulled from the cavity's middle towards the nerve.
    cycles : int

    Returns
    -------
    pandas.DataFrame
        One row a structure and setting: slack, the deepest that the tip went into it, and the least distance
        of the tip's surface to it (negative inside).
    """
    nerve, start = guard(bone.anatomy, "facial_nerve"), middle(bone)
    goal = nearest_of(bone.anatomy, "facial_nerve", start)
    rows = []
    for slack in (None, Slack(wall_mm)):
        wall = cavity(bone, slack)
        way = follow(Controller([wall, nerve], SphereTool(radius)), start, (goal for _ in range(cycles)))
        for fixture in (wall, nerve):
            gap = fixture.distances(way.poses) - radius
            rows.append(
                {
                    "setting": f"bone with {slack_title(slack)}",
                    "structure": fixture.name,
                    "slack_mm": 0.0 if fixture.slack is None else fixture.slack.depth_mm,
                    "least_distance_mm": gap.min(),
                    "at_the_end_mm": gap[-1],
                }
            )
    return pd.DataFrame(rows)


def covered_radius(radius: float, spacing: float = PUBLISHED_SPACING, samples: int = 4001) -> float:
    """How thick a shaft is where spheres of its radius, so many radii apart, cover it least, mm.

    Measured on the axis between two centres, not taken from the formula sqrt(1 - spacing^2 / 4).
    """
    along = np.linspace(0.0, spacing * radius, samples)
    nearest = np.minimum(along, spacing * radius - along)
    return float(np.sqrt(radius**2 - nearest**2).min())


def shaft_covers(radius: float = 1.2, length: float = 30.0) -> pd.DataFrame:
    """Feature 3: a shaft of spheres 0.88 radii apart, as printed and inflated, beside a capsule."""
    capsule = ShaftTool(2.5, radius, length)
    inflated = ShaftTool(2.5, radius, length, spheres=True)
    thick = float(inflated.bodies[-1, 6])
    gap = float(np.diff(inflated.bodies[1:, 2]).max())
    rows = [
        ("spheres as printed", radius, int(np.ceil(length / (PUBLISHED_SPACING * radius))) + 1,
         covered_radius(radius), radius),
        ("spheres, inflated", thick, len(inflated.bodies) - 1, covered_radius(thick, gap / thick), thick),
        ("capsule", radius, len(capsule.bodies) - 1, radius, radius),
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["shaft", "sphere_radius_mm", "bodies", "thinnest_mm", "thickest_mm"])
    table["missing_pct"] = 100 * (1 - table["thinnest_mm"] / radius).clip(lower=0)
    table["too_thick_pct"] = 100 * (table["thickest_mm"] / radius - 1)
    return table


@dataclass(frozen=True, eq=False)
class Tilt:
    """A drill whose tip rests in a cavity while the hand tilts it.

    Attributes
    ----------
    wall : MeshFixture
        The bone that is left.
    wanted : (n, 6) array
        The hand.
    tip_only, whole : Way
        With a controller that knows the tip alone, and with the shaft.
    tool : ShaftTool
    table : pandas.DataFrame
        One row a controller.
    """

    wall: MeshFixture
    wanted: np.ndarray
    tip_only: Way
    whole: Way
    tool: ShaftTool
    table: pd.DataFrame


def tilted_drill(bone: Specimen, tilt_deg: float = 55.0, cycles: int = 250, deep: float = 0.65) -> Tilt:
    """Feature 3: the tip would be allowed where the shaft would cut through bone.

    Parameters
    ----------
    bone : Specimen
        Its target is taken as milled.
    tilt_deg : float
        So far the hand tilts, upwards, the tip in its place.
    cycles : int
    deep : float
        Where the tip is: 0 the target's outermost, 1 its innermost place, on its middle line.
    """
    wall = cavity(bone)
    tool = ShaftTool(1.5, shaft_radius=1.2, length=40.0)
    tip, upright = middle(bone, deep), upright_pose(bone)
    start = np.r_[tip, upright]
    across = np.cross([0.0, 0.0, 1.0], bone.approach)
    turns = np.linspace(0.0, np.deg2rad(tilt_deg), cycles)
    wanted = np.array([np.r_[tip, turned(upright, angle * across)] for angle in turns])
    tip_control = Controller([wall], SphereTool(tool.radius))
    tips = follow(tip_control, tip, wanted[:, :3])
    # the tip's controller has no say in how the drill is turned
    free = Way(
        np.c_[tips.poses, np.r_[upright[None], wanted[:, 3:]]], tips.status, tips.clearance, tips.depths
    )
    whole = follow(Controller([wall], tool, max_turn=0.02), start, wanted)
    rows = []
    for name, way in (("tip only", free), ("tip and shaft", whole)):
        gaps = np.array([shaft_gap(wall, tool, pose) for pose in way.poses[:: max(1, cycles // 60)]])
        z = Rotation.from_rotvec(way.poses[-1, 3:]).apply([0.0, 0, 1])
        rows.append(
            {
                "controller": name,
                "tilt_asked_deg": tilt_deg,
                "tilt_reached_deg": float(np.rad2deg(np.arccos(np.clip(-z @ bone.approach, -1, 1)))),
                "least_gap_of_shaft_mm": gaps.min(),
                "cycles_constrained": sum(name == "constrained" for name in way.status),
                "tip_moved_mm": float(np.linalg.norm(way.poses[-1, :3] - tip)),
            }
        )
    return Tilt(wall, wanted, free, whole, tool, pd.DataFrame(rows))


def feature_claims(
    tips: pd.DataFrame, slack: pd.DataFrame, wall: pd.DataFrame, covers: pd.DataFrame, tilt: Tilt
) -> list[Claim]:
    """What the four features promise, and whether it holds here."""
    short = tips["centre_to_wall_mm"] - tips["radius_mm"]
    corner = (tips["centre_to_corner_mm"] - tips["possible_to_corner_mm"]).abs()
    deeper = slack["deepest_mm"] - slack["expected_mm"]
    creep = (slack["depth_mm"] - slack["depth_after_a_third_mm"]).abs()
    nerve = wall.loc[wall["structure"] == "facial_nerve", "least_distance_mm"]
    gaps = tilt.table.set_index("controller")["least_gap_of_shaft_mm"]
    missing = covers.set_index("shaft")["missing_pct"]
    return [
        Claim("a tip's centre never comes nearer to a wall than its radius", short.min() >= -1e-9,
              f"least distance beyond the radius {1e3 * short.min():.3f} µm", "measured"),
        Claim("and comes as near to a corner as a ball can, within 0.01 mm", corner.max() < 0.01,
              f"largest difference {1e3 * corner.max():.3f} µm", "measured"),
        Claim("a slack is never exceeded, nor entered where there is none", deeper.max() < 1e-6,
              f"deepest beyond what is allowed {1e3 * deeper.max():.3f} µm", "measured"),
        Claim("pressing for long leads no deeper, within 1 µm", creep.max() < 1e-3,
              f"largest change over two thirds of the cycles {1e3 * creep.max():.3f} µm", "measured"),
        Claim("the nerve behind a wall that may be cut is not touched", nerve.min() >= 0,
              f"least distance {nerve.min():.4f} mm", "measured"),
        Claim("spheres 0.88 radii apart leave a tenth of the radius uncovered",
              bool(9 < missing["spheres as printed"] < 11),
              f"{missing['spheres as printed']:.1f} %", "measured"),
        Claim("with the tip alone the shaft goes through bone", gaps["tip only"] < 0,
              f"{gaps['tip only']:.2f} mm", "measured"),
        Claim("with the shaft it does not", gaps["tip and shaft"] >= -1e-6,
              f"{gaps['tip and shaft']:.4f} mm", "measured"),
    ]  # fmt: skip
