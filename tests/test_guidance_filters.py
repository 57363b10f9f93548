"""The patient's filter against plain numpy and scipy, noise from rest, and the low-pass of figure 7."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from study.errors import InputError
from study.guidance.filters import (
    PatientFilter,
    PatientFilterSettings,
    PoseNoise,
    low_pass,
    measured_noise,
    new_sample_weight_of_orientation,
    new_sample_weight_of_position,
    warm,
)
from study.guidance.filters._kernels import filter_one
from study.guidance.frames import difference, rigid

NOISE = PoseNoise((0.05, 0.05, 0.15), (0.001, 0.001, 0.0003))


def at_rest(n, rng, noise=NOISE, at=None):
    """(n, 4, 4) readings of a marker that does not move."""
    turns = Rotation.from_rotvec(rng.normal(size=(n, 3)) * noise.rotation_rad)
    readings = rigid(turns, rng.normal(size=(n, 3)) * noise.position_mm)
    if at is None:
        return readings
    return rigid(readings[:, :3, :3] @ at[:3, :3], readings[:, :3, 3] + at[:3, 3])


def test_both_printed_conventions_give_a_filter_that_is_heavy_at_rest():
    chosen = PatientFilterSettings()
    assert chosen.weights == pytest.approx([0.1, 0.95, 0.05, 0.9])
    assert new_sample_weight_of_position(0.9) == pytest.approx(0.1)
    assert new_sample_weight_of_position(0.05) == pytest.approx(0.95)
    assert (new_sample_weight_of_orientation(0.05), new_sample_weight_of_orientation(0.9)) == (0.05, 0.9)
    for mapped in (new_sample_weight_of_position, new_sample_weight_of_orientation):
        for alpha in (-0.1, 1.1, np.nan):
            with pytest.raises(InputError, match="alpha"):
                mapped(alpha)


@pytest.mark.parametrize("alpha", [0.05, 0.5, 0.9])
def test_weights_are_the_printed_equations(alpha):
    rng = np.random.default_rng(0)
    far = 1e9  # never moving
    chosen = PatientFilterSettings(
        position_static=new_sample_weight_of_position(alpha),
        orientation_static=new_sample_weight_of_orientation(alpha),
        threshold=far,
    )
    patient = PatientFilter(chosen, NOISE, np.eye(4))
    x, q = np.zeros(3), Rotation.identity()
    for T in at_rest(30, rng, PoseNoise((1, 1, 1), (0.5, 0.5, 0.5))):
        x = alpha * x + (1 - alpha) * T[:3, 3]  # equation 7
        pair = Rotation.concatenate([q, Rotation.from_matrix(T[:3, :3])])
        q = Slerp([0, 1], pair)(alpha)  # equations 8 and 9
        pose = patient.step(T)
        assert np.abs(pose[:3, 3] - x).max() < 1e-12
        assert np.abs(pose[:3, :3] - q.as_matrix()).max() < 1e-12


def plain_step(p, q, z_p, z_q, weights, thresholds):
    """The same with scipy; returns new ones."""
    pair = Rotation.from_quat([q, z_q], scalar_first=True)
    moving = np.linalg.norm(z_p - p) > thresholds[0] or (pair[1] * pair[0].inv()).magnitude() > thresholds[1]
    weight_p, weight_q = weights[[1, 3]] if moving else weights[[0, 2]]
    turned = Slerp([0, 1], pair)(weight_q).as_quat(scalar_first=True)
    return p + weight_p * (z_p - p), turned, moving


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), log_spread=st.floats(-7, 0.5))
def test_compiled_step_is_scipys(seed, log_spread):
    rng = np.random.default_rng(seed)
    spread = 10.0**log_spread
    p, q = rng.normal(size=3), rng.normal(size=4)
    q /= np.linalg.norm(q)
    weights, thresholds = rng.uniform(0.01, 1, 4), spread * rng.uniform(0.5, 3, 2)
    states = set()
    for _ in range(20):
        z_p = p + spread * rng.normal(size=3)
        turn = Rotation.from_rotvec(spread * rng.normal(size=3)) * Rotation.from_quat(q, scalar_first=True)
        z_q = rng.choice([-1, 1]) * turn.as_quat(scalar_first=True)
        plain_p, plain_q, plain_moving = plain_step(p, q, z_p, z_q, weights, thresholds)
        moving = filter_one(p, q, z_p, z_q, weights, thresholds)
        states.add(moving)
        assert moving == plain_moving
        assert np.abs(p - plain_p).max() < 1e-12
        assert min(np.abs(q - plain_q).max(), np.abs(q + plain_q).max()) < 1e-9
        assert abs(np.linalg.norm(q) - 1) < 1e-14
    assert states


def test_orientation_goes_the_short_way():
    weights, thresholds = np.full(4, 0.5), np.full(2, 1e9)
    for angle in (0.0, 1e-9, 0.5, np.pi - 1e-3):
        for sign in (1, -1):
            q = np.array([1.0, 0, 0, 0])
            z = sign * np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)])
            filter_one(np.zeros(3), q, np.zeros(3), z, weights, thresholds)
            assert q == pytest.approx([np.cos(angle / 4), 0, 0, np.sin(angle / 4)], abs=1e-12)


def test_opposite_orientations_stay_finite():
    q, z = np.array([1.0, 0, 0, 0]), np.array([0.0, 1.0, 0, 0])  # half a turn apart: both ways are short
    filter_one(np.zeros(3), q, np.zeros(3), z, np.full(4, 0.5), np.full(2, 1e9))
    assert q == pytest.approx([np.sqrt(0.5), np.sqrt(0.5), 0, 0])


def test_rest_is_filtered_as_its_weights_say():
    """A weight w of white noise leaves a variance of w / (2 - w)."""
    rng = np.random.default_rng(0)
    readings = at_rest(4000, rng)
    patient = PatientFilter(PatientFilterSettings(), NOISE, np.eye(4))
    poses = np.array([patient.step(T) for T in readings])[200:]
    turned, shifted = difference(poses, np.eye(4))
    for values, noise, weight in ((shifted, NOISE.position_mm, 0.1), (turned, NOISE.rotation_rad, 0.05)):
        assert values.std(axis=0) / noise == pytest.approx(
            np.full(3, np.sqrt(weight / (2 - weight))), rel=0.12
        )


def test_rest_is_seldom_taken_for_motion():
    rng = np.random.default_rng(0)
    n = 200_000
    z = rng.normal(size=(n, 3)) * NOISE.position_mm
    turns = Rotation.from_rotvec(rng.normal(size=(n, 3)) * NOISE.rotation_rad).as_quat(scalar_first=True)
    p, q = np.zeros(3), np.array([1.0, 0, 0, 0])
    chosen = PatientFilterSettings()
    moves = [filter_one(p, q, z[k], turns[k], chosen.weights, chosen.thresholds(NOISE)) for k in range(n)]
    # Two in a hundred thousand, says the setting: 4 are expected, 20 would be 8 deviations more.
    assert sum(moves) <= 20


@pytest.mark.parametrize("turned", [False, True])
def test_motion_is_let_through_and_rest_comes_back(turned):
    rng = np.random.default_rng(1)
    jump = rigid(Rotation.from_rotvec([0, 0, 0.05 if turned else 0]), [0, 0, 0] if turned else [2.0, 0, 0])
    patient = PatientFilter(PatientFilterSettings(), NOISE)
    for T in at_rest(50, rng):
        patient.step(T)
        assert not patient.moving
    readings = at_rest(50, rng, at=jump)
    patient.step(readings[0])
    assert patient.moving
    for T in readings[1:]:
        patient.step(T)
    assert not patient.moving
    angle, distance = difference(patient.pose, jump)
    assert np.linalg.norm(distance) < NOISE.distance_mm and np.linalg.norm(angle) < NOISE.angle_rad
    heavy = PatientFilter(PatientFilterSettings(threshold=1e9), NOISE, np.eye(4))
    for T in readings[:3]:
        heavy.step(T)
    left = np.concatenate(difference(heavy.pose, jump))
    assert np.linalg.norm(left) > 0.7 * np.linalg.norm(np.concatenate(difference(np.eye(4), jump)))


def test_motion_is_told_from_the_filtered_pose():
    """A drift of small steps is noticed once it adds up, though no sample is far from the one before."""
    patient = PatientFilter(PatientFilterSettings(), NOISE, np.eye(4))
    step = 0.5 * patient.thresholds[0]
    moved = []
    for k in range(1, 6):
        patient.step(rigid(translation=[k * step, 0, 0]))
        moved.append(patient.moving)
    assert not moved[0] and any(moved)


def test_unit_length_after_many_steps():
    rng = np.random.default_rng(0)
    p, q = np.zeros(3), np.array([1.0, 0, 0, 0])
    turns = Rotation.random(20_000, rng=rng).as_quat(scalar_first=True)
    for z in turns:
        filter_one(p, q, p, z, np.full(4, 0.3), np.zeros(2))
        assert abs(q @ q - 1) < 1e-14


def test_patient_filter_refuses_bad_input():
    patient = PatientFilter(PatientFilterSettings(), NOISE)
    with pytest.raises(InputError, match="sample"):
        _ = patient.pose
    first = patient.step(rigid(translation=[1.0, 2, 3]))
    assert np.allclose(first, rigid(translation=[1.0, 2, 3]))
    for bad in (np.full((4, 4), np.nan), np.eye(3), np.diag([1.0, 1, 1.1, 1])):
        with pytest.raises(InputError, match="T:"):
            patient.step(bad)
    assert np.array_equal(patient.pose, first)
    for wrong in (
        {"position_static": 0.0},
        {"orientation_moving": 1.1},
        {"threshold": 0.0},
        {"threshold": np.nan},
    ):
        with pytest.raises(InputError, match=next(iter(wrong))):
            PatientFilterSettings(**wrong)


def test_noise_is_read_off_rest():
    at = rigid(Rotation.from_rotvec([1.0, -2.0, 0.5]), [100.0, -50.0, 1500.0])
    noise = measured_noise(at_rest(5000, np.random.default_rng(0), at=at))
    assert noise.position_mm == pytest.approx(NOISE.position_mm, rel=0.05)
    assert noise.rotation_rad == pytest.approx(NOISE.rotation_rad, rel=0.05)
    assert noise.distance_mm == pytest.approx(np.linalg.norm(noise.position_mm))
    assert noise.angle_rad == pytest.approx(np.linalg.norm(noise.rotation_rad))


def test_noise_needs_rest_and_enough_of_it():
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match="12 or more samples, got 5"):
        measured_noise(at_rest(5, rng))
    with pytest.raises(InputError, match="at rest"):
        measured_noise(rigid(Rotation.random(30, rng=rng), np.zeros((30, 3))))
    with pytest.raises(InputError, match="poses"):
        measured_noise(np.full((20, 4, 4), np.nan))
    for wrong in ((0.1, 0.1), (0.1, -0.1, 0.1), (np.nan, 0, 0)):
        with pytest.raises(InputError, match="position_mm"):
            PoseNoise(wrong, (0, 0, 0))


@pytest.mark.parametrize(("order", "late"), [(1, 1.0), (2, np.sqrt(2.0))])
def test_low_pass_has_its_corner_and_its_lag(order, late):
    time = np.arange(0, 40, 0.02)
    wave = low_pass(np.sin(2 * np.pi * 3.0 * time), order=order)[1000:]
    assert np.sqrt(2 * np.mean(wave**2)) == pytest.approx(np.sqrt(0.5), rel=0.01)
    ramp = low_pass(20.0 * time, order=order)
    assert (20.0 * time - ramp)[-1] / 20.0 == pytest.approx(late / (2 * np.pi * 3.0), rel=0.02)
    assert low_pass(np.full(50, 7.0), order=order) == pytest.approx(np.full(50, 7.0))


def test_low_pass_does_not_know_the_future():
    rng = np.random.default_rng(0)
    values = rng.normal(size=(100, 3))
    changed = values.copy()
    changed[60:] += 5.0
    out, other = low_pass(values), low_pass(changed)
    assert np.array_equal(out[:60], other[:60]) and (out[60:] != other[60:]).all()
    assert np.array_equal(out[:, 1], low_pass(values[:, 1]))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"values": [1.0, np.nan]}, "values"),
        ({"values": []}, "values"),
        ({"corner_hz": 0.0}, "corner_hz"),
        ({"corner_hz": 25.0}, "corner_hz"),
        ({"sample_s": 0.0}, "sample_s"),
        ({"order": 0}, "order"),
        ({"order": 1.5}, "order"),
    ],
)
def test_low_pass_refuses(changes, words):
    with pytest.raises(InputError, match=words):
        low_pass(**{"values": np.zeros(10), **changes})


def test_warm_runs():
    warm()
