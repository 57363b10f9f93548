"""A tool that turns among hard meshes: never in by another library's distances, however it is pressed."""

import numpy as np
import pytest
from fixture_cases import HARD
from hypothesis import given, settings
from hypothesis import strategies as st
from real_data import real
from scipy.spatial.transform import Rotation

from study.experiments.fixture_distances import CapsuleDistance
from study.experiments.fixture_validation import HandSettings, Surface, measured, wander
from study.fixtures import Controller, MeshFixture, ShaftTool, Slack, moved
from study.volumes import read_volume

TOOL = ShaftTool(0.6, 0.4, 15.0)
#: Presses harder, turns up to the bound, looks less often for the surface.
RUDE = HandSettings(cycles=150, course=50, push_mm=0.2, tremor_mm=0.1, astray=(0.3, 1.0))


def surface(name):
    return Surface(name, HARD[name], HARD[name], False)


@pytest.mark.parametrize("name", HARD)
@pytest.mark.parametrize("hand", [HandSettings(), RUDE], ids=["usual", "rude"])
def test_never_in_by_coal(name, hand):
    case = surface(name)
    run = wander(case, TOOL, "exact", 300, seed=5, settings=hand)
    assert not run.stopped.any()
    assert (run.statuses == "constrained").sum() > 20
    assert measured(case, TOOL, run, (0.4, 0.8, 1.0)).depths.max() < 0
    control = wander(case, TOOL, "none", 300, seed=5, settings=hand)
    assert measured(case, TOOL, control).depths.max() > 0.1


@pytest.mark.parametrize(
    "tool",
    [
        ShaftTool(0.0, 0.3, 10.0),
        ShaftTool(0.3, 0.8, 10.0),
        ShaftTool.from_drill(),
        ShaftTool(0.6, 0.4, 8.0, spheres=True),
    ],
    ids=["pointed", "thick shaft", "drill", "spheres"],
)
def test_other_tools_are_never_in_either(tool):
    case = surface("rough")
    run = wander(case, tool, "exact", 200, seed=6)
    assert not run.stopped.any()
    assert measured(case, tool, run).depths.max() < 0


def test_never_in_real_bone():
    volume = read_volume(real("temporal_bone/RT143/labels_0p38.nrrd"))
    bone = next(name for name, label in volume.names.items() if label == 1)
    mesh = MeshFixture.from_volume(volume, bone, smooth_mm=0.2).mesh
    case = Surface("RT143", (mesh.vertices, mesh.faces), (mesh.vertices, mesh.faces), True)
    run = wander(case, TOOL, "exact", 300, seed=7)
    assert not run.stopped.any()
    assert (run.statuses == "constrained").sum() > 50
    assert measured(case, TOOL, run).depths.max() < 0


@given(
    seed=st.integers(0, 2**31),
    max_turn=st.sampled_from([1e-3, 0.02, 0.2]),
    lever=st.sampled_from([0.0, 1.0, 100.0]),
)
@settings(deadline=None, max_examples=10)
def test_however_far_it_may_turn(seed, max_turn, lever):
    case, tool = surface("rough"), ShaftTool(0.5, 0.5, 12.0, lever=lever)
    rng = np.random.default_rng(seed)
    control = Controller([case.fixture], tool, max_turn=max_turn)
    pose, other = case.starts(tool, 1, rng)[0], CapsuleDistance(HARD["rough"], tool.bodies)
    for _ in range(60):
        towards = case.fixture.index.nearest(pose[None, :3]).points[0] - pose[:3]
        step = control.step(pose, np.r_[0.2 * towards, rng.normal(size=3) * max_turn])
        assert np.linalg.norm(step.motion[:3]) <= 0.25 + 1e-12
        for part in (0.5, 1.0):
            assert other(moved(pose, part * step.motion)) > 0
        pose = moved(pose, step.motion)


@pytest.mark.parametrize("turn", [0.02, -0.02])
def test_turning_against_an_edge_for_long_does_not_creep(turn):
    """A shaft that is turned against the rim of a plate, tip fixed by the hand."""
    case = surface("plate")
    control = Controller([case.fixture], TOOL)
    pose, other = np.array([7.0, 0, 2.0, 0, -1.2, 0]), CapsuleDistance(HARD["plate"], TOOL.bodies)
    start = pose.copy()
    least, met = np.inf, 0
    for k in range(5000):
        step = control.step(pose, np.r_[0.2 * (start[:3] - pose[:3]), 0, turn, 0.002 * np.sin(k)])
        assert not step.stopped
        met += step.status == "constrained"
        pose = moved(pose, step.motion)
        if k % 10 == 0:
            least = min(least, other(pose))
    assert met > 2000
    assert 0 < least < 0.01  # held at the plate, and not in


def test_slack_of_a_tip_with_a_shaft():
    mesh = HARD["rough"]
    fixture = MeshFixture(mesh, slack=Slack(0.25, 0.02))
    tool = ShaftTool(0.6, 0.4, 15.0)
    control = Controller([fixture], tool)
    tip, shaft = CapsuleDistance(mesh, tool.bodies[:1]), CapsuleDistance(mesh, tool.bodies[1:])
    rng = np.random.default_rng(8)
    pose = np.r_[0, 0, 8.0, Rotation.from_rotvec([0.3, 0.2, 0]).as_rotvec()]
    deepest = 0.0
    for _ in range(1500):
        push = -0.1 * pose[:3] / np.linalg.norm(pose[:3]) + 0.03 * rng.normal(size=3)
        step = control.step(pose, np.r_[push, 0.005 * rng.normal(size=3)])
        assert not step.stopped
        pose = moved(pose, step.motion)
        assert tip(pose) > -0.25
        assert shaft(pose) > 0
        assert step.depths[0] == pytest.approx(max(-tip(pose), 0), abs=1e-5)
        deepest = max(deepest, -tip(pose))
    # Where the tool comes to lie on the ball its shaft, which has no slack, holds the tip 0.2 mm deep.
    assert deepest > 0.19
