"""Kinematics of the 4-axis robot."""

import numpy as np
import pytest
from fake_plans import fake_plan
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.robots import Ansr


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
