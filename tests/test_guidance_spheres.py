"""Spheres: those that do not correspond are noticed, and those in an image are found."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

from study.errors import CorrespondenceError, InputError
from study.guidance.ct_spheres import blurred_ball, detect_spheres, localisation_error, render_spheres
from study.guidance.frames import difference, moved, rigid
from study.guidance.spheres import find_order, register_spheres, residual_tolerance
from study.registration import register_points
from study.registration.rigid import register_many

#: Five on a block, no two distances alike.
LAYOUT = np.array([[0.0, 0, 0], [110, 5, 3], [115, 68, 0], [8, 60, 6], [55, 30, 9]])
T_PAT_IMG = rigid(Rotation.from_rotvec([0.5, -1.0, 2.0]), [40.0, -20.0, 90.0])
PATIENT = moved(T_PAT_IMG, LAYOUT)


def brute_force(image: np.ndarray, patient: np.ndarray) -> list[tuple[float, tuple[int, ...]]]:
    """Every order with the residual that it leaves, best first."""
    orders = itertools.permutations(range(len(image)))
    return sorted((register_points(image, patient[list(order)]).fre, order) for order in orders)


def test_right_spheres_are_registered():
    rng = np.random.default_rng(0)
    touched = PATIENT + rng.normal(size=(5, 3)) * 0.05
    found = register_spheres(LAYOUT, touched)
    fit = register_points(LAYOUT, touched)
    assert np.array_equal(found.T_pat_img, fit.transform) and found.fre == fit.fre
    assert found.order == (0, 1, 2, 3, 4) and not found.ambiguous
    assert np.linalg.norm(difference(found.T_pat_img, T_PAT_IMG)[0]) < 2e-3


@settings(deadline=None, max_examples=15)
@given(seed=st.integers(0, 10_000), n=st.integers(3, 5))
def test_any_wrong_order_is_noticed_and_put_right(seed, n):
    rng = np.random.default_rng(seed)
    image = rng.uniform(-60, 60, (n, 3))
    patient = moved(T_PAT_IMG, image) + rng.normal(size=(n, 3)) * 0.05
    shuffled = patient[rng.permutation(n)]
    every = brute_force(image, shuffled)
    tolerance = residual_tolerance(n)
    good = [order for fre, order in every if fre <= tolerance]
    given_order = tuple(range(n))
    if given_order in good:
        found = register_spheres(image, shuffled)
        assert set(found.equivalent) == set(good) - {given_order}
    else:
        with pytest.raises(CorrespondenceError, match="do not correspond as given") as caught:
            register_spheres(image, shuffled)
        assert caught.value.order == good[0]
        assert register_spheres(image, shuffled[list(good[0])]).fre == pytest.approx(every[0][0])
    assert find_order(image, shuffled) == every[0][1]


def test_an_exchange_of_two_among_five_and_among_ten():
    swapped = PATIENT[[0, 3, 2, 1, 4]]
    with pytest.raises(CorrespondenceError, match=r"order \[0, 3, 2, 1, 4\] leave 0.000 mm") as caught:
        register_spheres(LAYOUT, swapped)
    assert caught.value.order == (0, 3, 2, 1, 4)
    rng = np.random.default_rng(0)
    image = rng.uniform(-60, 60, (10, 3))
    patient = moved(T_PAT_IMG, image)
    patient[[2, 7]] = patient[[7, 2]]
    with pytest.raises(CorrespondenceError) as caught:
        register_spheres(image, patient)
    assert caught.value.order == (0, 1, 7, 3, 4, 5, 6, 2, 8, 9)
    with pytest.raises(CorrespondenceError, match="no exchange of two") as caught:
        register_spheres(image, np.roll(patient, 3, axis=0))
    assert caught.value.order is None


def test_eight_spheres_are_searched_whole():
    rng = np.random.default_rng(1)
    image = rng.uniform(-60, 60, (8, 3))
    order = rng.permutation(8)
    patient = np.empty_like(image)
    patient[order] = moved(T_PAT_IMG, image) + rng.normal(size=(8, 3)) * 0.05
    with pytest.raises(CorrespondenceError) as caught:
        register_spheres(image, patient)
    assert caught.value.order == tuple(order.tolist())


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_the_best_order_is_found_also_where_distances_mislead(seed, monkeypatch):
    """A mirrored layout has orders with all distances right that no rotation brings together."""
    monkeypatch.setattr("study.guidance.spheres._CHUNK", 2)  # the best comes after the first
    rng = np.random.default_rng(seed)
    image = rng.uniform(-60, 60, (7, 3))
    patient = image * [1, 1, -1] + rng.normal(size=(7, 3)) * 2
    fixed = patient[np.array(list(itertools.permutations(range(7))))]
    T = register_many(np.broadcast_to(image, fixed.shape), fixed, np.ones(7))
    off = image @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3] - fixed
    least = np.sqrt((off**2).sum(axis=2).mean(axis=1)).min()
    assert register_points(image, patient[list(find_order(image, patient))]).fre == pytest.approx(least)


@pytest.mark.parametrize("which", range(5))
def test_a_sphere_that_moved_is_named(which):
    touched = PATIENT.copy()
    touched[which] += [1.5, -1.0, 1.0]
    with pytest.raises(CorrespondenceError, match=f"sphere {which} has probably moved") as caught:
        register_spheres(LAYOUT, touched)
    assert caught.value.order is None
    with pytest.raises(CorrespondenceError, match=r"no order .*of three spheres it cannot be told"):
        register_spheres(LAYOUT[[0, 1, 3]], PATIENT[[0, 1, 3]] * 1.05)


@pytest.mark.parametrize(
    ("layout", "orders"),
    [
        ([[0, 0, 0], [60, 0, 0], [30, 40, 0]], 2),  # two sides alike
        ([[0, 0, 0], [60, 0, 0], [60, 40, 0], [0, 40, 0]], 4),  # rectangle: half turns
        ([[0, 0, 0], [50, 0, 0], [50, 50, 0], [0, 50, 0]], 8),  # square, which may also lie on its face
        ([[30, 0, 0], [-30, 0, 0], [0, 30, 0], [0, -30, 0], [0, 0, 30], [0, 0, -30]], 24),
    ],
)
def test_symmetric_layouts_are_flagged(layout, orders):
    """As many orders as the layout has rotations; with an exchange among them nothing could be noticed."""
    layout = np.array(layout, dtype=float)
    found = register_spheres(layout, moved(T_PAT_IMG, layout))
    assert found.ambiguous and len(found.equivalent) == orders - 1
    wrong = moved(T_PAT_IMG, layout)
    wrong[0] += [0, 0, 8.0]
    with pytest.raises(CorrespondenceError):
        register_spheres(layout, wrong)


def test_a_wrong_order_of_a_symmetric_layout_says_so():
    layout = np.array([[0.0, 0, 0], [60, 0, 0], [60, 40, 0], [0, 40, 0]])
    with pytest.raises(CorrespondenceError, match="3 more orders would do as well"):
        register_spheres(layout, moved(T_PAT_IMG, layout[[1, 0, 2, 3]]))


@pytest.mark.parametrize("n", [3, 5])
def test_the_tolerance_lets_right_registrations_pass(n):
    """One in twenty is refused where 95 % are to pass."""
    rng = np.random.default_rng(0)
    runs, rms = 2000, 0.2
    limit = residual_tolerance(n, rms, 0.95)
    image = LAYOUT[:n] + rng.normal(size=(runs, n, 3)) * rms / np.sqrt(6)
    touched = PATIENT[:n] + rng.normal(size=(runs, n, 3)) * rms / np.sqrt(6)
    above = np.mean([register_points(a, b).fre > limit for a, b in zip(image, touched, strict=True)])
    assert above == pytest.approx(0.05, abs=3 * np.sqrt(0.05 * 0.95 / runs))


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: register_spheres(LAYOUT[:2], PATIENT[:2]), "at least 3"),
        (lambda: register_spheres(LAYOUT, PATIENT[:4]), "expected 5 spheres"),
        (lambda: register_spheres(np.outer([0, 1, 2], [1, 1, 1]), PATIENT[:3]), "one line"),
        (lambda: register_spheres(LAYOUT, np.full((5, 3), np.nan)), "finite"),
        (lambda: register_spheres(LAYOUT, PATIENT, tolerance_mm=0.0), "tolerance_mm"),
        (lambda: register_spheres(LAYOUT, PATIENT, localisation_rms_mm=-1.0), "localisation_rms_mm"),
        (lambda: register_spheres(LAYOUT, PATIENT, confidence=1.0), "confidence"),
        (lambda: find_order(np.random.default_rng(0).normal(size=(9, 3)), np.zeros((9, 3))), "patient"),
    ],
)
def test_bad_spheres_are_named(make, word):
    with pytest.raises(InputError, match=word):
        make()


# ------------------------------------------------------------------------------------------------- CT


@pytest.mark.parametrize("blur", [0.1, 0.4, 1.5])
def test_a_blurred_ball_is_the_ball_convolved(blur):
    """Against the convolution, integrated over the spherical shells about the point."""
    radius = 2.5

    def convolved(distance):
        def shell(s):
            if s + distance <= radius:
                share = 1.0
            elif abs(s - distance) >= radius:
                share = 0.0
            else:
                share = 0.5 * (1 - (s * s + distance**2 - radius**2) / (2 * s * distance))
            return share * 4 * np.pi * s * s * np.exp(-s * s / (2 * blur**2)) / (2 * np.pi * blur**2) ** 1.5

        edges = sorted({abs(radius - distance), radius + distance})
        return quad(shell, 0, 8 * blur, points=[e for e in edges if 0 < e < 8 * blur], limit=200)[0]

    distances = np.array([0.0, 0.7, 2.4, 2.5, 2.9, 4.0])
    assert blurred_ball(distances, radius, blur) == pytest.approx([convolved(d) for d in distances], abs=1e-6)


def test_a_rendered_ball_keeps_its_volume_and_place():
    image = render_spheres(
        [[5.13, 5.4, 5.77]], 2.5, (26, 28, 24), [0.4, 0.4, 0.5], contrast=1.0, noise=0.0, blur_mm=0.3
    )
    assert image.sum() * 0.4 * 0.4 * 0.5 == pytest.approx(4 / 3 * np.pi * 2.5**3, rel=1e-3)
    place = [np.average(np.arange(n) * v, weights=image.sum(axis=tuple({0, 1, 2} - {a})))
             for a, (n, v) in enumerate(zip(image.shape, [0.4, 0.4, 0.5], strict=True))]  # fmt: skip
    assert place == pytest.approx([5.13, 5.4, 5.77], abs=1e-3)


def test_noise_has_the_stated_size_and_reach():
    far = [[1e4, 0, 0]]
    image = render_spheres(far, 1.0, (60, 60, 60), [0.3, 0.3, 0.6], noise=80.0, noise_length_mm=0.4, rng=0)
    assert image.std() == pytest.approx(80.0, rel=0.02)
    alike = [np.mean(image * np.roll(image, 1, axis)) / 80.0**2 for axis in range(3)]
    expected = np.exp(-((np.array([0.3, 0.3, 0.6]) / 0.4) ** 2) / 4)
    assert alike == pytest.approx(expected, abs=0.03)


def phantom(rng: object = 0, **settings: float) -> tuple[np.ndarray, np.ndarray]:
    centres = moved(
        rigid(translation=[-20, 5, 100]), [[10.2, 11.1, 9.7], [30.4, 12.3, 14.9], [21.0, 29.6, 20.2]]
    )
    settings = {"noise": 100.0, **settings}
    return centres, render_spheres(
        centres, 2.5, (100, 100, 75), 0.4, origin_mm=[-20, 5, 100], rng=rng, **settings
    )


def test_balls_are_found_where_they_are():
    centres, image = phantom()
    found = detect_spheres(image, 2.5, 0.4, count=3, origin_mm=[-20, 5, 100])
    found = found[list(find_order(centres, found))]
    assert np.linalg.norm(found - centres, axis=1).max() < 0.05
    assert register_spheres(found, moved(T_PAT_IMG, centres)).fre < 0.05


@pytest.mark.parametrize("voxel", [0.3, (0.4, 0.4, 0.4), (0.4, 0.4, 0.8)])
def test_centres_are_found_to_a_small_share_of_a_voxel(voxel):
    largest = np.max(voxel)
    assert localisation_error(voxel, noise=0.0, n=20, rng=0) < 0.001 * largest
    usual = localisation_error(voxel, noise=50.0, n=30, rng=0)
    noisy = localisation_error(voxel, noise=150.0, n=30, rng=0)
    assert usual < 0.05 * largest
    assert noisy == pytest.approx(3 * usual, rel=0.15)


def test_a_wrong_number_of_balls_says_what_was_found():
    _, image = phantom()
    with pytest.raises(InputError, match=r"expected 4 of radius 2.5 mm .* found 3: \[-9.8, 16.1, 109.7\]"):
        detect_spheres(image, 2.5, 0.4, count=4, origin_mm=[-20, 5, 100])
    with pytest.raises(InputError, match=r"expected 3 of radius 4 mm .* found 0 \(also radius 2\.\d+ mm at"):
        detect_spheres(image, 4.0, 0.4, count=3, origin_mm=[-20, 5, 100])
    cut = render_spheres([[10, 10, 10], [10, 30, 0.5]], 2.5, (50, 100, 50), 0.4, rng=0)
    with pytest.raises(InputError, match=r"found 1.*cut by the image's edge"):
        detect_spheres(cut, 2.5, 0.4, count=2)
    touching = render_spheres([[10, 10, 10], [14.5, 10, 10]], 2.5, (60, 50, 50), 0.4, rng=0)
    with pytest.raises(InputError, match=r"found 0 \(also not round, half axes .* 5\.\d+\] mm"):
        detect_spheres(touching, 2.5, 0.4, count=2)
    with pytest.raises(InputError, match="found 0"):
        detect_spheres(np.zeros((20, 20, 20)), 2.5, 0.4, count=3)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"image": np.zeros((3, 3))}, "image"),
        ({"image": np.full((9, 9, 9), np.nan)}, "image"),
        ({"voxel_mm": 0.0}, "voxel_mm"),
        ({"radius_mm": -1.0}, "radius_mm"),
        ({"count": 0}, "count"),
        ({"blur_mm": np.nan}, "blur_mm"),
    ],
)
def test_bad_images_are_named(change, word):
    usual = {"image": np.zeros((9, 9, 9)), "radius_mm": 1.0, "voxel_mm": 0.4, "count": 1}
    with pytest.raises(InputError, match=word):
        detect_spheres(**(usual | change))
