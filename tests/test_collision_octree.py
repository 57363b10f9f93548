import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shaft_poses import (
    LONG,
    SHORT,
    THIN,
    ShaftCase,
    cases,
    contacts,
    disagreements,
    overlaps,
    pocket_poses,
    poses,
    single_voxel,
)

from study.collision import Drill
from study.collision.exact._kernels import drill_overlaps_voxels
from study.collision.octree import OctreeCheck, surface_voxels
from study.errors import GeometryError, InputError

SPACING = np.full(3, 0.4)
UP = np.array([-1.0, 0.0, 0.0])


def block_under_air(air=6):
    solid = np.zeros((30, 13, 12), bool)
    solid[air:] = True
    return solid


# The surface


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.99))
def test_surface_is_what_has_a_face_that_is_not_covered(seed, share):
    solid = np.random.default_rng(seed).random((5, 4, 6)) < share
    covered = np.pad(solid, 1)
    expected = [
        (i, j, k)
        for i, j, k in np.argwhere(solid)
        if not all(
            covered[i + 1 + a, j + 1 + b, k + 1 + c]
            for a, b, c in ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1))
        )
    ]
    assert [tuple(v) for v in surface_voxels(solid)] == expected


def test_boxes_are_the_voxels_and_their_parents():
    solid = block_under_air()
    check = OctreeCheck(solid, SPACING)
    leaves = check.boxes(0)
    np.testing.assert_allclose(leaves[:, :3], surface_voxels(solid) * SPACING, atol=1e-12)  # concentric
    np.testing.assert_allclose(leaves[:, 3], 0.4)
    assert len(check.boxes(check.levels - 1)) == 1 < len(check.boxes(check.levels - 2))
    for level in range(1, check.levels):
        inner, outer = check.boxes(level - 1), check.boxes(level)
        np.testing.assert_allclose(outer[:, 3], 2 * inner[0, 3])
        apart = np.abs(inner[:, None, :3] - outer[None, :, :3]).max(axis=2)
        assert (np.sum(apart < outer[0, 3] / 2, axis=1) == 1).all()  # each box has one parent that holds it
        assert len(np.unique(np.argmin(apart, axis=1))) == len(outer)  # and each parent has a child
    assert len(check.boxes()) == sum(len(check.boxes(n)) for n in range(check.levels))
    with pytest.raises(InputError, match="level"):
        check.boxes(check.levels)


def test_boxes_met_are_all_that_the_shaft_overlaps_and_no_voxel_where_it_is_free():
    rng = np.random.default_rng(8)
    case = cases(rng)[4]
    at = pocket_poses(case, rng, 12)  # in general position: none touches to the last bit
    check = OctreeCheck(case.solid, case.spacing, cylinders=case.cylinders)
    free = check.free(at.positions, at.axes)
    surface = np.zeros_like(case.solid)
    surface[tuple(surface_voxels(case.solid).T)] = 1
    assert 0 < free.sum() < len(at)
    for n in range(len(at)):
        met = check.met(at.positions[n], at.axes[n])
        assert len(met) == check.levels
        left, hit, hits = surface.copy(), np.zeros(3, np.int64), []
        while drill_overlaps_voxels(left, case.spacing, at.positions[n], at.axes[n], case.cylinders, hit):
            hits.append(tuple(hit))
            left[tuple(hit)] = 0
        found = np.round(met[0][:, :3] / case.spacing).astype(int)
        assert sorted(map(tuple, found)) == sorted(hits)
        assert free[n] == (not hits)


# Agreement


@pytest.mark.parametrize("cylinder", [*LONG, *SHORT, *THIN])
def test_contacts_with_one_voxel_are_told_apart_by_their_known_gap(cylinder):
    """Independent of the exact kernel: the contact's construction says what overlaps."""
    rng = np.random.default_rng(int(1000 * sum(cylinder)))
    case = ShaftCase("voxel", single_voxel(), np.full(3, 0.38), np.array([cylinder]))
    at, gaps = contacts(case, rng, 15_000, offsets=10.0 ** rng.uniform(-9, -1.5, 15_000))
    np.testing.assert_array_equal(overlaps(case, at.positions, at.axes), gaps < 0)
    check = OctreeCheck(case.solid, case.spacing, cylinders=case.cylinders)
    free = check.free(at.positions, at.axes)
    assert not free[gaps < 0].any()
    assert free[gaps > check.gap_mm].all()
    assert (gaps > check.gap_mm).sum() > 2500


@pytest.mark.parametrize("along", [0, 1, 2])
def test_exact_answer_sees_a_rim_dip_by_a_tilt_that_squares_round_away(along):
    """Tilted by 1e-8, the rim of a cap 5 mm aside is 5e-8 mm lower; 1 - cos^2 of that tilt is 0."""
    solid = np.zeros((30, 30, 30), np.uint8)
    solid[3, 3, 3] = 1
    case = ShaftCase("voxel", solid, SPACING, np.array([[5.8, 2.0, 6.0]]))
    aside = (along + 1) % 3
    axis = np.zeros(3)
    axis[along], axis[aside] = 1.0, 1e-8
    for gap, expected in ((4e-8, True), (6e-8, False)):
        position = np.full(3, 3 * 0.4)  # the voxel's centre
        position[along] += 0.2 - 2.0 + gap
        found = [
            overlaps(case, (position + side * np.eye(3)[aside])[None], axis[None])[0] for side in (-5, 5)
        ]
        assert found == [expected, False]


def test_agrees_with_the_exact_answer_within_the_rounding_band():
    rng = np.random.default_rng(20210)
    seen, close, outcomes = 0, 0, {}
    for case in cases(rng):
        at = poses(case, rng, 15_000)
        blocked = overlaps(case, at.positions, at.axes)
        check = OctreeCheck(case.solid, case.spacing, cylinders=case.cylinders)
        assert check.gap_mm < 1e-4
        found = disagreements(
            case, at, check.free(at.positions, at.axes), blocked, depth=0.0, gap=check.gap_mm
        )
        assert not len(found.missed), (case.name, at.kinds[found.missed])
        assert not len(found.imagined_clearly), (case.name, at.kinds[found.imagined_clearly])
        near = overlaps(case, at.positions, at.axes, 2e-3) & ~overlaps(case, at.positions, at.axes, -2e-3)
        seen, close = seen + len(at), close + near.sum()
        for kind in np.unique(at.kinds):
            outcomes.setdefault(kind, []).extend(blocked[at.kinds == kind])
    assert seen >= 150_000 and close > 5000
    assert len(outcomes) == 10
    for kind, hits in outcomes.items():
        assert 0.02 < np.mean(hits) < 0.98, kind  # every kind of pose could have gone wrong either way


def test_the_comparison_finds_a_shaft_that_is_a_micrometre_too_thin_or_too_thick():
    rng = np.random.default_rng(3)
    case = cases(rng)[2]
    at = poses(case, rng, 4000)
    blocked = overlaps(case, at.positions, at.axes)
    for change in (-1e-3, 1e-3):
        check = OctreeCheck(
            case.solid, case.spacing, cylinders=case.cylinders + change * np.array([1.0, -1.0, 1.0])
        )
        found = disagreements(
            case, at, check.free(at.positions, at.axes), blocked, depth=2e-4, gap=check.gap_mm
        )
        assert len(found.missed_clearly if change < 0 else found.imagined_clearly) > 20
        assert not len(found.imagined if change < 0 else found.missed_clearly)


def test_a_shaft_whole_in_the_bone_is_in_collision():
    solid = np.ones((31, 31, 31), bool)
    check = OctreeCheck(solid, SPACING, cylinders=THIN)
    axes = np.random.default_rng(0).normal(size=(50, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    middle = 15 * SPACING
    assert not check.free(middle, axes).any()
    solid[8:23, 8:23, 8:23] = False  # a cavity of 6 mm around a shaft of 5 mm
    check.update(solid)
    assert check.is_free(middle - 2.5 * UP, UP) and not check.is_free(middle, UP)


# Use


def test_removed_bone_frees_the_way():
    solid = block_under_air()
    check = OctreeCheck(solid, SPACING)
    burr = np.array([16, 6, 5]) * SPACING
    assert not check.is_free(burr, UP)
    solid[:18, 2:10, 2:9] = False
    assert not check.is_free(burr, UP)  # the check keeps what it was given
    check.update(solid)
    assert check.is_free(burr, UP)
    assert not check.is_free(burr, -UP)
    check.update(np.zeros_like(solid))
    assert check.free(burr, np.array([UP, -UP])).all()
    assert check.boxes().shape == (0, 4)


def test_one_position_for_all_directions_or_one_for_each():
    check = OctreeCheck(block_under_air(), SPACING, Drill(shaft_ends=(4.0, 6.0, 8.0)))
    rng = np.random.default_rng(1)
    axes = rng.normal(size=(200, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    burr = np.array([5, 6, 5]) * SPACING
    together = check.free(burr, axes)
    assert 0 < together.sum() < 200
    np.testing.assert_array_equal(together, check.free(np.tile(burr, (200, 1)), axes))
    np.testing.assert_array_equal(together, [check.is_free(burr, axis) for axis in axes])
    assert check.free(burr, np.empty((0, 3))).shape == (0,)


def test_time_inside_coal_is_counted_when_asked_for():
    axes = np.tile(UP, (300, 1))
    burr = np.array([5, 6, 5]) * SPACING
    counts = []
    for timed in (False, True):
        check = OctreeCheck(block_under_air(), SPACING, timed=timed)
        clock = time.perf_counter()
        check.free(burr, axes)
        counts.append((check.seconds, time.perf_counter() - clock))
    assert counts[0][0] == 0 < counts[1][0] < counts[1][1]


def test_bad_input_is_refused():
    solid = block_under_air()
    with pytest.raises(GeometryError, match="cubic"):
        OctreeCheck(solid, np.array([0.4, 0.4, 0.41]))
    with pytest.raises(GeometryError, match="three positive"):
        OctreeCheck(solid, np.array([0.4, 0.4, np.nan]))
    with pytest.raises(InputError, match="three-dimensional"):
        OctreeCheck(solid[0], SPACING)
    with pytest.raises(InputError, match="cylinders"):
        OctreeCheck(solid, SPACING, cylinders=((1.0, 5.0, 5.0),))
    check = OctreeCheck(solid, SPACING * [1, 1, 1 + 5e-7])
    assert 0 < check.uneven_mm < check.gap_mm < 1e-4
    with pytest.raises(InputError, match="unit vectors"):
        check.is_free(np.zeros(3), np.array([1.0, 1.0, 0.0]))
    with pytest.raises(InputError, match="finite"):
        check.is_free(np.array([0.0, np.nan, 0.0]), UP)
    with pytest.raises(InputError, match="shapes"):
        check.free(np.zeros((3, 3)), np.tile(UP, (2, 1)))
