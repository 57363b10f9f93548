"""Kinematics of the 4-axis robot, and of the 5-axis one."""

import numpy as np
import pytest
from fake_plans import fake_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.robots import Ansr, FiveAxis
from study.robots.turns import angles_between, cut_turns, turned


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), rotation_axis=st.integers(0, 2), mirrored=st.booleans())
def test_forward_and_inverse_undo_each_other(seed, rotation_axis, mirrored):
    rng = np.random.default_rng(seed)
    directions = Rotation.random(random_state=seed).as_matrix() * (-1 if mirrored else 1)
    rest = directions[:, (rotation_axis + rng.integers(1, 3)) % 3]
    robot = Ansr(directions, rotation_axis, rest, burr_offset=rng.uniform(10, 120))
    joints = np.column_stack([rng.normal(0, 100, (20, 3)), rng.uniform(-3.1, 3.1, 20)])
    points, axes = robot.forward(joints)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1)
    np.testing.assert_allclose(axes @ robot.rotation_vector, 0, atol=1e-12)
    np.testing.assert_allclose(robot.inverse(points, axes), joints, atol=1e-9)


def test_tilting_moves_the_rotation_centre_about_the_burr():
    robot = Ansr(burr_offset=60.0)
    axes = np.array([[0, 0, 1.0], [0, -np.sin(0.3), np.cos(0.3)]])  # 0.3 rad about +x from +z
    joints = robot.inverse(np.array([[1.0, 2, 3], [1, 2, 3]]), axes)
    np.testing.assert_allclose(joints[0], [1, 2, 63, 0], atol=1e-12)
    np.testing.assert_allclose(joints[1], [1, 2 - 60 * np.sin(0.3), 3 + 60 * np.cos(0.3), 0.3], atol=1e-12)


def test_an_axis_out_of_the_plane_is_no_pose_of_four_degrees_of_freedom():
    robot = Ansr()
    off = np.deg2rad(0.06)
    with pytest.raises(InputError, match=r"row 1 .* not a plan of 4 degrees"):
        robot.inverse(np.zeros((2, 3)), np.array([[0, 0, 1.0], [np.sin(off), 0, np.cos(off)]]))
    within = np.deg2rad(0.04)
    robot.inverse(np.zeros((1, 3)), np.array([[np.sin(within), 0, np.cos(within)]]))


def test_a_plan_of_five_degrees_of_freedom_is_refused():
    plan = fake_plan([[12, 12, 12], [12, 12, 13]])
    object.__setattr__(plan, "dof", 5)
    with pytest.raises(InputError, match="dof 5"):
        Ansr.for_plan(plan)
    assert FiveAxis.for_plan(plan).rotation_axis == plan.rotation_axis


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), rotation_axis=st.integers(0, 2), mirrored=st.booleans())
def test_five_joints_forward_and_inverse_undo_each_other(seed, rotation_axis, mirrored):
    rng = np.random.default_rng(seed)
    directions = Rotation.random(random_state=seed).as_matrix() * (-1 if mirrored else 1)
    rest = directions[:, (rotation_axis + rng.integers(1, 3)) % 3]
    robot = FiveAxis(directions, rotation_axis, rest, burr_offset=rng.uniform(10, 120))
    turns = np.column_stack([rng.uniform(-3.1, 3.1, 20), rng.uniform(-1.5, 1.5, 20)])
    joints = np.column_stack([rng.normal(0, 100, (20, 3)), turns])
    points, axes = robot.forward(joints)
    np.testing.assert_allclose(np.linalg.norm(axes, axis=1), 1)
    np.testing.assert_allclose(robot.inverse(points, axes), joints, atol=1e-8)
    # Without a lean it is the robot of four axes.
    four = Ansr(directions, rotation_axis, rest, burr_offset=robot.burr_offset)
    joints[:, 4] = 0
    for ours, theirs in zip(robot.forward(joints), four.forward(joints[:, :4]), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12)


def test_a_drill_along_the_tilts_own_axis_is_refused():
    with pytest.raises(InputError, match="row 1 leans"):
        FiveAxis().inverse(np.zeros((2, 3)), np.array([[0, 0, 1.0], [1, 0, 0]]))


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_turn_lasts_until_its_slower_joint_is_there(seed):
    rng = np.random.default_rng(seed)
    robot = FiveAxis(max_tilt_speed_deg=20.0)
    cone = np.deg2rad(45.0)
    tilts, leans = rng.uniform(-cone, cone, (2, 12))
    axes = robot.forward(np.column_stack([np.zeros((12, 3)), tilts, leans]))[1]
    times = robot.turning_times(axes)
    shares = np.linspace(0, 1, 400)
    for start, end, time in zip(axes[:-1], axes[1:], times, strict=True):
        way = turned(np.tile(start, (400, 1)), np.tile(end, (400, 1)), shares)
        joints = robot.inverse(np.zeros_like(way), way)[:, 3:]
        fastest = np.abs(np.diff(joints, axis=0)).max() * 399 / time
        # A degree is short enough that its mean rate is, within 2 %, the rate anywhere in it.
        assert 0.98 * np.deg2rad(20.0) <= fastest <= 1.02 * np.deg2rad(20.0)


@settings(deadline=None, max_examples=40)
@given(seed=st.integers(0, 2**32 - 1))
def test_turns_are_cut_into_equal_parts_of_a_degree_at_most(seed):
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(8, 3)) * 0.2 + [0, 0, 1]
    axes = np.repeat(axes / np.linalg.norm(axes, axis=1)[:, None], rng.integers(1, 3, 8), axis=0)
    step, begin, end = cut_turns(axes)
    a, b = (turned(axes[step], axes[step + 1], share) for share in (begin, end))
    angle = angles_between(axes[:-1], axes[1:])
    assert angles_between(a, b).max(initial=0) <= np.deg2rad(1) + 1e-9
    np.testing.assert_allclose(np.bincount(step, angles_between(a, b), len(angle)), angle, atol=1e-9)
    np.testing.assert_array_equal(begin[np.flatnonzero(np.diff(step)) + 1], 0)
    np.testing.assert_allclose(end[:-1][np.diff(step) == 0], begin[1:][np.diff(step) == 0])


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"rest_axis": [1.0, 0, 0]}, "perpendicular"),
        ({"rotation_axis": 3}, "rotation_axis"),
        ({"burr_offset": -1.0}, "burr_offset"),
        ({"directions": np.ones((3, 3))}, "orthonormal"),
    ],
)
def test_bad_parameters_are_named(parameters, message):
    with pytest.raises(InputError, match=message):
        Ansr(**parameters)


@pytest.mark.parametrize("axes", [np.zeros((1, 3)), [[0, 0, 2.0]], [[np.nan, 0, 1]], [[0, 1.0]]])
def test_bad_axes_are_refused(axes):
    with pytest.raises(InputError, match="axes"):
        Ansr().inverse(np.zeros((1, 3)), axes)
