"""The fusion against the printed matrices, plain Kalman filters, and its own statistics."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_are
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from study.errors import InputError
from study.guidance.filters import PoseNoise
from study.guidance.frames import difference, rigid
from study.guidance.fusion import FusionSettings, PoseFusion, lags_of, system_matrices, warm, workspace
from study.guidance.fusion import _kernels as kernels

T = 0.02
UNEVEN = FusionSettings(
    position_mm=(0.1, 0.2, 0.3), rotation_rad=(0.001, 0.002, 0.003), velocity_mm_s=0.5, velocity_rad_s=0.005
)


def random_record(rng, n, speed=20.0, spin=0.5, share=0.5):
    """Velocities, measured poses and when they are fresh; they need not belong together."""
    velocity = rng.normal(size=(n, 6)) * np.repeat([speed, spin], 3)
    measured = rigid(Rotation.from_rotvec(0.05 * rng.normal(size=(n, 3))), rng.normal(size=(n, 3)))
    return velocity, measured, rng.random(n) < share


def noise_matrices(settings, kind):
    """Q and R of the printed 12 states and 6 measurements; kind 0 is the position, 1 the rotation."""
    n = settings.lags + 2
    q = np.zeros(n)
    q[[0, -1]] = settings.process[kind]
    r = (settings.r_position, settings.r_rotation)[kind]
    return np.kron(np.diag(q), np.eye(3)), np.diag(np.append(r, np.full(3, settings.r_velocity[kind])))


def corrected(P, C, R, innovation):
    """Gain times innovation, covariance after it, and NIS: the textbook's matrices."""
    S = C @ P @ C.T + R
    K = np.linalg.solve(S, C @ P).T
    I_KC = np.eye(len(P)) - K @ C
    return K @ innovation, I_KC @ P @ I_KC.T + K @ R @ K.T, float(innovation @ np.linalg.solve(S, innovation))


def test_system_matrices_are_the_printed_ones():
    A, C = system_matrices()
    one, zero = np.eye(3), np.zeros((3, 3))
    assert np.array_equal(
        A,
        np.block(
            [
                [one, zero, zero, T * one],
                [one, zero, zero, zero],
                [zero, one, zero, zero],
                [zero, zero, zero, one],
            ]
        ),
    )
    assert np.array_equal(C, np.block([[zero, zero, one, zero], [zero, zero, zero, one]]))
    assert system_matrices(0.01, 4)[0].shape == (18, 18)
    with pytest.raises(InputError, match="lags"):
        system_matrices(lags=1.5)
    with pytest.raises(InputError, match="sample_s"):
        system_matrices(sample_s=0.0)


def rank_of_observability(A, C):
    return np.linalg.matrix_rank(np.vstack([C @ np.linalg.matrix_power(A, k) for k in range(len(A))]))


@pytest.mark.parametrize("lags", [0, 1, 2, 4])
def test_observability(lags):
    A, C = system_matrices(1.0, lags)  # the rank does not depend on T; with 1 it is not close to losing it
    n = len(A)
    assert rank_of_observability(A, C) == n
    assert rank_of_observability(A, C[:3]) == n  # positions alone tell the velocity too
    assert rank_of_observability(A, C[3:]) == 3  # velocities alone tell no position
    positions = np.zeros((n, 1))
    positions[0:-3:3] = 1.0  # the same shift of all positions along x
    assert np.array_equal(A @ positions, positions)
    assert not (C[3:] @ positions).any()


@settings(deadline=None, max_examples=12)
@given(
    seed=st.integers(0, 2**32 - 1), lags=st.sampled_from([0, 1, 2, 3, 4]), gate=st.sampled_from([0.0, 0.9])
)
def test_position_is_the_textbook_filter_of_all_states(seed, lags, gate):
    rng = np.random.default_rng(seed)
    chosen = FusionSettings(
        lags=lags,
        position_mm=rng.uniform(0.05, 1, 3),
        velocity_mm_s=rng.uniform(0.1, 20),
        process_position_mm=rng.uniform(0, 0.5),
        process_velocity_mm_s=rng.uniform(0, 10),
        gate=gate,
    )
    velocity, measured, fresh = random_record(rng, 120)
    A, C = system_matrices(chosen.sample_s, lags)
    Q, R = noise_matrices(chosen, 0)
    fusion = PoseFusion(chosen, np.eye(4))
    x, P = fusion.state.copy(), fusion.covariance
    used = 0
    for k in range(len(fresh)):
        innovation = fusion.step(velocity[k], measured[k] if fresh[k] else None)
        x, P = A @ x, A @ P @ A.T + Q
        z = np.append(measured[k, :3, 3], velocity[k, :3]) - C @ x
        rows = np.arange(3, 6)
        if fresh[k]:
            nis = corrected(P, C[:3], R[:3, :3], z[:3])[2]
            assert innovation.position == pytest.approx(nis, rel=1e-9)
            if nis <= chosen.largest_nis:
                rows = np.arange(6)
                used += 1
        else:
            assert innovation.position is None
        dx, P, _ = corrected(P, C[rows], R[np.ix_(rows, rows)], z[rows])
        x = x + dx
        assert np.abs(fusion.state - x).max() < 1e-9
        assert np.abs(fusion.covariance - P).max() < 1e-9
    assert used > 0


def small(R):
    return Rotation.from_matrix(R).as_rotvec()


@pytest.mark.parametrize("lags", [0, 2, 4])
def test_orientation_is_the_textbook_filter_of_small_rotations(lags):
    rng = np.random.default_rng(lags)
    chosen = FusionSettings(**{**vars(UNEVEN), "lags": lags})
    velocity, measured, fresh = random_record(rng, 200)
    A, C = system_matrices(chosen.sample_s, lags)
    Q, R = noise_matrices(chosen, 1)
    fusion = PoseFusion(chosen, np.eye(4))
    turns, spin, P = [np.eye(3)] * (lags + 1), np.zeros(3), fusion.rotation_covariance
    for k in range(len(fresh)):
        innovation = fusion.step(velocity[k], measured[k] if fresh[k] else None)
        turns = [Rotation.from_rotvec(T * spin).as_matrix() @ turns[0], *turns][: lags + 1]
        P = A @ P @ A.T + Q
        z = np.append(small(measured[k, :3, :3] @ turns[-1].T), velocity[k, 3:] - spin)
        rows = np.arange(6) if fresh[k] else np.arange(3, 6)
        if fresh[k]:
            nis = corrected(P, C[:3], R[:3, :3], z[:3])[2]
            assert innovation.rotation == pytest.approx(nis, rel=1e-9)
        dx, P, _ = corrected(P, C[rows], R[np.ix_(rows, rows)], z[rows])
        turns = [
            Rotation.from_rotvec(d).as_matrix() @ turn
            for d, turn in zip(dx[:-3].reshape(-1, 3), turns, strict=True)
        ]
        spin = spin + dx[-3:]
        assert np.abs(fusion.pose[:3, :3] - turns[0]).max() < 1e-9
        assert np.abs(fusion.velocity[3:] - spin).max() < 1e-9
        assert np.abs(fusion.rotation_covariance - P).max() < 1e-9


@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize("lags", [1, 2, 4])
def test_steady_state_is_the_riccati_equation(lags, kind):
    chosen = FusionSettings(**{**vars(UNEVEN), "lags": lags})
    A, C = system_matrices(chosen.sample_s, lags)
    Q, R = noise_matrices(chosen, kind)
    predicted = solve_discrete_are(A.T, C.T, Q, R)
    gain = np.linalg.solve(C @ predicted @ C.T + R, C @ predicted).T
    fusion = PoseFusion(chosen, np.eye(4))
    n = 2000
    fusion.run(np.zeros((n, 6)), np.tile(np.eye(4), (n, 1, 1)), np.ones(n, bool))
    P = (fusion.covariance, fusion.rotation_covariance)[kind]
    steady = predicted - gain @ C @ predicted
    assert np.abs(P - steady).max() < 1e-9 * np.abs(steady).max()
    # The gain itself: what one more measurement, 1 off along one axis, changes.
    measured, off = np.eye(4), 1e-6
    velocity = np.zeros(6)
    if kind == 0:
        measured[0, 3] = off
    else:
        measured[:3, :3] = Rotation.from_rotvec([off, 0, 0]).as_matrix()
    fusion.step(velocity, measured)
    moved = difference(fusion.pose, np.eye(4))
    assert moved[1 - kind][0] / off == pytest.approx(gain[0, 0], rel=1e-6)
    assert fusion.velocity[3 * kind] / off == pytest.approx(gain[-3, 0], rel=1e-6)


def simulated(chosen, n, rng, spin=0.0):
    """A record of the filter's own model, and the true poses; every second pose is fresh."""
    true_velocity = np.zeros((n + 1, 6))
    true_velocity[0, 3:] = spin
    poses = [np.eye(4)] * (chosen.lags + 1)
    process = np.sqrt(chosen.process)
    measured = np.tile(np.eye(4), (n, 1, 1))
    for k in range(n):
        noise = rng.normal(size=(4, 3))
        turn = Rotation.from_rotvec(process[1, 0] * noise[0]) * Rotation.from_rotvec(T * true_velocity[k, 3:])
        pose = rigid(
            turn.as_matrix() @ poses[-1][:3, :3],
            poses[-1][:3, 3] + T * true_velocity[k, :3] + process[0, 0] * noise[1],
        )
        poses.append(pose)
        true_velocity[k + 1] = true_velocity[k] + np.append(
            process[0, 1] * noise[2], process[1, 1] * noise[3]
        )
        late = poses[-1 - chosen.lags]
        off = Rotation.from_rotvec(chosen.rotation_rad * rng.normal(size=3)).as_matrix()
        measured[k] = rigid(off @ late[:3, :3], late[:3, 3] + chosen.position_mm * rng.normal(size=3))
    velocity = true_velocity[1:] + np.repeat(np.sqrt(chosen.r_velocity), 3) * rng.normal(size=(n, 6))
    return velocity, measured, np.arange(n) % 2 == 0, np.array(poses[chosen.lags + 1 :])


def test_innovations_are_consistent():
    rng = np.random.default_rng(3)
    chosen = FusionSettings(
        position_mm=(0.1, 0.2, 0.3),
        velocity_mm_s=2.0,
        rotation_rad=(0.001, 0.002, 0.003),
        velocity_rad_s=0.01,
        process_velocity_mm_s=1.0,
        process_velocity_rad_s=0.005,
    )
    velocity, measured, fresh, truth = simulated(chosen, 6000, rng, spin=(0.2, -0.1, 0.3))
    fusion = PoseFusion(chosen, np.eye(4))
    poses, nis = fusion.run(velocity, measured, fresh)
    settled = nis[100:]
    m = len(settled)
    low, high = chi2.ppf([0.0005, 0.9995], 3 * m) / m
    for kind in (0, 1):
        assert low < settled[:, kind].mean() < high
        # White: the next sample is not told by this one.
        centred = settled[:, kind] - settled[:, kind].mean()
        assert abs(np.mean(centred[1:] * centred[:-1]) / centred.var()) < 4 / np.sqrt(m)
        # The share beyond the 95 % gate is 5 %.
        beyond = (settled[:, kind] > chi2.ppf(0.95, 3)).mean()
        assert abs(beyond - 0.05) < 4 * np.sqrt(0.05 * 0.95 / m)
    # And the errors are what the covariances say: they come every 2 steps, so many are averaged.
    turned, shifted = difference(poses, truth)
    for errors, P in ((shifted, fusion.covariance), (turned, fusion.rotation_covariance)):
        assert errors[200:].std(axis=0) == pytest.approx(np.sqrt(np.diag(P)[:3]), rel=0.1)


def test_mistold_noise_shows_in_the_innovations():
    told = FusionSettings(position_mm=(0.05, 0.05, 0.05))
    velocity, measured, fresh, _ = simulated(
        FusionSettings(position_mm=(0.2, 0.2, 0.2)), 2000, np.random.default_rng(0)
    )
    _, nis = PoseFusion(told, np.eye(4)).run(velocity, measured, fresh)
    assert nis[:, 0].mean() > 2 * chi2.ppf(0.9995, 3 * len(nis)) / len(nis)


def exact_record(lags, n=200, spin=(0.1, 0.2, -0.3)):
    """Constant velocities without noise, poses `lags` steps late."""
    velocity = np.array([20.0, -5.0, 1.0, *spin])
    steps = np.arange(n + 1)[:, None]
    truth = rigid(Rotation.from_rotvec(steps * T * velocity[3:]), steps * T * velocity[:3])
    measured = truth[np.maximum(np.arange(1, n + 1) - lags, 0)]
    return np.tile(velocity, (n, 1)), measured, truth[1:]


@pytest.mark.parametrize("form", ["error_state", "euler"])
@pytest.mark.parametrize("lags", [0, 1, 2, 4])
def test_late_poses_are_put_where_they_belong(lags, form):
    velocity, measured, truth = exact_record(lags)
    fresh = np.arange(len(truth)) % 2 == 0
    chosen = FusionSettings(lags=lags, orientation=form, process_velocity_rad_s=0.1)
    poses, _ = PoseFusion(chosen, np.eye(4)).run(velocity, measured, fresh)
    turned, shifted = difference(poses[150:], truth[150:])
    assert np.abs(shifted).max() < 1e-3
    # Rates of angles change where an angular velocity does not: by about its square times T, each step.
    unmodelled = T**2 * np.sum(velocity[0, 3:] ** 2)
    assert np.abs(turned).max() < (1e-6 if form == "error_state" else 10 * unmodelled)


def test_a_delay_that_the_filter_does_not_know_becomes_lag():
    velocity, measured, truth = exact_record(4)  # 80 ms, and the filter believes 40
    poses, _ = PoseFusion(FusionSettings(lags=2), np.eye(4)).run(
        velocity, measured, np.ones(len(truth), bool)
    )
    lag = (truth[-1, :3, 3] - poses[-1, :3, 3]) / velocity[0, :3]
    assert lag == pytest.approx(np.full(3, 0.04), abs=1e-4)


def test_step_is_run():
    velocity, measured, fresh = random_record(np.random.default_rng(0), 50)
    for form in ("error_state", "euler"):
        chosen = FusionSettings(orientation=form, gate=0.99)
        whole, one = PoseFusion(chosen, np.eye(4)), PoseFusion(chosen, np.eye(4))
        poses, nis = whole.run(velocity, measured, fresh)
        told = []
        for k in range(len(fresh)):
            innovation = one.step(velocity[k], measured[k] if fresh[k] else None)
            assert np.allclose(one.pose, poses[k], rtol=0, atol=1e-12)
            if fresh[k]:
                told.append((innovation.position, innovation.rotation))
                assert innovation.accepted == (max(told[-1]) <= chi2.ppf(0.99, 3))
        assert np.array_equal(told, nis)


def test_outliers_are_gated():
    velocity, measured, truth = exact_record(2)
    fresh = np.arange(len(truth)) % 2 == 0
    spoilt = measured.copy()
    spoilt[100] = rigid(Rotation.from_rotvec([0.2, 0, 0]) * Rotation.from_matrix(measured[100, :3, :3]))
    spoilt[100, :3, 3] = measured[100, :3, 3] + [5.0, 0, 0]

    def worst(gate, record):
        fusion = PoseFusion(FusionSettings(gate=gate), np.eye(4))
        poses, nis = fusion.run(velocity, record, fresh)
        turned, shifted = difference(poses[99:], truth[99:])
        return np.abs(shifted).max(), np.abs(turned).max(), nis

    calm = worst(0.999, measured)
    gated, open_ = worst(0.999, spoilt), worst(0.0, spoilt)
    assert gated[0] < calm[0] + 0.1 and gated[1] < calm[1] + 0.001
    assert open_[0] > 1.0 and open_[1] > 0.02
    assert (gated[2][50] > chi2.ppf(0.999, 3)).all()


def test_without_poses_velocities_carry_on():
    fusion = PoseFusion(FusionSettings(), np.eye(4))
    n = 100
    poses, nis = fusion.run(
        np.tile([10.0, 0, 0, 0, 0, 0.1], (n, 1)), np.full((n, 4, 4), np.nan), np.zeros(n, bool)
    )
    assert nis.shape == (0, 2)
    assert poses[-1, 0, 3] == pytest.approx(10.0 * T * n, rel=0.02)
    assert small(poses[-1, :3, :3])[2] == pytest.approx(0.1 * T * n, rel=0.02)
    # Uncertainty grows by the process noise, step by step.
    grown = fusion.covariance[0, 0]
    assert grown > FusionSettings().r_position[0] + 0.9 * n * FusionSettings().process[0, 0]


@settings(deadline=None, max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_turning_the_world_turns_the_result(seed):
    """Of the error state: no orientation is special. Noise has to be the same about all axes."""
    rng = np.random.default_rng(seed)
    chosen = FusionSettings()
    velocity, measured, fresh, _ = simulated(chosen, 60, rng, spin=(0.2, 0.3, 0.1))
    T_new_old = rigid(Rotation.random(rng=rng), rng.normal(size=3))
    R = T_new_old[:3, :3]
    turned = np.concatenate([velocity[:, :3] @ R.T, velocity[:, 3:] @ R.T], axis=1)
    poses, nis = PoseFusion(chosen, np.eye(4)).run(velocity, measured, fresh)
    new, new_nis = PoseFusion(chosen, T_new_old).run(turned, T_new_old @ measured, fresh)
    assert np.allclose(new, T_new_old @ poses, atol=1e-9)
    assert np.allclose(new_nis, nis, rtol=1e-5, atol=1e-7)


def fly_past(pitch_deg, form, spin=(0.02, -0.1, 0.03), n=400):
    """Largest error in rad of a filter whose pose turns past a pitch, its noise 1 mrad about each axis."""
    rng = np.random.default_rng(1)
    chosen = FusionSettings(orientation=form)
    middle = Rotation.from_euler("ZYX", [30.0, pitch_deg, 20.0], degrees=True)
    turns = Rotation.from_rotvec(T * (np.arange(n + 2) - n / 2)[:, None] * np.array(spin)) * middle
    noise = Rotation.from_rotvec(rng.normal(size=(n, 3)) * chosen.rotation_rad)
    measured, truth = rigid(noise * turns[:n]), rigid(turns[2:])
    velocity = np.tile(np.append(np.zeros(3), spin), (n, 1))
    poses, _ = PoseFusion(chosen, rigid(turns[0])).run(velocity, measured, np.arange(n) % 2 == 0)
    return np.linalg.norm(difference(poses, truth)[0], axis=1)[50:].max()


@pytest.mark.parametrize("pitch", [-30.0, 0.0, 50.0])
def test_both_forms_agree_away_from_the_singularity(pitch):
    assert fly_past(pitch, "euler") == pytest.approx(fly_past(pitch, "error_state"), rel=0.1)


def test_euler_angles_fail_where_pitch_is_a_right_angle():
    noise = np.linalg.norm(FusionSettings().rotation_rad)
    for spin in ((0.02, -0.1, 0.03), (0.1, 0.0, 0.0), (0.3, -0.3, 0.0)):
        assert fly_past(90.0, "error_state", spin) < 2 * noise
        assert fly_past(90.0, "euler", spin) > 5 * noise
    assert 0.1 < fly_past(90.0, "euler", spin) < np.pi  # 6 degrees and more, yet a number


def test_euler_angles_are_unwrapped():
    n = 1200
    spin = np.array([0.0, 0.0, 0.8])  # yaw goes round three times
    turns = Rotation.from_rotvec(T * np.arange(n + 2)[:, None] * spin)
    fusion = PoseFusion(FusionSettings(orientation="euler"), np.eye(4))
    poses, _ = fusion.run(
        np.tile(np.append(np.zeros(3), spin), (n, 1)), rigid(turns[:n]), np.arange(n) % 2 == 0
    )
    turned, _ = difference(poses, rigid(turns[2:]))
    assert np.abs(turned[100:]).max() < 1e-3


@pytest.mark.parametrize("trust", ["tracker", "encoders"])
def test_a_million_steps_leave_covariances_symmetric_and_positive(trust):
    n = 1_000_000
    rng = np.random.default_rng(0)
    r = (1e-10, 1e4) if trust == "tracker" else (1e4, 1e-10)
    P = np.tile(np.eye(4), (3, 1, 1))
    x, nis, out = np.zeros((3, 4)), np.empty(n), np.empty((n, 3))
    fresh = rng.random(n) < 0.4
    z = rng.normal(size=(n, 3))
    kernels.fuse_positions(
        x, P, T, np.array([1e-8, 1.0]), np.full(3, r[0]), r[1], z, z, fresh, np.inf, workspace(2), nis, out
    )
    assert np.isfinite(out).all() and np.isfinite(x).all() and np.isfinite(nis).all()
    assert np.array_equal(P, np.swapaxes(P, 1, 2))
    scale = 1.0 / np.sqrt(np.einsum("aii->ai", P))  # as correlations: variances differ by many decades
    assert np.linalg.eigvalsh(P * scale[:, :, None] * scale[:, None, :]).min() > -1e-12
    assert (np.einsum("aii->ai", P) > 0).all()
    assert (nis[fresh] >= 0).all() and (nis[~fresh] == -1).all()


def test_quaternions_stay_of_unit_length():
    n = 200_000
    rng = np.random.default_rng(0)
    q = np.tile([1.0, 0, 0, 0], (3, 1))
    z = rng.normal(size=(n, 4))
    z /= np.linalg.norm(z, axis=1)[:, None]
    nis, out = np.empty(n), np.empty((n, 4))
    P = np.tile(np.eye(4), (3, 1, 1))
    kernels.fuse_orientations(
        q, np.zeros(3), P, T, np.array([1e-4, 1e-2]), np.ones(3), 1e-2, z, rng.normal(size=(n, 3)),
        rng.random(n) < 0.5, np.inf, workspace(2), nis, out,
    )  # fmt: skip
    assert np.abs(np.linalg.norm(out, axis=1) - 1).max() < 1e-14


def test_sign_of_a_measured_quaternion_does_not_matter():
    results = []
    for sign in (1.0, -1.0):
        q, P = np.tile([1.0, 0, 0, 0], (3, 1)), np.tile(np.eye(4), (3, 1, 1))
        z = sign * np.array([[np.cos(0.1), np.sin(0.1), 0, 0]])
        nis, out = np.empty(1), np.empty((1, 4))
        kernels.fuse_orientations(
            q, np.zeros(3), P, T, np.ones(2), np.ones(3), 1.0, z, np.zeros((1, 3)),
            np.ones(1, bool), np.inf, workspace(2), nis, out,
        )  # fmt: skip
        results.append(np.append(out[0], nis))
    assert np.array_equal(*results)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_pose_that_is_not_finite_does_not_travel_on(bad):
    """The compiled steps themselves take it for an outlier, with a gate or without."""
    for gate in (np.inf, 5.0):
        x, P = np.zeros((3, 4)), np.tile(np.eye(4), (3, 1, 1))
        nis, out = np.empty(1), np.empty((1, 3))
        z = np.array([[0.0, bad, 0.0]])
        common = np.zeros((1, 3)), np.ones(1, bool), gate, workspace(2), nis
        kernels.fuse_positions(x, P, T, np.ones(2), np.ones(3), 1.0, z, *common, out)
        assert nis[0] == np.inf and not x.any() and np.isfinite(P).all()
        q, turned = np.tile([1.0, 0, 0, 0], (3, 1)), np.empty((1, 4))
        z = np.array([[1.0, bad, 0.0, 0.0]])
        kernels.fuse_orientations(q, np.zeros(3), P, T, np.ones(2), np.ones(3), 1.0, z, *common, turned)
        assert nis[0] == np.inf and np.array_equal(turned[0], [1, 0, 0, 0]) and np.isfinite(P).all()


def test_bad_input_is_refused_and_leaves_the_state():
    fusion = PoseFusion(FusionSettings(), np.eye(4))
    fusion.step(np.ones(6), np.eye(4))
    before = fusion.pose, fusion.covariance
    bent = np.eye(4)
    bent[0, 0] = 1.1
    for velocity, measured, words in (
        ([1, 2, 3], None, "velocity"),
        ([np.nan] * 6, None, "velocity"),
        (np.zeros(6), np.full((4, 4), np.nan), "measured"),
        (np.zeros(6), bent, "measured"),
        (np.zeros(6), np.eye(3), "measured"),
    ):
        with pytest.raises(InputError, match=words):
            fusion.step(velocity, measured)
    assert np.array_equal(fusion.pose, before[0]) and np.array_equal(fusion.covariance, before[1])
    with pytest.raises(InputError, match="T0"):
        PoseFusion(FusionSettings(), bent)


@pytest.mark.parametrize(
    "wrong",
    [
        {"sample_s": 0.0},
        {"lags": -1},
        {"lags": 2.5},
        {"lags": True},
        {"position_mm": (0.1, 0.1)},
        {"rotation_rad": (0.0, 0.1, 0.1)},
        {"velocity_mm_s": 0.0},
        {"process_position_mm": -1.0},
        {"process_velocity_rad_s": np.nan},
        {"orientation": "quaternion"},
        {"gate": 1.0},
        {"gate": -0.1},
    ],
)
def test_settings_are_checked(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        FusionSettings(**wrong)


def test_settings_from_noise():
    noise = PoseNoise((0.05, 0.06, 0.2), (0.001, 0.001, 0.0003))
    chosen = FusionSettings(gate=0.99).with_noise(noise)
    assert chosen.position_mm == noise.position_mm and chosen.rotation_rad == noise.rotation_rad
    assert chosen.gate == 0.99 and chosen.largest_nis == pytest.approx(11.345, abs=1e-3)
    assert FusionSettings().largest_nis == np.inf


def test_lags_of_a_delay():
    assert [lags_of(d) for d in (0.0, 0.02, 0.04, 0.08)] == [0, 1, 2, 4]
    assert lags_of(0.08, 0.01) == 8
    with pytest.raises(InputError, match=r"0\.04 or 0\.06 s, got 0\.05 s"):
        lags_of(0.05)
    for delay in (-0.02, np.nan):
        with pytest.raises(InputError, match="delay_s"):
            lags_of(delay)


def test_first_covariance_is_of_a_pose_some_steps_old():
    chosen = FusionSettings()
    P, _ = chosen.first_covariances()
    velocity = chosen.velocity_mm_s**2 + chosen.process_velocity_mm_s**2
    assert P[0, 2, 2] == pytest.approx(0.01)
    assert P[0, 0, 0] == pytest.approx(0.01 + (2 * T) ** 2 * velocity)
    assert P[0, 0, 3] == pytest.approx(2 * T * velocity)
    assert np.linalg.eigvalsh(P).min() > -1e-12


def test_warm_runs():
    warm()
