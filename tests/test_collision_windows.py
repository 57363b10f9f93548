"""4-DOF accessibility against sweeping a shaft through the collapsed slab, angle by angle."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from study.collision import Drill, build_shaft, window
from study.collision import _kernels as kernels
from study.collision.exact import _kernels as exact
from study.errors import InputError


def collapsed_cells(solid, shaft, layer, i):
    """(n, 2) depth, lateral cells of the slab of cylinder i, by plain numpy."""
    reach = int(shaft.half[i])
    slab = solid[max(0, layer - reach) : layer + reach + 1]
    return np.argwhere(slab.any(axis=0))


def strip_overlaps_boxes(theta, u, w, half_u, half_w, start, radius):
    """Separating axes of a half-infinite strip and boxes (arrays of centres): exact for convex shapes."""
    c, s = np.cos(theta), np.sin(theta)
    t, m = u * c + w * s, -u * s + w * c
    along, across = half_u * c + half_w * abs(s), half_u * abs(s) + half_w * c
    overlap = (t + along > start) & (np.abs(m) < radius + across)
    # the box's own axes: the strip runs to infinity outwards, so only its near corners can separate
    corners_u = [start * c - side * radius * s for side in (-1, 1)]
    corners_w = [start * s + side * radius * c for side in (-1, 1)]
    overlap &= u + half_u > min(corners_u)
    if s > 0:
        overlap &= w + half_w > min(corners_w)
    elif s < 0:
        overlap &= w - half_w < max(corners_w)
    else:
        overlap &= (w + half_w > min(corners_w)) & (w - half_w < max(corners_w))
    return overlap


def is_free(solid, shaft, position, theta):
    layer, depth, lateral = position
    for i in range(3):
        cells = collapsed_cells(solid, shaft, layer, i)
        if len(cells) == 0:
            continue
        u = (depth - cells[:, 0]) * shaft.step_depth
        w = (cells[:, 1] - lateral) * shaft.step_lateral
        hit = strip_overlaps_boxes(
            theta, u, w, shaft.step_depth / 2, shaft.step_lateral / 2, shaft.start[i], shaft.radius[i]
        )
        near_u = np.maximum(np.abs(u) - shaft.step_depth / 2, 0)
        near_w = np.maximum(np.abs(w) - shaft.step_lateral / 2, 0)
        across = max(0.0, int(shaft.half[i]) - 0.5) * shaft.step_layer
        inside_burr = near_u**2 + near_w**2 + across**2 < shaft.burr_radius**2 * (1 - 1e-12)
        if (hit & ~inside_burr).any():
            return False
    return True


SMALL = Drill(burr_diameter=3.0, shaft_diameters=(1.2, 3.4, 5.0), shaft_ends=(5.0, 8.0, 60.0))


def random_case(seed, density):
    rng = np.random.default_rng(seed)
    shape = (9, 30, 70)
    solid = (rng.random(shape) < density).astype(np.uint8)
    # walls, so that windows have edges on both sides
    solid[:, 5:, : rng.integers(5, 30)] = 1
    solid[:, rng.integers(3, 20) :, rng.integers(42, 66) :] = 1
    position = (int(rng.integers(2, 7)), int(rng.integers(10, 29)), int(rng.integers(28, 44)))
    steps = rng.uniform(0.3, 0.5, 3)
    return solid, steps, position


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), density=st.sampled_from([0.0, 0.0005, 0.003, 0.02]))
def test_window_matches_sweeping_the_shaft(seed, density):
    solid, steps, position = random_case(seed, density)
    shaft = build_shaft(solid, steps, SMALL, np.deg2rad(60))
    found = window(shaft, position)
    tilts = np.deg2rad(np.linspace(-59.9, 59.9, 241))
    free = np.array([is_free(solid, shaft, position, tilt) for tilt in tilts])
    if found is None:
        assert not free.any() or np.diff(np.flatnonzero(free)).size == 0
        return
    low, high = found
    inside = (tilts > low) & (tilts < high)
    assert free[inside].all()
    # the edges are real: just outside the shaft hits, unless the robot's limit is reached
    for edge, outwards in ((low, -1), (high, 1)):
        if abs(edge) < np.deg2rad(60) - 1e-9:
            assert not is_free(solid, shaft, position, edge + outwards * 1e-6)
            assert is_free(solid, shaft, position, edge - outwards * 1e-6)
    # and no other range overlaps the whole cone more
    runs = np.split(np.flatnonzero(free), np.flatnonzero(np.diff(np.flatnonzero(free)) > 1) + 1)
    widest = max((tilts[run[-1]] - tilts[run[0]] for run in runs if len(run)), default=0.0)
    assert high - low >= widest - 1e-12


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_pose_check_is_never_free_where_the_strip_hits(seed):
    solid, steps, position = random_case(seed, 0.003)
    shaft = build_shaft(solid, steps, SMALL, np.deg2rad(60))
    for tilt in np.deg2rad(np.linspace(-55, 55, 23)):
        free = kernels.pose_is_free(shaft, *(float(p) for p in position), tilt)
        assert not (free and not is_free(solid, shaft, position, tilt))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_slabs_follow_the_milling(seed):
    rng = np.random.default_rng(seed)
    solid, steps, _ = random_case(seed, 0.01)
    shaft = build_shaft(solid, steps, SMALL, np.deg2rad(45))
    voxels = np.argwhere(solid)
    for voxel in voxels[rng.permutation(len(voxels))[:500]]:
        solid[tuple(voxel)] = 0
        kernels.remove_from_slabs(shaft, *(int(v) for v in voxel))
    fresh = build_shaft(solid, steps, SMALL, np.deg2rad(45))
    assert np.array_equal(shaft.slab, fresh.slab)
    assert np.array_equal(shaft.bits, fresh.bits)
    for i in range(3):
        cells = np.zeros(solid.shape[1:], bool)
        cells[tuple(collapsed_cells(solid, shaft, 4, i).T)] = True
        assert np.array_equal(shaft.slab[i, 4] > 0, cells)


def brute_cylinder_distance(centre, axis, radius, start, end, low, high, rng):
    """Whether a dense sample of the box lies in the cylinder: a lower bound of overlap."""
    points = rng.uniform(low, high, (4000, 3)) - centre
    t = points @ axis
    radial = np.linalg.norm(points - t[:, None] * axis, axis=1)
    return bool(((t > start) & (t < end) & (radial < radius)).any())


@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 10**6))
def test_exact_cylinder_never_misses_a_sampled_overlap_and_never_invents_one(seed):
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    if seed % 5 == 0:
        axis = np.eye(3)[seed % 3]
    centre, low = rng.uniform(-1, 1, 3), rng.uniform(-2, 2, 3)
    high = low + rng.uniform(0.2, 0.6, 3)
    radius, start = rng.uniform(0.2, 1.0), rng.uniform(0, 1)
    end = start + rng.uniform(0.2, 2)
    answer = exact.cylinder_overlaps_box(centre, axis, radius, start, end, low, high)
    if brute_cylinder_distance(centre, axis, radius, start, end, low, high, rng):
        assert answer
    else:
        # nothing sampled: then a slightly smaller cylinder and box cannot overlap deeply
        shrunk = exact.cylinder_overlaps_box(
            centre, axis, radius - 0.12, start + 0.06, end - 0.06, low + 0.05, high - 0.05
        )
        assert not shrunk or radius <= 0.12


def test_axis_through_the_box_overlaps_and_touching_does_not():
    box = np.array([-0.5, -0.5, 2.0]), np.array([0.5, 0.5, 3.0])
    axis, centre = np.array([0.0, 0.0, 1.0]), np.zeros(3)
    assert exact.cylinder_overlaps_box(centre, axis, 0.1, 0.0, 2.5, *box)
    assert not exact.cylinder_overlaps_box(centre, axis, 0.1, 0.0, 2.0, *box)
    beside = np.array([0.6, 0.0, 0.0])
    assert not exact.cylinder_overlaps_box(beside, axis, 0.1, 0.0, 5.0, *box)
    assert exact.cylinder_overlaps_box(beside, axis, 0.1001, 0.0, 5.0, *box)


@pytest.mark.parametrize(
    "arguments",
    [
        {"burr_diameter": -5},
        {"burr_diameter": float("nan")},
        {"shaft_diameters": (6.0, 6.8, 11.6)},
        {"shaft_diameters": (2.4, 1.0, 11.6)},
        {"shaft_ends": (20.0, 10.0, 110.0)},
    ],
)
def test_impossible_drills_are_refused(arguments):
    with pytest.raises(InputError):
        Drill(**arguments)


def test_too_fine_voxels_are_refused():
    with pytest.raises(InputError, match="spacing"):
        build_shaft(np.zeros((3, 3, 3), np.uint8), np.full(3, 0.02), Drill(), 0.5)


@pytest.mark.parametrize("steps", [(0.4, 0.4, 0.4), (0.2, 0.35, 0.5)])
def test_blocked_intervals_have_the_shape_the_row_scan_relies_on(steps):
    drill = Drill()
    shaft = build_shaft(np.zeros((3, 120, 3), np.uint8), np.array(steps), drill, np.deg2rad(45))
    for i in range(3):
        for row in range(shaft.low.shape[1]):
            low, high = shaft.low[i, row], shaft.high[i, row]
            blocking = np.flatnonzero(low != np.inf)
            if len(blocking) == 0:
                continue
            assert blocking[0] == shaft.near[i, row]
            assert len(blocking) == len(low) - blocking[0]
            valley = shaft.valley[i, row]
            assert (np.diff(low[blocking[0] : valley + 1]) <= 1e-12).all()
            assert (np.diff(low[valley:]) >= -1e-12).all()
            within = high[blocking] < np.pi / 2  # beyond a right angle no tilt reaches
            assert (np.diff(high[blocking][within]) >= -1e-12).all()
