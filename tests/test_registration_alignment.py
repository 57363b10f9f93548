"""A swab is laid on its surface from anywhere, and what cannot be told apart is shown."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from study.errors import GeometryError, InputError
from study.registration import AlignmentSettings, SurfaceRegistration, align_surface
from study.registration.alignment.hypotheses import apart, different, farthest_points, patch_axes, poses
from study.registration.alignment.planes import TangentPlanes, fit_planes
from study.specimens import kidney_case, read_kidney_case
from tests.real_data import real

TARGET = 1.0  # mm, the project's for an alignment


@pytest.fixture(scope="module")
def kidney():
    return kidney_case("K1")


def moved_at_random(points, rng):
    """Points turned by a uniform rotation and moved far, and the transform that did it."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    motion[:3, 3] = rng.normal(0, 300, 3)
    return points @ motion[:3, :3].T + motion[:3, 3], motion


def off_truth(found, motion, points):
    """Root mean square distance of points from the truth once moved there and aligned back."""
    back = found @ motion
    return np.sqrt(((points @ back[:3, :3].T + back[:3, 3] - points) ** 2).sum(axis=1).mean())


def bumpy_ball():
    """An egg with a bump: a closed surface of which no two patches are alike."""
    ball = trimesh.creation.icosphere(4, 1.0)
    points = ball.vertices * [50, 30, 24]
    bump = np.array([[30.0, 20, 8], [-20, 10, 18], [-30, -18, 5]])
    for place, height in zip(bump, (9, -6, 5), strict=True):
        near = np.exp(-((points - place) ** 2).sum(axis=1) / (2 * 12.0**2))
        points = points + height * near[:, None] * ball.vertices
    return trimesh.Trimesh(points, ball.faces, process=False)


def cap(mesh, place, radius, count, rng, noise=0.3):
    """Points on a mesh within a ball."""
    points = trimesh.sample.sample_surface(mesh, 40 * count, seed=int(rng.integers(1 << 30)))[0]
    points = points[np.linalg.norm(points - place, axis=1) < radius][:count]
    return points + rng.normal(0, noise, points.shape)


def test_random_motions_are_undone(kidney):
    rng = np.random.default_rng(1)
    errors, ratios = [], []
    for n in range(20):
        # The outcome for one swab hardly depends on how it was moved: its noise is drawn anew as well.
        swab = kidney.swab + rng.normal(0, 0.3, kidney.swab.shape)
        swab, motion = moved_at_random(swab, rng)
        found = align_surface(kidney.surface, swab, rng=n)
        errors.append(off_truth(found.transform, motion, kidney.swab))
        ratios.append(found.ratio)
    assert np.mean(np.array(errors) < TARGET) >= 0.99
    assert min(ratios) > 1.5


def test_other_patches_and_bare_vertices():
    mesh, rng = bumpy_ball(), np.random.default_rng(2)
    errors = []
    for n in range(5):
        place = mesh.vertices[rng.integers(len(mesh.vertices))]
        swab = cap(mesh, place, 26.0, 500, rng)
        away, motion = moved_at_random(swab, rng)
        surface = np.asarray(mesh.vertices) if n % 2 else mesh
        found = align_surface(surface, away, rng=n)
        truth = fit_planes(
            TangentPlanes.of(np.asarray(mesh.vertices), np.array(mesh.vertex_normals), 20.0),
            swab - swab.mean(axis=0),
            np.eye(3)[None],
            swab.mean(axis=0)[None],
            0,
            True,
        )[2][0]
        assert found.rms < truth * 1.05  # nothing fits better and was missed
        errors.append(off_truth(found.transform, motion, swab))
    assert max(errors) < TARGET


@pytest.mark.parametrize("name", ["case_00063", "case_00071", "case_00091", "case_00101"])
def test_real_kidneys(name):
    case = read_kidney_case(real(f"kidney/{name}"))
    rng = np.random.default_rng(3)
    swab, motion = moved_at_random(case.swab, rng)
    found = align_surface(case.surface, swab)
    assert off_truth(found.transform, motion, case.swab) < TARGET
    assert found.ratio > 1.5


def test_same_seed_same_answer_and_it_moves_with_the_swab(kidney):
    first = align_surface(kidney.surface, kidney.swab, rng=5)
    again = align_surface(kidney.surface, kidney.swab, rng=5)
    np.testing.assert_array_equal(first.transform, again.transform)
    assert (first.rms, first.second_rms) == (again.rms, again.second_rms)
    swab, motion = moved_at_random(kidney.swab, np.random.default_rng(6))
    away = align_surface(kidney.surface, swab, rng=5)
    assert away.hypotheses == first.hypotheses
    assert off_truth(away.transform @ motion @ np.linalg.inv(first.transform), np.eye(4), kidney.swab) < 0.05
    assert away.rms == pytest.approx(first.rms, rel=0.01)
    np.testing.assert_allclose(first.transform[:3, :3] @ first.transform[:3, :3].T, np.eye(3), atol=1e-9)


def test_aligned_swab_starts_a_registration(kidney):
    swab, _ = moved_at_random(kidney.swab, np.random.default_rng(7))
    found = align_surface(kidney.surface, swab)
    aligned = swab @ found.transform[:3, :3].T + found.transform[:3, 3]
    fits = SurfaceRegistration(kidney.surface, aligned).register(4, rng=0)
    assert len(fits) == 4


def test_ambiguous_surface_shows():
    """On an ellipsoid every patch fits in four places: the next best is as good, and elsewhere."""
    ball = trimesh.creation.icosphere(4, 1.0)
    mesh = trimesh.Trimesh(ball.vertices * [50, 32, 22], ball.faces, process=False)
    swab = cap(mesh, np.array([25.0, 20, 13]), 25.0, 400, np.random.default_rng(8))
    found = align_surface(mesh, swab)
    assert found.ratio < 1.1
    assert found.second_apart > found.settings.distinct * 10


def test_around_searches_less(kidney):
    swab, motion = moved_at_random(kidney.swab, np.random.default_rng(9))
    start = np.linalg.inv(motion)
    start[:3, 3] += [6, -5, 4]
    whole = align_surface(kidney.surface, swab)
    found = align_surface(kidney.surface, swab, around=start, within=15.0)
    assert found.hypotheses < whole.hypotheses / 10
    assert off_truth(found.transform, motion, kidney.swab) < TARGET


def test_poses_are_the_same_for_either_sign_of_the_axes():
    rng = np.random.default_rng(10)
    swab = rng.normal(size=(60, 3)) * [20, 12, 3]
    swab -= swab.mean(axis=0)
    normals = np.array([[0.6, 0.0, 0.8]])
    turns, _ = poses(swab, np.zeros((1, 3)), normals, 45.0)
    assert len(turns) == 16
    np.testing.assert_allclose(np.linalg.det(turns), 1)
    axes = patch_axes(swab)
    for signs in ([-1, -1, 1], [1, -1, -1], [-1, 1, -1]):
        other = turns @ axes.T @ np.diag(signs) @ axes
        gaps = np.abs(other[:, None] - turns[None]).max(axis=(2, 3))
        assert gaps.min(axis=1).max() < 1e-9


def test_sites_cover_and_distances_are_those_of_the_points():
    rng = np.random.default_rng(11)
    points = rng.normal(size=(300, 3)) * 20
    chosen = farthest_points(points, 12.0, 0)
    gaps = np.linalg.norm(points[:, None] - points[chosen], axis=2)
    assert gaps.min(axis=1).max() <= 12.0
    between = np.linalg.norm(points[chosen][:, None] - points[chosen], axis=2)
    assert between[np.triu_indices(len(chosen), 1)].min() > 12.0
    swab = rng.normal(size=(40, 3))
    swab -= swab.mean(axis=0)
    turns, places = Rotation.random(30, random_state=rng).as_matrix(), rng.normal(size=(30, 3))
    moved = swab @ turns.transpose(0, 2, 1) + places[:, None]
    brute = np.sqrt(((moved - moved[4]) ** 2).sum(axis=2).mean(axis=1))
    np.testing.assert_allclose(apart(swab, turns, places, turns[4], places[4]), brute, atol=1e-6)
    best = different(swab, turns, places, np.arange(30.0)[::-1], 1.5, 5)
    assert best[0] == 29 and len(best) <= 5


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        (lambda s: s[:2], InputError, "at least 3 points"),
        (lambda s: np.linspace(0, 30, 20)[:, None] * [1.0, 2, 3], InputError, "one line"),
        (lambda s: s / 1000, GeometryError, "both in mm"),
        (lambda s: np.where(np.arange(len(s))[:, None] == 3, np.nan, s), InputError, "point 3"),
        (lambda s: s[None], InputError, "shape"),
    ],
)
def test_bad_swabs_are_named(kidney, change, error, words):
    with pytest.raises(error, match=words):
        align_surface(kidney.surface, change(kidney.swab))


def test_bad_surfaces_and_settings_are_named(kidney):
    swab = kidney.swab
    with pytest.raises(InputError, match="surface"):
        align_surface(np.zeros((0, 3)), swab)
    with pytest.raises(InputError, match="finite"):
        align_surface(np.full((10, 3), np.nan), swab)
    with pytest.raises(InputError, match="rigid"):
        align_surface(kidney.surface, swab, around=2 * np.eye(4))
    with pytest.raises(InputError, match="within"):
        align_surface(kidney.surface, swab, around=np.eye(4), within=-1.0)
    with pytest.raises(InputError, match="AlignmentSettings"):
        align_surface(kidney.surface, swab, settings=3)
    for values in ({"site_spacing": 0}, {"angle_step_deg": np.nan}, {"coarse_points": 2.5}, {"finalists": 1}):
        with pytest.raises(InputError, match=next(iter(values))):
            AlignmentSettings(**values)
