"""The way out: within the tube of the way in, within its limits, through the controller."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from fixture_cases import VtkDistance, plate, rough
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.errors import InputError, RetractionViolation
from study.fixtures import Controller, MeshFixture, ShaftTool, SphereTool
from study.fixtures.hands import ScriptedHand, Tremor
from study.fixtures.retraction import Insertion, RetractionSettings, Tube
from study.fixtures.retraction.places import mixable
from study.fixtures.retraction.scaling import Profile
from study.fixtures.simulation import simulate

SHAFT = ShaftTool(1.0, 0.6, 40.0)


def recorded(seed, freedoms, seconds=2.5, step=0.01):
    """A random smooth way in, with tremor, at uneven times."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.3, 1.7, int(seconds / step)) * step)
    f, phase = rng.uniform(0.05, 0.6, (2, 6)), rng.uniform(0, 6, (2, 6))
    poses = np.sin(2 * np.pi * f[0] * times[:, None] + phase[0]) * [6, 6, 6, 0.2, 0.2, 0.2]
    tremor = Tremor(rng)
    poses += [tremor.displacement(t, 6) for t in times]
    return times, poses[:, :freedoms]


def plain_distance(tool_ends, path, pose):
    """As it reads, by many poses between recorded ones."""
    best = np.inf
    for one, other in pairwise(path):
        turn = Rotation.from_rotvec(other[3:]) * Rotation.from_rotvec(one[3:]).inv()
        for u in np.linspace(0, 1, 21):
            R = Rotation.from_rotvec(u * turn.as_rotvec()) * Rotation.from_rotvec(one[3:])
            x = one[:3] + u * (other[:3] - one[:3])
            there = x + R.apply(tool_ends)
            here = pose[:3] + Rotation.from_rotvec(pose[3:]).apply(tool_ends)
            best = min(best, np.linalg.norm(here - there, axis=1).max())
    return best


def test_tube_as_it_reads():
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(size=(6, 6)) * [1, 1, 1, 0.02, 0.02, 0.02], axis=0)
    tube = Tube(path, SHAFT, 0.02)
    ends = np.array([[0, 0, 0], [0, 0, 40.0]])
    for _ in range(10):
        pose = path[rng.integers(6)] + 0.3 * rng.normal(size=6) * [1, 1, 1, 0.02, 0.02, 0.02]
        told, plain = tube.distances(mixable(pose[None]))[0], plain_distance(ends, path, pose)
        # Nearest in the sum of squares of two ends, not in the larger; the plain one samples.
        assert plain - 0.06 <= told <= plain * np.sqrt(2) + 0.02


def test_tube_of_a_sphere_is_the_distance_to_the_polyline():
    tube = Tube(np.array([[0.0, 0, 0], [10, 0, 0], [10, 5, 0]]), SphereTool(1.0), 0.05)
    points = np.array([[5.013, 0.3, 0], [10.4, 2.017, 0.3], [-1, 0, 0]])
    assert tube.distances(points) == pytest.approx([0.3, 0.5, 1.0], abs=1e-9)


@given(
    seed=st.integers(0, 2**31), freedoms=st.sampled_from([3, 6]), tolerance=st.sampled_from([0.05, 0.2, 1.0])
)
@settings(deadline=None, max_examples=4)
def test_out_within_tube_and_limits(seed, freedoms, tolerance):
    tool = SphereTool(1.0) if freedoms == 3 else SHAFT
    insertion = Insertion.of(*recorded(seed, freedoms), tool)
    limits = RetractionSettings(tolerance_mm=tolerance)
    out = insertion.retraction(limits)
    out.verify()
    np.testing.assert_allclose(out.poses[0, :3], insertion.poses[-1, :3], atol=1e-9)
    np.testing.assert_allclose(out.poses[-1, :3], insertion.poses[0, :3], atol=1e-9)
    # Measured anew from the poses.
    v = np.diff(out.poses[:, :3], axis=0) / limits.cycle_s
    a = np.diff(np.vstack([0 * v[:1], v, 0 * v[:1]]), axis=0) / limits.cycle_s
    assert np.linalg.norm(v, axis=1).max() <= limits.speed_mm_s * (1 + 1e-9)
    assert np.linalg.norm(a, axis=1).max() <= limits.acceleration_mm_s2 * (1 + 1e-9)
    line = insertion.poses[:, :3]
    for x in out.poses[::40, :3]:
        p, d = line[:-1], np.diff(line, axis=0)
        u = np.clip(((x - p) * d).sum(1) / np.maximum((d**2).sum(1), 1e-30), 0, 1)
        assert np.linalg.norm(x - p - u[:, None] * d, axis=1).min() <= tolerance
    stopped = out.stop_at(0.37 * out.seconds)
    stopped.verify()
    assert np.array_equal(stopped.poses[: int(0.37 * out.seconds / limits.cycle_s)],
                          out.poses[: int(0.37 * out.seconds / limits.cycle_s)])  # fmt: skip
    assert stopped.seconds <= out.seconds


def test_straight_and_slow_in_is_a_trapezoid_out():
    times = np.linspace(0, 10, 1001)
    out = Insertion.of(times, np.c_[2 * times, 0 * times, 0 * times]).retraction()
    # 20 mm at 20 mm/s and 200 mm/s^2: 1 s and twice half of 0.1 s.
    assert 1.1 <= out.seconds <= 1.1 + 3 * 0.005  # in whole cycles
    assert out.speed_up == pytest.approx(9.1, abs=0.1)
    assert out.deviation_mm <= 0.02
    stopped = out.stop_at(0.5)
    way = np.linalg.norm(stopped.poses[-1] - out.pose_at(np.array([0.5]))[0])
    assert way == pytest.approx(20**2 / (2 * 200), rel=0.03)
    assert stopped.seconds == pytest.approx(0.6, abs=0.016)
    rest = stopped.resumed()
    rest.verify()
    np.testing.assert_allclose(rest.poses[0], stopped.poses[-1], atol=1e-9)
    np.testing.assert_allclose(rest.poses[-1], [0, 0, 0], atol=1e-9)


def test_detours_are_cut_only_if_asked_and_only_within_the_tube():
    times = np.linspace(0, 6, 1201)
    back_and_forth = np.interp(times, [0, 2, 3, 4, 6], [0, 10, 5, 10, 14])
    line = np.c_[back_and_forth, 0 * times, 0 * times]
    out, uncut = (Insertion.of(times, line).retraction(RetractionSettings(cut=c)) for c in (True, False))
    assert out.curve.s[-1] == pytest.approx(14, abs=0.5)
    assert uncut.curve.s[-1] > 22  # of 24; turning points are rounded
    bow = line + np.c_[0 * times, np.where((times > 2) & (times < 4), np.sin(np.pi * times), 0), 0 * times]
    bow = Insertion.of(times, bow).retraction()
    bow.verify()


def test_a_violation_is_found():
    times = np.linspace(0, 2, 401)
    out = Insertion.of(times, np.c_[3 * np.cos(times), 3 * np.sin(times), times]).retraction()
    with pytest.raises(RetractionViolation, match="too fast"):
        replace(out, profile=out.profile.slower(0.8)).verify()
    with pytest.raises(RetractionViolation, match="leaves it by"):
        replace(out, settings=replace(out.settings, tolerance_mm=1e-4)).verify()
    early = Profile(out.profile.s[:-5], out.profile.x[:-5])
    with pytest.raises(RetractionViolation, match="first"):
        replace(out, profile=early).verify()


@pytest.mark.parametrize("tool", [SphereTool(1.0), SHAFT])
def test_fixtures_hold_on_the_way_out_too(tool):
    fixture = MeshFixture(rough(subdivisions=3))
    control = Controller([fixture], tool)
    n = tool.freedoms
    way = np.array([[0, 0, 9.0, 0, 0, 0], [0, 2, 6, 0.2, 0, 0], [2, 2, 3, 0, 0, 0]])[:, :n]
    hand = ScriptedHand(way, tremor=Tremor(3))
    run = simulate(control, hand, way[0], hand.seconds)
    out = Insertion.of_run(run).retraction()
    back = out.hand()
    played = simulate(control, back, run.end, out.seconds + 0.5)
    assert back.arrived
    np.testing.assert_allclose(played.end[:3], way[0, :3], atol=1e-6)
    other = VtkDistance(rough(subdivisions=3))
    assert min(other(x) for x in played.poses[:, :3]) > 1.0
    assert out.deviations(played.poses).max() <= out.settings.tolerance_mm
    # Stopped on command in the loop.
    stopping = out.hand()
    first = simulate(control, stopping, run.end, out.seconds / 2)
    stopping.stop()
    rest = simulate(control, stopping, first.end, out.seconds)
    assert np.linalg.norm(rest.end[:3] - way[0, :3]) > 0.5
    assert np.ptp(rest.poses[-20:, :3], axis=0).max() < 1e-9


def test_a_tool_that_is_held_back_is_waited_for():
    times = np.linspace(0, 2, 401)
    out = Insertion.of(times, np.c_[0 * times, 0 * times, 3 - 4 * times], SphereTool(1.0)).retraction()
    hand = out.hand()
    run = simulate(Controller([MeshFixture(plate())], SphereTool(1.0)), hand, [0, 0, -5.0], out.seconds + 1)
    assert hand.waited > 50
    assert not hand.arrived
    assert run.poses[:, 2].max() < -1.0


def test_bad_input():
    times, poses = recorded(0, 3)
    with pytest.raises(InputError, match="grow"):
        Insertion.of(times[::-1], poses)
    with pytest.raises(InputError, match="finite"):
        Insertion.of(times, np.where(poses == poses.max(), np.nan, poses))
    with pytest.raises(InputError, match="numbers for this tool"):
        Insertion.of(times, poses, SHAFT)
    with pytest.raises(InputError, match="nowhere moved"):
        Insertion.of(times, 0 * poses)
    with pytest.raises(InputError, match="at least 2"):
        Insertion.of(times[:1], poses[:1])
    for name in ("speed_mm_s", "tolerance_mm", "cycle_s"):
        with pytest.raises(InputError, match=name):
            RetractionSettings(**{name: 0.0})
    out = Insertion.of(times, poses).retraction()
    with pytest.raises(InputError, match="time_s"):
        out.stop_at(-1.0)
    with pytest.raises(InputError, match="arrived"):
        out.resumed()
