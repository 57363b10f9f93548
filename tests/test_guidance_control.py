"""PI control: the short way round, its limits, and what it leaves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance.control import ControlSettings, PoseController
from study.guidance.control import _kernels as kernels
from study.guidance.frames import difference, rigid


def steered(error_q, integral=None, settings=None, cycle=0.012, error_p=(0, 0, 0)):
    settings = settings or ControlSettings()
    out = np.zeros(6)
    kernels.steer_once(
        np.array(error_p, float),
        np.array(error_q, float),
        settings.gains,
        settings.most,
        cycle,
        np.zeros(6) if integral is None else integral,
        out,
    )
    return out


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_both_signs_of_a_quaternion_command_the_same(seed):
    q = np.random.default_rng(seed).normal(size=4)
    q /= np.linalg.norm(q)
    assert np.array_equal(steered(q), steered(-q))


def test_turns_the_short_way_round():
    for degrees, sign in ((20.0, 1.0), (200.0, -1.0), (340.0, -1.0), (-190.0, 1.0)):
        half = np.deg2rad(degrees) / 2
        twist = steered([np.cos(half), 0, np.sin(half), 0])
        assert np.sign(twist[4]) == sign
        assert np.array_equal(twist[[0, 1, 2, 3, 5]], np.zeros(5))


def moved(T, twist, cycle):
    out = T.copy()
    out[:3, 3] += cycle * twist[:3]
    out[:3, :3] = Rotation.from_rotvec(cycle * twist[3:]).as_matrix() @ T[:3, :3]
    return out


def closed_loop(controller, actual, desired, seconds, disturbance=0.0):
    """A perfect arm that drifts: errors of position (mm) and orientation (rad) after each cycle."""
    errors = []
    for _ in range(round(seconds / controller.cycle_s)):
        actual = moved(actual, controller.step(actual, desired) + disturbance, controller.cycle_s)
        turn, off = difference(actual, desired)
        errors.append([np.linalg.norm(off), np.linalg.norm(turn)])
    return np.array(errors)


@pytest.mark.parametrize("cycle", [0.012, 0.04])
def test_a_step_settles(cycle):
    desired = rigid(Rotation.from_rotvec([0.1, 0.2, -0.3]), [400.0, 20.0, 100.0])
    actual = rigid(Rotation.from_rotvec([0.3, 0.1, -0.2]), [405.0, 23.0, 110.0])
    errors = closed_loop(PoseController(cycle_s=cycle), actual, desired, 15.0)
    assert errors[0, 0] > 10
    slowest = (2 - np.sqrt(2**2 - 4 * 0.5)) / 2  # root of s^2 + 2 s + 0.5, the defaults
    assert errors[-1, 0] < errors[0, 0] * np.exp(-15.0 * slowest)
    assert errors[-1, 1] < errors[0, 1] * np.exp(-15.0 * slowest)
    # What the integral sums up meanwhile carries it past the goal by less than a sixth.
    direction = desired[:3, 3] - actual[:3, 3]
    controller, here, past = PoseController(cycle_s=cycle), actual, 0.0
    for _ in range(round(15 / cycle)):
        here = moved(here, controller.step(here, desired), cycle)
        past = max(past, (here[:3, 3] - desired[:3, 3]) @ direction / (direction @ direction))
    assert past < 1 / 6


def test_a_steady_disturbance_leaves_no_error_to_pi_and_its_share_to_p():
    drift = np.array([0.5, -0.2, 0.1, 0.002, 0.001, -0.003])
    T = rigid(translation=[400.0, 0.0, 100.0])
    pi = closed_loop(PoseController(), T, T, 40.0, drift)
    assert pi[:, 0].max() > 0.05
    assert pi[-1, 0] < 1e-4
    assert pi[-1, 1] < 1e-6
    only_p = ControlSettings(position_integral=0.0, orientation_integral=0.0)
    p = closed_loop(PoseController(only_p), T, T, 40.0, drift)
    assert p[-1, 0] == pytest.approx(np.linalg.norm(drift[:3]) / only_p.position_gain, rel=0.05)
    assert p[-1, 1] == pytest.approx(np.linalg.norm(drift[3:]) / only_p.orientation_gain, rel=0.05)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.01, 1e4))
def test_never_faster_than_told_and_still_towards(seed, size):
    rng = np.random.default_rng(seed)
    error, q = size * rng.normal(size=3), rng.normal(size=4)
    twist = steered(q / np.linalg.norm(q), error_p=error)
    most = ControlSettings().most
    assert np.linalg.norm(twist[:3]) <= most[0] * (1 + 1e-12)
    assert np.linalg.norm(twist[3:]) <= most[1] * (1 + 1e-12)
    assert np.allclose(np.cross(twist[:3], error), 0, atol=1e-9 * size * most[0])
    assert twist[:3] @ error > 0


def test_the_integral_waits_while_the_command_is_cut():
    integral = np.zeros(6)
    for _ in range(1000):
        steered([1, 0, 0, 0], integral, error_p=[1000.0, 0, 0])
    assert np.array_equal(integral, np.zeros(6))
    steered([1, 0, 0, 0], integral, error_p=[1.0, 0, 0])
    assert integral[0] == pytest.approx(ControlSettings().position_integral * 0.012)


def test_reset_forgets():
    controller = PoseController()
    T, there = np.eye(4), rigid(translation=[1.0, 0, 0])
    first = controller.step(T, there)
    second = controller.step(T, there)
    assert second[0] > first[0]
    controller.reset()
    assert np.array_equal(controller.step(T, there), first)


@pytest.mark.parametrize(
    "changes",
    [
        {"position_gain": -1.0},
        {"orientation_integral": np.nan},
        {"speed_mm_s": 0.0},
        {"speed_rad_s": np.inf},
    ],
)
def test_settings_refuse(changes):
    with pytest.raises(InputError, match=next(iter(changes))):
        ControlSettings(**changes)


def test_controller_refuses():
    for cycle in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="cycle_s"):
            PoseController(cycle_s=cycle)
    for bad in (np.eye(3), np.full((4, 4), np.nan), 2 * np.eye(4)):
        with pytest.raises(InputError, match="actual"):
            PoseController().step(bad, np.eye(4))
        with pytest.raises(InputError, match="desired"):
            PoseController().step(np.eye(4), bad)
