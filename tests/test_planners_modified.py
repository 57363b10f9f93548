"""Modified volume, supervoxel, swept moves: against plain geometry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from planning_cases import small_cone
from scipy import ndimage

from study.errors import LabelError, PlanningError
from study.planners import modified_volume
from study.planners.planning import supervoxel_reach, swept_moves
from study.planners.simulation import _kernels as simulation
from study.volumes import PLANNING_NAMES, LabelVolume, ball_element


def blobs(seed, shape=(22, 24, 20)):
    rng = np.random.default_rng(seed)
    field = ndimage.gaussian_filter(rng.normal(size=shape), 2.5)
    labels = np.digitize(field, np.quantile(field, [0.3, 0.5])).astype(np.uint8)
    labels = np.choose(labels, [1, 0, 2]).astype(np.uint8)
    labels[[0, -1]] = labels[:, [0, -1]] = labels[:, :, [0, -1]] = 1
    return labels


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), radius=st.sampled_from([0.7, 1.0, 1.3]))
def test_modified_volume_matches_morphology_done_plainly(seed, radius):
    spacing = np.random.default_rng(seed).uniform(0.3, 0.6, 3)
    labels = blobs(seed)
    volume = LabelVolume(labels, np.diag([*spacing, 1.0]), PLANNING_NAMES)
    element = ball_element(radius, spacing)
    outside_is_bone = ndimage.binary_dilation(np.pad(labels == 1, 9, constant_values=True), element)
    allowed = ~outside_is_bone[9:-9, 9:-9, 9:-9]
    eroded = (labels == 2) & allowed
    if not eroded.any():
        with pytest.raises(PlanningError, match="fits nowhere"):
            modified_volume(volume, radius)
        return
    modified = modified_volume(volume, radius)
    target = eroded | ((labels == 0) & allowed & ndimage.binary_dilation(eroded, element))
    assert np.array_equal(modified.target, target)
    near = ndimage.binary_dilation(target, iterations=1)
    assert np.array_equal(modified.allowed & near, allowed & near)
    boundary = np.zeros_like(target)
    solid_outside = (labels != 0) & ~target
    for axis in range(3):
        for step in (1, -1):
            boundary |= target & np.roll(solid_outside, step, axis)
    assert np.array_equal(modified.boundary, boundary)
    vertices = modified_volume(volume, radius, boundary_connectivity=26)
    near_solid = ndimage.binary_dilation(solid_outside, np.ones((3, 3, 3)))
    assert np.array_equal(vertices.boundary, target & near_solid)
    reached = ndimage.binary_dilation(modified.allowed, element)
    assert np.array_equal(modified.unreachable, (labels == 2) & ~reached)
    assert modified.target_cm3 == pytest.approx(target.sum() * np.prod(spacing) / 1000)


@pytest.mark.parametrize(
    ("depth", "spacing", "size"), [(1.0, 0.4, 5), (0.5, 0.4, 3), (0.3, 0.4, 1), (1.0, 0.3, 7)]
)
def test_supervoxel_has_the_odd_size_of_the_cutting_depth(depth, spacing, size):
    assert (2 * supervoxel_reach(depth, np.full(3, spacing)) + 1 == size).all()


@settings(max_examples=200, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_moving_ball_overlaps_a_box_when_a_dense_walk_does(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.uniform(-2, 2, (2, 3))
    half, radius = rng.uniform(0.1, 0.5, 3), rng.uniform(0.2, 1.5)
    walk = a + np.linspace(0, 1, 4001)[:, None] * (b - a)
    distance = np.linalg.norm(np.maximum(np.abs(walk) - half, 0), axis=1).min()
    if abs(distance - radius) > 1e-3:
        assert simulation.segment_overlaps_box(*a, *b, *half, radius) == (distance < radius)


def test_swept_parts_are_what_a_dense_walk_adds():
    steps, radius = np.array([0.4, 0.35, 0.45]), 1.1
    first, count, offsets = swept_moves(2, steps, radius)
    for move in [(1, 0, 0), (2, 1, 0), (2, 2, 2), (0, 1, 2)]:
        found = set()
        for part in range(1, max(move) + 1):
            start = first[(*move, part)]
            found |= {tuple(o) for o in offsets[start : start + count[(*move, part)]]}
        grid = np.stack(np.meshgrid(*[np.arange(-6, 9)] * 3, indexing="ij"), -1).reshape(-1, 3)
        walk = np.linspace(0, 1, 801)[:, None] * np.array(move)
        gap = np.full(len(grid), np.inf)
        for position in walk:
            nearest = np.maximum(np.abs((grid - position) * steps) - steps / 2, 0)
            gap = np.minimum(gap, np.linalg.norm(nearest, axis=1))
        sure = np.abs(gap - radius) > 1e-4
        before = np.linalg.norm(np.maximum(np.abs(grid * steps) - steps / 2, 0), axis=1) < radius
        expected = {tuple(g) for g in grid[sure & (gap < radius) & ~before]}
        assert {f for f in found if tuple(f) in {tuple(g) for g in grid[sure]}} == expected


def test_what_is_neither_air_nor_target_is_protected():
    volume = small_cone()
    labels = volume.labels.copy()
    labels[20, 10:14, 10:14] = 7
    named = LabelVolume(labels, volume.affine, PLANNING_NAMES | {"facial_nerve": 7})
    plain = np.where(labels == 7, 1, labels)
    a = modified_volume(named, 2.5)
    b = modified_volume(volume.with_labels(plain), 2.5)
    assert np.array_equal(a.target, b.target) and np.array_equal(a.allowed, b.allowed)


@pytest.mark.parametrize("missing", ["air", "target"])
def test_missing_labels_are_named(missing):
    volume = small_cone()
    names = {("other" if name == missing else name): value for name, value in volume.names.items()}
    with pytest.raises(LabelError, match=missing):
        modified_volume(volume.with_labels(volume.labels, names), 2.5)


def test_no_target_edge_target_and_large_burr_are_refused():
    volume = small_cone()
    with pytest.raises(PlanningError, match="no voxel labelled 'target'"):
        modified_volume(volume.with_labels(np.minimum(volume.labels, 1)), 2.5)
    with pytest.raises(PlanningError, match="fits nowhere"):
        modified_volume(volume, 9.0)
    labels = volume.labels.copy()
    labels[15, 0, 12:16] = 2
    with pytest.raises(PlanningError, match="first plane of axis j"):
        modified_volume(volume.with_labels(labels), 2.5)
