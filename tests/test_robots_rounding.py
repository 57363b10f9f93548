"""Rounded corners: how far, how short, how safe."""

import numpy as np
import pytest
from fake_plans import fake_plan, random_walk
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from study.errors import InputError
from study.robots import RoundingSettings, round_corners, rounding_is_safe
from study.robots.rounding import round_plan


def dense(path, step=0.02):
    """Places along the rounded path, `step` mm of planned length apart, and the step each lies in."""
    s = np.arange(0, path.planned_length_mm, step)
    steps = np.searchsorted(path.planned_s, s, side="right") - 1
    return path.at(steps, s), s, steps


def distance_to_polyline(places, points):
    """Brute force: least distance of each place to any segment."""
    a, b = points[:-1], points[1:]
    ab = b - a
    t = np.einsum("pkj,kj->pk", places[:, None] - a[None], ab)
    t = np.clip(t / np.maximum(np.einsum("kj,kj->k", ab, ab), 1e-30), 0, 1)
    return np.linalg.norm(places[:, None] - (a + t[..., None] * ab), axis=2).min(axis=1)


@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), diagonal=st.booleans(), tolerance=st.sampled_from([0.05, 0.2, 0.7]))
def test_the_rounded_path_stays_within_the_tolerance_and_is_not_longer(seed, diagonal, tolerance):
    points = 0.4 * random_walk(np.random.default_rng(seed), 60, diagonal=diagonal)
    path = round_corners(points, None, tolerance)
    places, _, _ = dense(path)
    assert distance_to_polyline(places, path.points).max() <= tolerance + 1e-9
    assert path.length_mm <= path.planned_length_mm + 1e-9
    assert (np.diff(path.rounded_s) >= -1e-12).all()
    # The length that is booked is the length of the curve.
    fine, _, _ = dense(path, 0.001)
    chords = np.linalg.norm(np.diff(fine, axis=0), axis=1).sum()
    assert chords == pytest.approx(path.length_mm, abs=0.002 + 1e-3 * path.length_mm)
    # The curve and its direction have no jump: neighbouring places are no further apart than the step.
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() <= 0.02 + 1e-9


def test_a_right_angle_becomes_a_quarter_circle():
    points = np.array([[0.0, 0, 0], [2, 0, 0], [2, 3, 0]])
    path = round_corners(points, None, 0.2)
    reach = 0.2 / np.tan(np.pi / 8)
    assert path.reaches == pytest.approx([reach])
    assert path.length_mm == pytest.approx(5 - 2 * reach + np.pi / 2 * reach)
    middle = path.at(np.array([0]), np.array([2.0]))[0]
    assert np.linalg.norm(middle - [2, 0, 0]) == pytest.approx(0.2)
    np.testing.assert_allclose(middle, [2 - 0.2 / np.sqrt(2), 0.2 / np.sqrt(2), 0])


def test_a_staircase_loses_what_quarter_circles_of_half_a_step_save():
    steps = np.tile([[1, 0, 0], [0, 1, 0]], (500, 1))
    points = np.vstack([[0, 0, 0], np.cumsum(steps, axis=0)]).astype(float)
    path = round_corners(points, None, 0.5)
    corners = len(points) - 2
    assert path.shortening == pytest.approx(corners * (1 - np.pi / 4) / len(steps))


def test_a_straight_line_and_a_reversal_keep_their_length():
    there = np.array([[i, 0, 0] for i in range(10)], float)
    path = round_corners(np.vstack([there, there[::-1][1:]]), None, 0.5)
    assert path.length_mm == path.planned_length_mm == 18


def test_the_drill_rotates_where_it_was_planned_to():
    points = np.array([[0, 0, 0], [3, 0, 0], [3, 0, 0], [3, 3, 0], [6, 3, 0]], float)
    axes = np.array([[0, 0, 1], [0, 0, 1], [0, 0.6, 0.8], [0, 0.6, 0.8], [0, 0.6, 0.8]])
    path = round_corners(points, axes, 0.5)
    assert path.reaches[0] == 0
    assert path.reaches[1] > 0
    assert path.rounded_s[1] == path.rounded_s[2] == 3


def cut_by(places, voxels, spacing, radius):
    """Which boxes (m, 3) the ball overlaps at any of the places (mm, voxel (0, 0, 0) centred at 0)."""
    cut = np.zeros(len(voxels), bool)
    near = cKDTree(voxels * spacing).query_ball_point(places, radius + np.linalg.norm(spacing) / 2)
    for place, rows in zip(places, near, strict=True):
        gap = np.maximum(np.abs(place - voxels[rows] * spacing) - spacing / 2, 0)
        cut[rows] |= (gap**2).sum(axis=1) < radius**2 * (1 - 1e-12)
    return cut


# Legs and arc lie in one plane, so the arc cuts more only where the ball barely enters a layer of
# voxels: these radii are just above 3.5 and 4.5 layers.
@pytest.mark.parametrize(
    ("spacing", "radius", "diagonal"),
    [((0.4, 0.4, 0.4), 1.407, False), ((0.4, 0.4, 0.4), 1.407, True), ((0.3, 0.5, 0.4), 1.3626, False)],
)
def test_no_rounded_corner_cuts_a_protected_voxel_that_the_planned_path_spares(spacing, radius, diagonal):
    spacing = np.array(spacing)
    grid = np.stack(np.meshgrid(*[np.arange(44)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    refused = 0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        walk = random_walk(rng, 80, size=44, diagonal=diagonal)
        # Protect much of what the planned path, densely sampled, does not touch.
        planned = np.vstack([dense(round_corners(walk * spacing, None, 0.0))[0], walk * spacing])
        spared = ~cut_by(planned, grid, spacing, radius + 0.001)
        labels = np.zeros((44, 44, 44), np.uint8)
        chosen = grid[spared][rng.random(spared.sum()) < 0.5]
        labels[tuple(chosen.T)] = 1
        plan = fake_plan(walk, labels, spacing=spacing, burr_radius=radius)
        origin = plan.modified.volume.affine[:3, 3]
        hasty = round_plan(plan, RoundingSettings(keep_unsafe_corners=False))
        careful = round_plan(plan)
        assert not cut_by(dense(careful)[0] - origin, chosen, spacing, radius).any()
        safe = rounding_is_safe(plan, hasty)
        np.testing.assert_array_equal(careful.reaches == 0, (hasty.reaches == 0) | ~safe)
        if cut_by(dense(hasty)[0] - origin, chosen, spacing, radius).any():
            refused += 1
        # It does not keep corners for nothing: a refused arc comes within a fiftieth of a voxel of bone.
        for corner in np.flatnonzero(~safe):
            s = hasty.planned_s[hasty.corners[corner]] + np.linspace(-1, 1, 101) * hasty.reaches[corner]
            steps = np.searchsorted(hasty.planned_s, s, side="right") - 1
            assert cut_by(hasty.at(steps, s) - origin, chosen, spacing, radius + 0.02 * spacing.min()).any()
    assert refused > 0, "no case would have cut bone: nothing was tested"


def test_beyond_the_image_counts_as_protected():
    walk = random_walk(np.random.default_rng(8), 120, size=32)
    whole = np.ones((32, 32, 32), np.uint8)
    whole[:24, :24, :24] = 0
    ending = fake_plan(walk, np.zeros((24, 24, 24), np.uint8), burr_radius=2.0)
    walled = fake_plan(walk, whole, burr_radius=2.0)
    path = round_corners(ending.points, None, 0.2)
    safe = rounding_is_safe(ending, path)
    assert 0 < safe.sum() < safe.size
    np.testing.assert_array_equal(safe, rounding_is_safe(walled, path))


def test_an_oblique_frame_gives_the_same_rounding():
    walk = random_walk(np.random.default_rng(3), 200, size=40)
    labels = (np.random.default_rng(4).random((40, 40, 40)) < 0.003).astype(np.uint8)
    turn = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 3)))[0]
    affine = np.eye(4)
    affine[:3, :3] = turn * 0.4
    straight = round_plan(fake_plan(walk, labels))
    oblique = round_plan(fake_plan(walk, labels, affine=affine))
    assert (straight.reaches == 0).any()
    np.testing.assert_allclose(oblique.reaches, straight.reaches, atol=1e-9)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((4, 2)), [[0, 0, np.nan]]])
def test_bad_points_are_refused(points):
    with pytest.raises(InputError, match="points"):
        round_corners(points, None, 0.2)


def test_bad_tolerances_are_refused():
    with pytest.raises(InputError, match="corner_tolerance"):
        RoundingSettings(corner_tolerance=-0.1)
    with pytest.raises(InputError, match="tolerance"):
        round_corners(np.zeros((1, 3)), None, np.nan)
