"""Closed-form registration and what it misses: against scipy, plain formulas, many drawn registrations."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.registration import (
    DisplacementMoments,
    PointRegistration,
    first_order_tre_covariance,
    isotropic_tre_covariance,
    register_points,
)
from study.registration import point as point_module
from study.registration.first_order import motion_covariance
from study.registration.rigid import register_many


def moved(points, turn, shift):
    return points @ turn.as_matrix().T + shift


def by_svd(moving, fixed, weights):
    """Weighted least squares by a singular value decomposition that refuses reflections."""
    share = weights / weights.sum()
    a, b = share @ moving, share @ fixed
    u, _, vt = np.linalg.svd((share[:, None] * (moving - a)).T @ (fixed - b))
    turn = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, b - turn @ a
    return out


def a_set(seed, count, kind="general"):
    rng = np.random.default_rng(seed)
    points = rng.normal(scale=30, size=(count, 3))
    if kind == "planar":
        points[:, 2] = 0
    if kind == "nearly collinear":
        points[:, 1:] *= 1e-3
    return points


@pytest.mark.parametrize("kind", ["general", "planar", "nearly collinear"])
@pytest.mark.parametrize("count", [3, 4, 7, 40])
def test_least_squares_as_by_scipy_and_by_svd(kind, count):
    for seed in range(12):
        rng = np.random.default_rng([seed, count])
        moving = a_set(seed, count, kind)
        turn = Rotation.from_rotvec(rng.normal(size=3) * [0.01, 0.5, 3][seed % 3])
        noise = 0 if seed % 4 == 0 else [1e-4, 0.2][seed % 2] * (1e-3 if kind == "nearly collinear" else 1)
        fixed = moved(moving, turn, rng.normal(size=3) * 100) + rng.normal(size=moving.shape) * noise
        weights = np.ones(count) if seed % 2 else rng.uniform(0.1, 5, count)
        fit = register_points(moving, fixed, weights)
        # A rotation about the line of nearly collinear points is known a thousand times worse than another.
        close = {"rtol": 0, "atol": 1e-5 if kind == "nearly collinear" else 1e-9}
        np.testing.assert_allclose(fit.transform, by_svd(moving, fixed, weights), **close)
        share = weights / weights.sum()
        found = Rotation.align_vectors(fixed - share @ fixed, moving - share @ moving, weights=weights)[0]
        np.testing.assert_allclose(fit.transform[:3, :3], found.as_matrix(), **close)
        np.testing.assert_allclose(fit.transform[:3, :3] @ fit.transform[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(fit.transform[:3, :3]) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, -2, 3]])
@pytest.mark.parametrize("degrees", [0, 1e-7, 90, 179.9999, 180])
@pytest.mark.parametrize("kind", ["general", "planar"])
def test_any_angle_is_found_exactly(axis, degrees, kind):
    moving = a_set(1, 5, kind)
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array(axis) / np.linalg.norm(axis))
    fit = register_points(moving, moved(moving, turn, [5, -7, 1000]))
    np.testing.assert_allclose(fit.transform[:3, :3], turn.as_matrix(), atol=1e-12)
    np.testing.assert_allclose(fit.transform[:3, 3], [5, -7, 1000], atol=1e-9)
    assert fit.fre < 1e-10


@pytest.mark.parametrize("scale", [1e-9, 1e-4, 1e6, 1e12])
def test_the_unit_does_not_matter(scale):
    moving, noise = a_set(3, 6), a_set(4, 6) * 0.01
    fixed = moved(moving, Rotation.from_rotvec([1, 2, -0.4]), [3, 2, 1]) + noise
    fit, scaled = register_points(moving, fixed), register_points(scale * moving, scale * fixed)
    np.testing.assert_allclose(scaled.transform[:3, :3], fit.transform[:3, :3], atol=1e-12)
    np.testing.assert_allclose(scaled.transform[:3, 3] / scale, fit.transform[:3, 3], atol=1e-9)
    assert scaled.fre / scale == pytest.approx(fit.fre)


def test_a_mirrored_set_is_never_fitted_by_a_reflection():
    for kind in ("general", "planar"):
        moving = a_set(5, 6, kind)
        fit = register_points(moving, moving * [-1, 1, 1])
        assert np.linalg.det(fit.transform[:3, :3]) == pytest.approx(1)
        assert (fit.fre > 1) == (kind == "general")  # in a plane half a turn does what a mirror does


def test_fre_is_the_weighted_root_mean_square_of_the_residuals():
    moving = a_set(6, 5)
    fixed = moving + a_set(7, 5) * 0.02
    weights = np.array([1, 2, 3, 4, 0.5])
    fit = register_points(moving, fixed, weights)
    left = moving @ fit.transform[:3, :3].T + fit.transform[:3, 3] - fixed
    np.testing.assert_allclose(fit.residuals, left, atol=1e-12)
    plain = np.sqrt(sum(w * (r @ r) for w, r in zip(weights, left, strict=True)) / weights.sum())
    assert fit.fre == pytest.approx(plain, rel=1e-12)
    assert fit.fre <= np.sqrt(weights @ ((moving - fixed) ** 2).sum(axis=1) / weights.sum())


def test_many_at_once_are_what_they_are_one_by_one():
    rng = np.random.default_rng(8)
    moving = rng.normal(size=(50, 4, 3)) * 20
    fixed = moving + rng.normal(size=moving.shape)
    weights = np.array([1.0, 2, 0.3, 1])
    one_by_one = [register_points(a, b, weights).transform for a, b in zip(moving, fixed, strict=True)]
    assert np.array_equal(register_many(moving, fixed, weights), one_by_one)


coordinates = st.floats(-50, 50).map(lambda x: round(x, 3))


@given(
    arrays(float, (6, 3), elements=coordinates),
    arrays(float, (6, 3), elements=st.floats(-1, 1)),
    arrays(float, 6, elements=st.floats(-3, 3)),
    st.permutations(range(6)),
)
@settings(max_examples=40)
def test_fit_moves_with_the_points_and_forgets_their_order(moving, noise, motion, order):
    spread = np.linalg.svd(moving - moving.mean(0), compute_uv=False)
    if spread[1] < 5:
        return
    fixed = moving + noise
    turn, shift = Rotation.from_rotvec(motion[:3]), motion[3:] * 30
    fit = register_points(moving, fixed)
    order = list(order)
    again = register_points(moving[order], fixed[order])
    np.testing.assert_allclose(again.transform, fit.transform, atol=1e-9)
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = turn.as_matrix(), shift
    both = register_points(moved(moving, turn, shift), moved(fixed, turn, shift))
    np.testing.assert_allclose(both.transform @ whole, whole @ fit.transform, atol=1e-8)
    assert both.fre == pytest.approx(fit.fre, abs=1e-9)


# --- what a registration misses ---------------------------------------------------------------------------


def spd(rng, count, size):
    root = rng.normal(size=(count, 3, 3)) * size * np.array([0.3, 1, 2])[:, None]
    return root @ np.swapaxes(root, 1, 2) + np.eye(3) * (0.2 * size) ** 2


FIDUCIALS = np.array([[0, 0, 0], [50, 2, 5], [10, 45, -8], [-20, 25, 12], [35, 30, 20], [5, -22, 9.0]])
TARGETS = np.array([[12, 14, 5], [60, 40, -30], [12.0, 13.3, 6.3], [-40, 10, 55]])


def test_isotropic_closed_form_is_the_general_one_to_round_off():
    for fiducials in (FIDUCIALS, FIDUCIALS[:3], FIDUCIALS[:4] * [1, 1, 0] + [100, 200, 300]):
        variance = 0.3
        general = first_order_tre_covariance(
            TARGETS, fiducials, np.tile(np.eye(3) * variance, (len(fiducials), 1, 1))
        )
        np.testing.assert_allclose(
            isotropic_tre_covariance(TARGETS, fiducials, variance), general, rtol=1e-10, atol=1e-13
        )
        model = PointRegistration(fiducials, fle_rms=np.sqrt(3 * variance / 2))
        np.testing.assert_allclose(model.tre_covariance(TARGETS), general, rtol=1e-10, atol=1e-13)


def test_trace_is_the_formula_of_fitzpatrick_and_west():
    # <TRE^2> = <FLE^2> (1/N + 1/3 sum_k d_k^2 / f_k^2), d_k and f_k: distances from principal axis k.
    centre = FIDUCIALS.mean(axis=0)
    axes = np.linalg.svd(FIDUCIALS - centre)[2]
    fle2 = 0.176**2 + 0.09**2
    for target in TARGETS:
        total = 1 / len(FIDUCIALS)
        for axis in axes:
            f2 = np.mean([np.linalg.norm(np.cross(p - centre, axis)) ** 2 for p in FIDUCIALS])
            total += np.linalg.norm(np.cross(target - centre, axis)) ** 2 / f2 / 3 / len(FIDUCIALS)
        rms = PointRegistration(FIDUCIALS, fle_rms=(0.176, 0.09)).tre_rms(target[None])[0]
        assert rms == pytest.approx(np.sqrt(fle2 * total), rel=1e-10)


def cases_of_monte_carlo():
    rng = np.random.default_rng(11)
    turn = Rotation.from_rotvec([0.4, -1.1, 2.0]).as_matrix()
    weights = np.array([1, 3, 0.5, 2, 1, 4.0])
    elongated = np.diag([0.01, 0.04, 0.16])
    yield "isotropic", {"fle_rms": 0.176}
    yield "one space only", {"fle_rms": (0.0, 0.3)}
    yield "weights", {"fle_rms": 0.2, "weights": weights}
    yield "anisotropic", {"image_covariances": elongated, "R_physical_image": turn}
    yield (
        "both anisotropic",
        {
            "image_covariances": elongated,
            "physical_covariances": elongated,
            "R_physical_image": turn,
        },
    )
    yield (
        "each its own, weights",
        {
            "image_covariances": spd(rng, 6, 0.1),
            "physical_covariances": spd(rng, 6, 0.2),
            "R_physical_image": turn,
            "weights": weights,
        },
    )


@pytest.mark.parametrize("kind, given", [pytest.param(*case, id=case[0]) for case in cases_of_monte_carlo()])
def test_first_order_covariance_is_that_of_two_hundred_thousand_registrations(kind, given):
    model = PointRegistration(FIDUCIALS, **given)
    drawn = model.sample(200_000, 12)
    angles = (3 - np.trace(drawn[:, :3, :3], axis1=1, axis2=2)).mean()  # mean squared angle, rad^2
    for target, expected in zip(TARGETS, model.tre_covariance(TARGETS), strict=True):
        miss = drawn[:, :3, :3] @ target + drawn[:, :3, 3] - target
        measured = np.cov(miss, rowvar=False)
        # Seen along the expected principal axes every variance is 1; its own scatter is 0.3 %.
        white = np.linalg.inv(np.linalg.cholesky(expected))
        np.testing.assert_allclose(white @ measured @ white.T, np.eye(3), atol=0.01)
        assert np.trace(measured) == pytest.approx(np.trace(expected), rel=0.01)
        # What theory of the first order leaves out shifts the mean by some squared angle times the lever.
        lever = np.linalg.norm(target - FIDUCIALS.mean(axis=0))
        assert np.linalg.norm(miss.mean(axis=0)) < angles * lever + 0.012 * np.sqrt(np.trace(expected))


def test_a_rigid_motion_of_everything_turns_the_covariance_and_nothing_else():
    rng = np.random.default_rng(13)
    image, physical = spd(rng, 6, 0.1), spd(rng, 6, 0.2)
    between = Rotation.from_rotvec([0.2, 0.9, -0.5]).as_matrix()
    before = PointRegistration(
        FIDUCIALS,
        image_covariances=image,
        physical_covariances=physical,
        R_physical_image=between,
        weights=np.arange(1.0, 7),
    )
    turn, shift = Rotation.from_rotvec([1.0, -0.7, 2.0]), np.array([300, -50, 1000.0])
    q = turn.as_matrix()
    after = PointRegistration(
        moved(FIDUCIALS, turn, shift),
        image_covariances=q @ image @ q.T,
        physical_covariances=physical,
        R_physical_image=between @ q.T,
        weights=np.arange(1.0, 7),
    )
    expected = q @ before.tre_covariance(TARGETS) @ q.T
    np.testing.assert_allclose(
        after.tre_covariance(moved(TARGETS, turn, shift)), expected, rtol=1e-8, atol=1e-11
    )
    # Turning the patient alone turns the errors there, and nothing in the image.
    patient = PointRegistration(
        FIDUCIALS,
        image_covariances=image,
        physical_covariances=q @ physical @ q.T,
        R_physical_image=q @ between,
        weights=np.arange(1.0, 7),
    )
    np.testing.assert_allclose(patient.tre_covariance(TARGETS), before.tre_covariance(TARGETS), rtol=1e-8)


def test_the_centre_of_rotation_is_a_matter_of_taste():
    rng = np.random.default_rng(14)
    covariances, weights = spd(rng, 6, 0.2), np.array([1, 2, 3, 4, 5, 6.0])
    expected = first_order_tre_covariance(TARGETS, FIDUCIALS, covariances, weights)
    for centre in ([0, 0, 0], [500, -300, 80.0]):
        motion = motion_covariance(FIDUCIALS, covariances, np.array(centre), weights)
        moments = DisplacementMoments.of_motion(np.array(centre), motion)
        np.testing.assert_allclose(moments.at(TARGETS), expected, rtol=1e-7)
        np.testing.assert_allclose(moments.about([7, 8, 9]).at(TARGETS), expected, rtol=1e-7)


def test_weights_may_be_matrices_and_their_scale_does_not_matter():
    covariances = spd(np.random.default_rng(15), 6, 0.2)
    numbers = np.array([1, 2, 3, 4, 5, 6.0])
    expected = first_order_tre_covariance(TARGETS, FIDUCIALS, covariances, numbers)
    matrices = 7 * numbers[:, None, None] * np.eye(3)
    found = first_order_tre_covariance(TARGETS, FIDUCIALS, covariances, matrices)
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    # The best weights are the inverse covariances (Gauss and Markov): none has a smaller error anywhere.
    best = first_order_tre_covariance(TARGETS, FIDUCIALS, covariances, np.linalg.inv(covariances))
    assert (np.linalg.eigvalsh(expected - best) > -1e-12).all()
    assert np.trace(expected - best, axis1=1, axis2=2).min() > 1e-4


def test_same_seed_same_bytes_and_chunks_change_nothing(monkeypatch):
    model = PointRegistration(FIDUCIALS, fle_rms=(0.1, 0.2))
    drawn = model.sample(3000, 5)
    assert drawn.tobytes() == model.sample(3000, np.random.default_rng(5)).tobytes()
    assert model.sample(np.int64(100), 5).tobytes() == drawn[:100].tobytes()
    monkeypatch.setattr(point_module, "_CHUNK", 1000)
    assert model.sample(3000, 5).tobytes() == drawn.tobytes()
    assert not np.array_equal(drawn, model.sample(3000, 6))


def test_draws_are_rigid_and_map_the_image_to_the_patient():
    # All the error is in the image: what is drawn maps a wrongly localised point back to where it truly is.
    shifted = PointRegistration(FIDUCIALS, image_covariances=np.diag([9e-8, 1e-8, 1e-8]), fle_rms=0)
    drawn = shifted.sample(20, 1)
    np.testing.assert_allclose(
        drawn[:, :3, :3] @ np.swapaxes(drawn[:, :3, :3], 1, 2), np.tile(np.eye(3), (20, 1, 1)), atol=1e-12
    )
    rng = np.random.default_rng(1)
    white = rng.standard_normal((20, 2, 6, 3))
    image = FIDUCIALS + white[:, 0] * np.sqrt([9e-8, 1e-8, 1e-8])
    for transform, points in zip(drawn, image, strict=True):
        np.testing.assert_allclose(transform, register_points(points, FIDUCIALS).transform, atol=1e-12)


# --- bad input --------------------------------------------------------------------------------------------

FEW = FIDUCIALS[:2]
LINE = np.arange(5.0)[:, None] * [1, 2, 3] + [10, 20, 30]


@pytest.mark.parametrize(
    "points, said",
    [
        (FEW, "at least 3 points, got 2"),
        (LINE, "do not lie on one line"),
        (np.ones((4, 3)), "do not lie on one line"),
        (FIDUCIALS[:, :2], r"got shape \(6, 2\)"),
        (FIDUCIALS[0], r"got shape \(3,\)"),
        (np.where(np.arange(18).reshape(6, 3) == 4, np.nan, FIDUCIALS), "finite numbers, got nan"),
    ],
)
def test_points_that_fix_no_rotation(points, said):
    for call in (
        lambda: PointRegistration(points),
        lambda: register_points(points, points),
        lambda: register_points(FIDUCIALS[: len(points)] if len(points) > 2 else points, points),
    ):
        with pytest.raises(InputError, match=said):
            call()


def test_other_bad_input_of_a_fit():
    with pytest.raises(InputError, match=r"expected shape \(6, 3\) like moving, got \(5, 3\)"):
        register_points(FIDUCIALS, FIDUCIALS[:5])
    for weights in ([1, 1, 1], [1, 1, 1, 1, 1, 0], [1, 1, 1, 1, 1, -2], [1, 1, 1, 1, 1, np.inf]):
        with pytest.raises(InputError, match="weights: expected 6 positive numbers, got"):
            register_points(FIDUCIALS, FIDUCIALS, weights)
        with pytest.raises(InputError, match="weights: expected 6 positive numbers, got"):
            PointRegistration(FIDUCIALS, weights=weights)


@pytest.mark.parametrize(
    "given, said",
    [
        ({"fle_rms": -0.1}, "fle_rms: expected mm of at least 0.*got -0.1"),
        ({"fle_rms": 0}, "fle_rms: expected an error above 0 mm.*got 0"),
        ({"fle_rms": np.nan}, "fle_rms.*nan"),
        ({"fle_rms": (0.1, 0.2, 0.3)}, "fle_rms.*0.3"),
        (
            {"image_covariances": np.diag([1, 1, 0.0])},
            "image_covariances.*positive definite.*fiducial 0.*1.0, 0.0",
        ),
        ({"image_covariances": -np.eye(3)}, "image_covariances.*smallest eigenvalue -1"),
        ({"physical_covariances": np.zeros((3, 3))}, "physical_covariances.*positive definite"),
        ({"physical_covariances": [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]}, "physical_covariances.*symmetric"),
        ({"physical_covariances": np.tile(np.eye(3), (5, 1, 1))}, r"\(6, 3, 3\), got shape \(5, 3, 3\)"),
        ({"physical_covariances": np.full((3, 3), np.nan)}, "physical_covariances.*finite"),
        ({"R_physical_image": np.diag([1, 1, -1])}, "R_physical_image: expected a .3, 3. rotation, got"),
        ({"R_physical_image": 2 * np.eye(3)}, "R_physical_image"),
        ({"R_physical_image": np.eye(4)}, "R_physical_image"),
    ],
)
def test_bad_errors_of_localisation(given, said):
    with pytest.raises(InputError, match=said):
        PointRegistration(FIDUCIALS, **given)


def test_only_the_fiducial_at_fault_is_named():
    covariances = np.tile(np.eye(3), (6, 1, 1))
    covariances[4, 0, 0] = -0.25
    with pytest.raises(InputError, match=r"fiducial 4 has .*-0\.25"):
        PointRegistration(FIDUCIALS, image_covariances=covariances)


@pytest.mark.parametrize("n", [0, -5, 2.5, "many", None])
def test_a_number_of_draws_that_is_none(n):
    with pytest.raises(InputError, match="n: expected a positive whole number"):
        PointRegistration(FIDUCIALS).sample(n)
