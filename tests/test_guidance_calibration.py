"""Calibration of tip, drill and hand-eye: exact without noise, and as uncertain as it says with it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.errors import CalibrationError, InputError
from study.guidance.calibration import (
    T_tool_tcp_from,
    calibrate_bits,
    calibrate_hand_eye,
    calibrate_pivot,
    turn_spread,
)
from study.guidance.frames import difference, inverse, rigid
from study.guidance.tracker import MarkerBody, Tracker, TrackerSettings, facing_pose

TIP_TOOL = np.array([20.0, -30.0, -180.0])
TIP_REF = np.array([5.0, 3.0, -12.0])


def relative_errors(found: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Of a covariance, in units of the expected standard deviations."""
    scale = np.sqrt(np.diag(expected))
    return (found - expected) / np.outer(scale, scale)


# ---------------------------------------------------------------------------------------------- pivot


def pivoted(n: int, half_angle_deg: float, rng: np.random.Generator) -> np.ndarray:
    """T_ref_tool of a tool leaned over in all directions about its tip, and turned a little."""
    around = rng.uniform(0, 2 * np.pi, n)
    lean = np.radians(half_angle_deg) * np.sqrt(rng.uniform(size=n))
    turns = Rotation.from_rotvec(
        np.column_stack([lean * np.cos(around), lean * np.sin(around), rng.uniform(-0.3, 0.3, n)])
    )
    return rigid(turns, TIP_REF - turns.apply(TIP_TOOL))


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), n=st.integers(3, 40), cone=st.floats(10, 60))
def test_pivot_is_exact_without_noise(seed, n, cone):
    poses = pivoted(n, cone, np.random.default_rng(seed))
    if turn_spread(poses[:, :3, :3]) < 0.035:  # drawn together by chance
        with pytest.raises(CalibrationError):
            calibrate_pivot(poses)
        return
    found = calibrate_pivot(poses)
    assert np.abs(found.tip_tool - TIP_TOOL).max() < 1e-7
    assert np.abs(found.tip_ref - TIP_REF).max() < 1e-7
    assert found.residual_rms < 1e-8 and np.abs(found.covariance).max() < 1e-12


def test_pivot_is_the_least_squares_solution():
    rng = np.random.default_rng(0)
    poses = pivoted(30, 30, rng)
    poses[:, :3, 3] += rng.normal(size=(30, 3))
    rows = np.concatenate([np.hstack([T[:3, :3], -np.eye(3)]) for T in poses])
    expected = np.linalg.lstsq(rows, -poses[:, :3, 3].ravel())[0]
    found = calibrate_pivot(poses)
    assert np.concatenate([found.tip_tool, found.tip_ref]) == pytest.approx(expected, abs=1e-9)
    assert found.residual_rms == pytest.approx(
        np.sqrt(((rows @ expected + poses[:, :3, 3].ravel()) ** 2).sum() / 30)
    )
    smallest = np.linalg.svd(rows, compute_uv=False)[-1] / np.sqrt(30)
    assert found.spread == pytest.approx(np.sqrt(2) * smallest)


def test_pivot_says_how_uncertain_it_is_under_a_tracker():
    """A marker pivoted about the tip, both measured with jitter alone: depth errs three times more."""
    tracker = Tracker(TrackerSettings(distortion_mm=0.0, quantum_mm=0.0), rng=0)
    rng = np.random.default_rng(1)
    relative = pivoted(40, 25, rng)
    tool = facing_pose([100.0, 50.0, 1700.0])
    ref = tool @ inverse(relative)
    tool_body, ref_body = MarkerBody.plate(80), MarkerBody.plate(60)
    runs = 600
    tools = tracker.measured(tool_body, np.broadcast_to(tool, (runs * 40, 4, 4)), rng)
    refs = tracker.measured(ref_body, np.tile(ref, (runs, 1, 1)), rng)
    poses = (inverse(refs) @ tools).reshape(runs, 40, 4, 4)
    results = [calibrate_pivot(one) for one in poses]
    estimates = np.array([np.concatenate([one.tip_tool, one.tip_ref]) for one in results])
    stated = np.mean([one.covariance for one in results], axis=0)
    assert np.abs(relative_errors(np.cov(estimates, rowvar=False), stated)).max() < 0.15
    miss = estimates.mean(axis=0) - np.concatenate([TIP_TOOL, TIP_REF])
    assert np.abs(miss / np.sqrt(np.diag(stated) / runs)).max() < 4.5  # no bias beyond chance


def test_a_wider_cone_is_surer():
    rng = np.random.default_rng(2)
    traces = []
    for cone in (10, 20, 40):
        poses = pivoted(200, cone, rng)
        poses[:, :3, 3] += rng.normal(size=(200, 3)) * 0.05
        traces.append(np.trace(calibrate_pivot(poses).covariance[:3, :3]))
    assert traces[0] > 2.5 * traces[1] > 6 * traces[2]


def about_one_axis(n: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    turns = Rotation.from_rotvec(rng.uniform(-1, 1, (n, 1)) * axis)
    return rigid(turns, TIP_REF - turns.apply(TIP_TOOL))


@pytest.mark.parametrize(
    ("poses", "word"),
    [
        (about_one_axis(20), "turns about two axes at least"),
        (np.tile(rigid(), (10, 1, 1)), "turns by 0 degrees"),
        (pivoted(20, 1.0, np.random.default_rng(0)), r"2.01 degrees r\.m\.s\.; one turns by 0\.\d+ degrees"),
        (pivoted(2, 30, np.random.default_rng(0)), "at least 3 poses, got 2"),
    ],
)
def test_degenerate_pivots_are_named(poses, word):
    with pytest.raises(CalibrationError, match=word):
        calibrate_pivot(poses)


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10_000))
def test_turns_about_any_one_axis_are_degenerate_also_with_noise(seed):
    rng = np.random.default_rng(seed)
    poses = about_one_axis(25, seed)
    poses = poses @ rigid(Rotation.from_rotvec(rng.normal(size=(25, 3)) * 1e-3), rng.normal(size=(25, 3)))
    assert turn_spread(poses[:, :3, :3]) < 0.005
    with pytest.raises(CalibrationError, match="singular value"):
        calibrate_pivot(poses)


# ----------------------------------------------------------------------------------------------- bits

AXIS = np.array([0.2, -0.1, -1.0]) / np.linalg.norm([0.2, -0.1, -1.0])
STOP = np.array([3.0, 8.0, -90.0])
LENGTHS = {"short_mm": 30.0, "long_mm": 80.0, "drill_mm": 55.0}


def balls(lengths: dict[str, float] = LENGTHS) -> tuple[np.ndarray, np.ndarray]:
    return STOP + lengths["short_mm"] * AXIS, STOP + lengths["long_mm"] * AXIS


def test_bits_are_exact_without_noise():
    short, long = balls()
    found = calibrate_bits(short[None], np.tile(long, (2, 1)), **LENGTHS)
    assert np.abs(found.T_tool_tcp[:3, 3] - (STOP + 55.0 * AXIS)).max() < 1e-9
    assert np.abs(found.T_tool_tcp[:3, 2] - AXIS).max() < 1e-9
    assert abs(found.residual) < 1e-9 and found.scatter_rms < 1e-9
    assert not found.covariance.any()


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10_000), drill=st.floats(10, 120))
def test_bits_are_the_least_squares_solution(seed, drill):
    """No other tip and axis bring both balls closer to their touches."""
    rng = np.random.default_rng(seed)
    lengths = np.array([30.0, 80.0])
    touches = [
        ball + rng.normal(size=(k, 3)) * 0.1 for ball, k in zip(balls(), rng.integers(2, 6, 2), strict=True)
    ]

    def misses(tip, axis):
        off = [part - (tip + (length - drill) * axis) for part, length in zip(touches, lengths, strict=True)]
        return (np.vstack(off) ** 2).sum()

    found = calibrate_bits(*touches, *lengths, drill, tolerance_mm=5.0).T_tool_tcp
    best = misses(found[:3, 3], found[:3, 2])
    for _ in range(20):
        other = found @ rigid(Rotation.from_rotvec(rng.normal(size=3) * 1e-3), rng.normal(size=3) * 0.02)
        assert misses(other[:3, 3], other[:3, 2]) >= best - 1e-9


@pytest.mark.parametrize(("counts", "drill"), [((5, 5), 55.0), ((4, 8), 110.0)])
def test_bits_say_how_uncertain_they_are(counts, drill):
    rng = np.random.default_rng(0)
    root = np.diag([0.05, 0.03, 0.12]) @ Rotation.from_rotvec([0.3, 0.2, 0.5]).as_matrix()
    true = T_tool_tcp_from(STOP + drill * AXIS, AXIS)
    motions, stated, residuals = [], [], []
    for _ in range(4000):
        touches = [ball + rng.normal(size=(k, 3)) @ root for ball, k in zip(balls(), counts, strict=True)]
        found = calibrate_bits(*touches, 30.0, 80.0, drill)
        turn, shift = difference(found.T_tool_tcp, true)
        motions.append(np.concatenate([turn - (turn @ AXIS) * AXIS, shift]))
        stated.append(found.covariance)
        residuals.append(found.residual)
    mean = np.mean(stated, axis=0)
    assert np.abs(relative_errors(np.cov(motions, rowvar=False), mean)).max() < 0.08
    assert abs(AXIS @ mean[:3, :3] @ AXIS) < 1e-6 * np.trace(mean[:3, :3])
    along = AXIS @ root.T @ root @ AXIS * (1 / counts[0] + 1 / counts[1])
    assert np.std(residuals) == pytest.approx(np.sqrt(along), rel=0.05)


def test_a_touch_of_known_scatter_needs_no_repeat():
    short, long = balls()
    found = calibrate_bits(short[None], long[None], **LENGTHS, touch_std_mm=0.1)
    # Half way between both balls the tip is the mean of both touches.
    assert np.diag(found.covariance)[3:] == pytest.approx([0.1**2 / 2] * 3)


@pytest.mark.parametrize(
    ("change", "error", "word"),
    [
        ({"long_mm": 33.0}, CalibrationError, "at least 5"),
        ({"long_mm": 10.0}, CalibrationError, "at least 5"),
        ({"long_mm": 82.0}, CalibrationError, "expected 52.000 mm between them"),
        ({"drill_mm": np.nan}, InputError, "drill_mm"),
        ({"touch_std_mm": -1.0}, InputError, "touch_std_mm"),
        ({"short_ball_tool": balls()[0][None], "long_ball_tool": balls()[1][None]}, CalibrationError, "two"),
        ({"short_ball_tool": np.full((2, 3), np.nan)}, InputError, "short_ball_tool"),
    ],
)
def test_bad_bits_are_named(change, error, word):
    short, long = balls()
    usual = {"short_ball_tool": np.tile(short, (2, 1)), "long_ball_tool": np.tile(long, (2, 1)), **LENGTHS}
    with pytest.raises(error, match=word):
        calibrate_bits(**(usual | change))


@settings(deadline=None, max_examples=40)
@given(st.lists(st.floats(-1, 1), min_size=3, max_size=3).filter(lambda v: np.linalg.norm(v) > 1e-3))
def test_tcp_frames_are_rigid_and_stay_when_the_axis_moves_a_little(axis):
    frame = T_tool_tcp_from([1.0, 2.0, 3.0], axis)
    assert np.allclose(frame[:3, :3] @ frame[:3, :3].T, np.eye(3)) and np.linalg.det(frame[:3, :3]) > 0
    unit = np.array(axis) / np.linalg.norm(axis)
    assert np.allclose(frame[:3, 2], unit) and frame[:3, 3].tolist() == [1.0, 2.0, 3.0]
    if abs(unit[2]) < 0.86:
        assert frame[2, 0] == pytest.approx(
            np.sqrt(1 - unit[2] ** 2)
        )  # x is as near to the marker's z as it gets
        near = T_tool_tcp_from([1.0, 2.0, 3.0], unit + 1e-5)
        assert np.linalg.norm(difference(near, frame)[0]) < 1e-4


def test_tcp_without_a_direction_is_refused():
    with pytest.raises(InputError, match="direction"):
        T_tool_tcp_from([0, 0, 0], [0, 0, 0])


# ------------------------------------------------------------------------------------------- hand-eye

T_EE_TOOL = rigid(Rotation.from_rotvec([0.4, -0.9, 2.0]), [30.0, -40.0, 90.0])
T_ROB_CAM = rigid(Rotation.from_rotvec([2.2, 0.3, -0.4]), [800.0, -300.0, 1500.0])


def robot_poses(n: int, half_angle_deg: float, rng: np.random.Generator) -> np.ndarray:
    turns = Rotation.from_rotvec(rng.uniform(-1, 1, (n, 3)) * np.radians(half_angle_deg))
    here = rigid(Rotation.from_rotvec([np.pi - 0.2, 0.1, 0.0]), [400.0, 50.0, 350.0])
    return here @ rigid(turns, rng.uniform(-40, 40, (n, 3)))


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 10_000), n=st.integers(3, 30), angle=st.floats(10, 170))
def test_hand_eye_is_exact_without_noise(seed, n, angle):
    robot = robot_poses(n, angle, np.random.default_rng(seed))
    if turn_spread(robot[:, :3, :3]) < 0.035:
        return
    found = calibrate_hand_eye(robot, inverse(T_ROB_CAM) @ robot @ T_EE_TOOL)
    assert np.abs(found.T_ee_tool - T_EE_TOOL).max() < 1e-7
    assert np.abs(found.T_rob_cam - T_ROB_CAM).max() < 1e-6
    assert found.rotation_rms < 1e-9 and found.translation_rms < 1e-7


def test_hand_eye_says_how_uncertain_it_is():
    """Robot exact, tracker with jitter alone."""
    tracker = Tracker(TrackerSettings(distortion_mm=0.0, quantum_mm=0.0), rng=0)
    rng = np.random.default_rng(4)
    robot = robot_poses(30, 20, rng)
    camera = inverse(T_ROB_CAM) @ robot @ T_EE_TOOL
    motions, stated = [], []
    for _ in range(600):
        found = calibrate_hand_eye(robot, tracker.measured(MarkerBody.plate(80), camera, rng))
        motions.append(np.concatenate(difference(found.T_ee_tool, T_EE_TOOL)))
        stated.append(found.covariance)
    mean = np.mean(stated, axis=0)
    assert np.abs(relative_errors(np.cov(motions, rowvar=False), mean)).max() < 0.15
    assert np.abs(np.mean(motions, axis=0) / np.sqrt(np.diag(mean) / 600)).max() < 4.5


def test_hand_eye_needs_turns_about_two_axes():
    turns = Rotation.from_rotvec(np.linspace(-1, 1, 15)[:, None] * [0.0, 0.6, 0.8])
    robot = rigid(turns, [400.0, 0.0, 300.0])
    with pytest.raises(CalibrationError, match=r"T_rob_ee.*two axes"):
        calibrate_hand_eye(robot, inverse(T_ROB_CAM) @ robot @ T_EE_TOOL)
    with pytest.raises(CalibrationError, match="at least 3 poses"):
        calibrate_hand_eye(robot[:2], robot[:2])
    with pytest.raises(InputError, match="expected 15 poses"):
        calibrate_hand_eye(robot, robot[:5])


def test_a_tracker_that_stood_still_is_named():
    robot = robot_poses(10, 20, np.random.default_rng(0))
    with pytest.raises(CalibrationError, match="T_cam_tool"):
        calibrate_hand_eye(robot, np.tile(T_ROB_CAM, (10, 1, 1)))
