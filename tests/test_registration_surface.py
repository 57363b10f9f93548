"""Surface registrations that are drawn: where image points land, how far they scatter, what is refused."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from scipy import stats
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from study.errors import GeometryError, InputError
from study.margins import GrowthSettings, grow_margin
from study.registration import (
    IcpSettings,
    SurfaceRegistration,
    displacement_moments,
    register_surface,
    sampled_moments,
)
from study.specimens import specimen
from study.volumes import surface


@pytest.fixture(autouse=True)
def few_for_moments(monkeypatch):
    monkeypatch.setattr("study.registration.surface._MOMENT_REGISTRATIONS", 500)


@cache
def body():
    """A closed surface of some 10 000 vertices, about 60 mm long, with bumps and dents."""
    mesh = trimesh.creation.icosphere(subdivisions=5)
    unit = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    far = np.ones(len(unit))
    for centre, narrow, high in (
        ([1.0, 0.3, 0.8], 6, 0.35),
        ([-0.2, 1.0, 0.6], 8, -0.3),
        ([-0.8, -0.6, 0.5], 10, 0.25),
        ([0.3, -0.8, 0.6], 12, -0.2),
    ):
        away = unit - np.array(centre) / np.linalg.norm(centre)
        far += high * np.exp(-narrow * (away**2).sum(axis=1))
    mesh.vertices = unit * far[:, None] * [30.0, 22, 17] + [40.0, -25, 120]
    return mesh


@cache
def swab(count=120):
    """Points on the upper side of the surface, between vertices."""
    points, _ = trimesh.sample.sample_surface(body(), 6 * count, seed=1)
    return np.asarray(points[points[:, 2] > 120][:count])


@cache
def model(**changes):
    return SurfaceRegistration(body(), swab(), **{"position_std": 3.0, "tilt_std_deg": 4.0, **changes})


TARGETS = np.array([[40.0, -25, 120], [60, -25, 120], [40, -10, 130]])


def lands(transforms, points=TARGETS):
    return np.einsum("nab,mb->nma", transforms[:, :3, :3], points) + transforms[:, None, :3, 3]


def test_the_same_seed_is_the_same_and_few_are_the_first_of_many():
    many = model().sample(520, 5)  # more than one chunk
    for n in (1, 130, 505):
        assert np.array_equal(model().sample(n, 5), many[:n])
    assert np.array_equal(model().sample(40, np.random.default_rng(5)), many[:40])
    assert not np.array_equal(model().sample(40, 6), many[:40])
    fits = model().register(130, 5)
    assert fits.converged.shape == fits.iterations.shape == fits.rms.shape == (130,)
    generator = np.random.default_rng(5)
    first, second = model().sample(10, generator), model().sample(10, generator)
    assert not np.array_equal(first, second)


@pytest.mark.parametrize("changes", [{}, {"vertex_share": 1.0, "resample_patch": False}])
def test_a_sample_is_the_inverse_of_the_fit_composed_with_its_start(changes):
    one = model(**changes)
    fits = one.register(30, 2)
    np.testing.assert_allclose(one.sample(30, 2) @ fits.transforms, np.tile(np.eye(4), (30, 1, 1)), atol=1e-9)
    turns = fits.transforms[:, :3, :3]
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (30, 1, 1)), atol=1e-9)
    assert (np.linalg.det(turns) > 0.99).all() and (fits.transforms[:, 3] == [0, 0, 0, 1]).all()


def test_the_patch_lies_on_the_surface_after_registration_wherever_it_started():
    one = model(digitiser_std=0.0, resample_patch=False, vertex_share=1.0, position_std=6.0)
    fits = one.register(60, 3)
    tree = cKDTree(one.vertices)
    at_rest = np.sqrt((tree.query(one.patch)[0] ** 2).mean())
    appear = lands(fits.transforms, one.patch)
    far = np.sqrt((tree.query(appear)[0] ** 2).mean(axis=1))
    np.testing.assert_allclose(far, fits.rms, atol=1e-6)
    assert np.quantile(far, 0.9) < 1.5 * at_rest
    # before the fit it is some millimetres off; starts are no part of what sample() says
    starts = one.starts(60, np.random.default_rng(3))
    assert np.median(tree.query(lands(starts, one.patch))[0].mean(axis=1)) > 1.0
    # by hand: the fit of one start, made with the same settings
    by_hand = register_surface(one.tree, one.patch, starts[:3], one.settings)
    for transform, start in zip(by_hand.transforms, starts, strict=False):
        moved = lands(transform[None], one.patch)[0]
        assert np.sqrt((tree.query(moved)[0] ** 2).mean()) < 1.5 * at_rest + 0.1
        assert not np.allclose(transform, start, atol=0.05)


def test_the_image_point_lands_where_the_fit_puts_it_back_from():
    one = model()
    transforms, fits = one.sample(20, 1), one.register(20, 1)
    there = lands(transforms)  # where image points land on the patient
    back = np.einsum("nab,nmb->nma", fits.transforms[:, :3, :3], there) + fits.transforms[:, None, :3, 3]
    np.testing.assert_allclose(back, np.broadcast_to(TARGETS, back.shape), atol=1e-9)


def test_starts_have_the_deviations_that_are_asked_for():
    one = model(position_std=2.0, tilt_std_deg=3.0)
    starts = one.starts(6000, 0)
    centre = one.patch.mean(axis=0)
    shift = lands(starts, centre[None])[:, 0] - centre
    np.testing.assert_allclose(shift.std(axis=0), 2.0, rtol=0.05)
    turns = Rotation.from_matrix(starts[:, :3, :3]).as_rotvec(degrees=True)
    angle = np.linalg.norm(turns, axis=1)
    assert stats.kstest(angle, stats.halfnorm(scale=3.0).cdf).pvalue > 1e-3
    normal = np.linalg.svd(one.patch - centre, full_matrices=False)[2][2]
    assert np.abs(turns @ normal).max() < 1e-6  # about axes in the patch's plane
    plane = np.linalg.svd(one.patch - centre, full_matrices=False)[2][:2]
    about = np.arctan2(*(turns @ plane.T).T)
    assert stats.kstest((about + np.pi) / (2 * np.pi), "uniform").pvalue > 1e-3
    assert np.abs(shift.mean(axis=0)).max() < 0.15


def test_no_error_is_the_identity():
    exact = SurfaceRegistration(
        body().vertices,
        body().vertices[body().vertices[:, 2] > 130][::8],
        0.0,
        0.0,
        digitiser_std=0.0,
        vertex_share=1.0,
        resample_patch=False,
        truth="given",
    )
    np.testing.assert_allclose(exact.sample(5, 0), np.tile(np.eye(4), (5, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(exact.tre_covariance(TARGETS), 0, atol=1e-12)
    # fitted: wherever the truth is, starting from it is a fixed point
    quiet = {"position_std": 0.0, "tilt_std_deg": 0.0, "digitiser_std": 0.0, "resample_patch": False}
    fitted = model(truth="fitted", vertex_share=1.0, **quiet)
    np.testing.assert_allclose(fitted.sample(3, 0), np.tile(np.eye(4), (3, 1, 1)), atol=1e-3)


def scatter(one, n=120, seed=4):
    """Root of the mean variance of where targets land, mm."""
    return float(np.sqrt(lands(one.sample(n, seed)).var(axis=0).sum(axis=1).mean()))


def test_how_far_registrations_scatter_depends_on_when_icp_stops():
    converged = scatter(model(position_std=5.0, tilt_std_deg=5.0))
    perfect = scatter(
        model(
            position_std=5.0,
            tilt_std_deg=5.0,
            digitiser_std=0.0,
            resample_patch=False,
            vertex_share=1.0,
            truth="fitted",
        )
    )
    published = scatter(SurfaceRegistration.published(body(), swab()))
    assert published > 1.2 * converged and published > 2 * perfect
    fits = model().register(50, 0), SurfaceRegistration.published(body(), swab()).register(50, 0)
    assert fits[0].converged.mean() > 0.9
    assert fits[1].iterations.max() <= 20 and fits[1].settings == IcpSettings.published()
    # more iterations of the same fits scatter less
    one = SurfaceRegistration.published(body(), swab())
    stopped = [scatter(replace(one, settings=IcpSettings(max_iterations=most)), 60) for most in (2, 10, 200)]
    assert stopped[0] > stopped[1] > stopped[2]


def test_every_cause_adds_scatter_of_its_own():
    quiet = {"digitiser_std": 0.0, "resample_patch": False, "vertex_share": 1.0, "truth": "fitted"}
    least = scatter(model(**quiet))
    for louder in ({"digitiser_std": 1.5}, {"vertex_share": 0.1}, {"resample_patch": True}):
        assert scatter(model(**{**quiet, **louder})) > 1.2 * least


def test_moments_and_bias_are_those_of_the_draws():
    one = model()
    drawn = lands(one.sample(1200, 11))
    expected = np.array([np.cov(drawn[:, m], rowvar=False) for m in range(len(TARGETS))])
    found = one.tre_covariance(TARGETS)
    assert np.abs(found - expected).max() < 0.25 * np.abs(expected).max()
    np.testing.assert_allclose(displacement_moments(one).at(TARGETS), found)
    np.testing.assert_allclose(one.bias(TARGETS), drawn.mean(axis=0) - TARGETS, atol=0.25)
    # nobody else's registrations: no seed of a user's gives them
    assert not np.array_equal(one.sample(5, 0), one._drawn[:5])
    assert np.allclose(sampled_moments(one._drawn).at(TARGETS), found)


def test_the_truth_may_be_chosen():
    off = swab() + np.array([0.0, 0, 0.8])
    given, fitted, projected = (
        SurfaceRegistration(body(), off, truth=truth).patch for truth in ("given", "fitted", "projected")
    )
    assert np.array_equal(given, off)
    assert np.abs(body().nearest.signed_distance(projected)).max() < 1e-6
    tree = cKDTree(body().vertices)
    assert (tree.query(fitted)[0] ** 2).mean() <= (tree.query(off)[0] ** 2).mean()
    moved = fitted - off
    assert np.ptp(np.linalg.norm(fitted - fitted[0], axis=1) - np.linalg.norm(off - off[0], axis=1)) < 1e-9
    assert np.linalg.norm(moved, axis=1).max() > 0.1
    assert SurfaceRegistration(body(), swab()).truth == "projected"
    assert SurfaceRegistration(body().vertices, swab()).truth == "fitted"
    with pytest.raises(InputError, match=r"truth: expected one of .*got 'mesh'"):
        SurfaceRegistration(body(), swab(), truth="mesh")
    with pytest.raises(InputError, match="'projected' for a mesh alone"):
        SurfaceRegistration(body().vertices, swab(), truth="projected")


def test_tracings_keep_the_digitiser_error_they_were_drawn_with():
    one = model(digitiser_std=0.5)
    tracings = one.digitised(3, 7)
    again = one.digitised(3, 7)
    errors = np.array([tracing.patch - one.patch for tracing in tracings])
    assert errors.std() == pytest.approx(0.5, rel=0.1)
    assert all(np.array_equal(a.patch, b.patch) for a, b in zip(tracings, again, strict=True))
    for tracing in tracings:
        assert tracing.digitiser_std == 0 and tracing.truth == "given" and not tracing.resample_patch
        assert (tracing.position_std, tracing.tilt_std_deg) == (one.position_std, one.tilt_std_deg)
        # each is a little off, always the same way, and scatters less than all of them together
        assert scatter(tracing, 80) < scatter(one, 80)
    offsets = [lands(tracing.sample(80, 1)).mean(axis=0) for tracing in tracings]
    assert np.ptp(offsets, axis=0).max() > 0.02


VERTICES = np.array(body().vertices)
WRONG = [
    ({"swab": swab() / 1000}, GeometryError, "Is the unit mm"),
    ({"surface": VERTICES / 1000}, GeometryError, "Is the unit mm"),
    ({"swab": swab() + np.array([0, 0, 60.0])}, GeometryError, r"align_surface\(surface, swab\)"),
    ({"swab": swab()[:2]}, InputError, "at least 3 points, got 2"),
    ({"swab": np.linspace([30.0, -25, 137], [50, -22, 138], 30)}, InputError, "line"),
    ({"swab": np.where(np.arange(120)[:, None] == 7, np.nan, swab())}, InputError, "swab: expected finite"),
    ({"swab": swab()[:, :2]}, InputError, r"swab: expected an array of shape \(n, 3\)"),
    (
        {"surface": np.where(np.arange(10242)[:, None] == 7, np.inf, VERTICES)},
        InputError,
        "surface.*finite",
    ),
    ({"surface": np.zeros((0, 3))}, InputError, "surface: expected at least 4 points, got 0"),
    ({"surface": trimesh.Trimesh()}, InputError, "surface"),
    ({"position_std": -1.0}, InputError, "position_std: expected .* at least 0 mm, got -1"),
    ({"position_std": np.nan}, InputError, "position_std"),
    ({"position_std": [1, 2, 3]}, InputError, "position_std"),
    ({"tilt_std_deg": -0.1}, InputError, "tilt_std_deg: expected .* degrees, got -0.1"),
    ({"tilt_std_deg": np.inf}, InputError, "tilt_std_deg"),
    ({"digitiser_std": -0.3}, InputError, "digitiser_std"),
    ({"vertex_share": 0}, InputError, r"vertex_share: expected a number in \(0, 1\], got 0"),
    ({"vertex_share": 1.01}, InputError, "vertex_share"),
    ({"vertex_share": -0.5}, InputError, "vertex_share"),
    ({"vertex_share": np.nan}, InputError, "vertex_share"),
    ({"vertex_share": "half"}, InputError, "vertex_share"),
    ({"settings": 20}, InputError, "settings: expected IcpSettings, got int"),
]


IDS = [f"{n} {next(iter(wrong[0]))}" for n, wrong in enumerate(WRONG)]


@pytest.mark.parametrize("given, kind, said", WRONG, ids=IDS)
def test_what_cannot_be_is_refused_by_name(given, kind, said):
    with pytest.raises(kind, match=said):
        SurfaceRegistration(**{"surface": body(), "swab": swab(), **given})


@pytest.mark.parametrize("n", [0, -1, 2.5, True, "10", None])
def test_numbers_of_registrations_that_are_none(n):
    with pytest.raises(InputError, match="n: expected a positive whole number"):
        model().sample(n)


def test_too_few_vertices_or_points_to_draw_from_are_refused_at_once():
    with pytest.raises(InputError, match=r"vertex_share: .* 30 vertices or more, got 0\.001 of 10242"):
        SurfaceRegistration(body(), swab(), vertex_share=0.001)
    # of three points with replacement all may be the same one
    with pytest.raises(InputError, match=r"at least 10 points .*resample_patch.*, got 3"):
        SurfaceRegistration(body(), swab()[[0, 50, 100]])
    three = SurfaceRegistration(body(), swab()[[0, 50, 100]], resample_patch=False)
    assert three.sample(20, 0).shape == (20, 4, 4)
    sparse = SurfaceRegistration(body(), swab()[:10], vertex_share=0.004)
    assert np.isfinite(sparse.sample(300, 0)).all()


def test_a_margin_around_a_nerve_from_a_traced_temporal_bone():
    """Nothing of it is about kidneys: the cortex behind an ear is traced, a facial nerve is protected."""
    case = specimen("TB14")
    hollow = ("air", "external_auditory_canal", "air_cells", "middle_ear")
    solid = [name for name in case.anatomy.names if name not in hollow]
    mesh = surface(case.anatomy, solid, smooth_mm=0.6, pitch_mm=1.5)
    side = -1 if case.side == "right" else 1  # lateral in LPS
    points, faces = trimesh.sample.sample_surface(mesh, 6000, seed=0)
    outward = mesh.face_normals[faces][:, 0] * side > 0.4
    nerve = case.anatomy.points(np.argwhere(case.anatomy.mask("facial_nerve")).astype(float))
    far = points - nerve.mean(axis=0)
    lateral = (far[:, 0] * side > 6) & (np.linalg.norm(far, axis=1) < 30)
    traced = np.asarray(points[outward & lateral][:120])
    assert len(traced) > 100
    error = SurfaceRegistration(mesh, traced, position_std=2.0, tilt_std_deg=3.0, digitiser_std=0.15)
    assert error.register(60, 0).converged.mean() > 0.8
    few = GrowthSettings(registrations=300, validation_registrations=200)
    margin = grow_margin(case.anatomy, "facial_nerve", error, 0.05, settings=few, rng=0, purpose="protect")
    assert margin.voxels > 0 and margin.damage_risk <= 0.05
    assert margin.validation.interval[0] <= 0.05
    deviation = np.sqrt(np.trace(error.tre_covariance(nerve), axis1=1, axis2=2)).mean()
    assert 0.02 < deviation < 2.0
    assert margin.inside.sum() > margin.structure_mask.sum()
