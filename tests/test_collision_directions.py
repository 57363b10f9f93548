"""The fast 5-DOF check against `coal`'s octree, the plain exact kernel and brute force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shaft_poses import Poses, ShaftCase, cases, disagreements, milled_bone, overlaps, poses, scattered, units

from study.collision import Drill
from study.collision.directions import DirectionCheck, build_free_space
from study.collision.directions.field import _kernels as field
from study.collision.directions.search import _kernels as search
from study.collision.directions.single import _kernels as single
from study.collision.exact._kernels import cylinder_overlaps_box, drill_overlaps_voxels
from study.collision.octree import OctreeCheck
from study.errors import InputError

#: mm on either side of touching within which rounding may decide.
BAND = 1e-9
#: Drills with the cylinders of `shaft_poses`.
DRILLS = {
    "long": Drill(),
    "short": Drill(shaft_ends=(5.0, 7.5, 11.0)),
    "thin": Drill(2 * np.sqrt(0.34), (0.6, 1.4, 2.2), (2.0, 3.5, 5.0)),
}
SEEDS = st.integers(0, 2**32 - 1)


def bare_check(case: ShaftCase) -> DirectionCheck:
    """The fast check of a case, counting the voxels in the burr's ball too, as the references do."""
    return DirectionCheck(case.solid, case.spacing, DRILLS[case.name.split(", ")[1]], burr=False)


def answers(check: DirectionCheck, at: Poses) -> np.ndarray:
    return np.array([check.is_free(p, a) for p, a in zip(at.positions, at.axes, strict=True)])


def without_burr(solid: np.ndarray, spacing: np.ndarray, drill: Drill, position: np.ndarray) -> np.ndarray:
    """The bone that is left when the burr has arrived: every voxel its ball overlaps is gone."""
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in solid.shape], indexing="ij"), axis=-1) * spacing
    apart = np.maximum(np.abs(grid - position) - spacing / 2, 0)
    return np.where((apart**2).sum(axis=-1) < drill.burr_radius**2 * (1 - 1e-12), 0, solid).astype(np.uint8)


def brute_free(solid, spacing, drill, position, axes) -> np.ndarray:
    """(n,) bool of the plain exact kernel, the voxels under the burr taken out."""
    left, hit = without_burr(solid, spacing, drill, position), np.zeros(3, np.int64)
    cylinders, axes = np.array(drill.cylinders), np.array(axes)  # for read-only ones it is compiled anew
    return np.array(
        [not drill_overlaps_voxels(left, spacing, position, axis, cylinders, hit) for axis in axes], bool
    )


def grid_axes(tilts, tips) -> np.ndarray:
    """(n, n, 3) unit vectors of a window."""
    tilt, tip = np.meshgrid(tilts, tips, indexing="ij")
    return np.stack([np.sin(tip), -np.cos(tip) * np.cos(tilt), np.cos(tip) * np.sin(tilt)], axis=-1)


def pocket(rng, shape=(34, 30, 36), air=6, n_balls=8, radius=5.0) -> np.ndarray:
    """Milled bone whose outside lies against axis 1, as in canonical order."""
    bone = milled_bone(rng, (shape[1], shape[0], shape[2]), air=air, n_balls=n_balls, radius=radius)
    return np.ascontiguousarray(np.moveaxis(bone, 0, 1))


def near_bone(rng, solid, n) -> np.ndarray:
    """(n, 3) voxels of air, most of them next to bone, as floats: so the planner asks, and with other
    types the kernels are compiled once more."""
    air = np.argwhere(solid == 0)
    deep = air[np.argsort(-air[:, 1] + rng.uniform(0, 12, len(air)))]
    return deep[rng.integers(len(deep) // 2, size=n)].astype(float)


# One direction


def test_agrees_with_the_octree_and_the_exact_answer():
    rng = np.random.default_rng(50505)
    seen, kinds, close, differing = 0, {}, 0, 0
    for case in cases(rng):
        at = poses(case, rng, 10_000)
        blocked = overlaps(case, at.positions, at.axes)
        free = answers(bare_check(case), at)
        found = disagreements(case, at, free, blocked, depth=BAND, gap=BAND)
        assert not len(found.missed_clearly), (case.name, at.kinds[found.missed_clearly])
        assert not len(found.imagined_clearly), (case.name, at.kinds[found.imagined_clearly])
        differing += len(found.missed) + len(found.imagined)
        octree = OctreeCheck(case.solid, case.spacing, cylinders=case.cylinders)
        theirs = octree.free(at.positions, at.axes)
        missed, cautious = np.flatnonzero(theirs & ~free), np.flatnonzero(free & ~theirs)
        assert not overlaps(case, at.positions[missed], at.axes[missed], -BAND).any()
        assert overlaps(case, at.positions[cautious], at.axes[cautious], octree.gap_mm).all()
        near = overlaps(case, at.positions, at.axes, 1e-3) & ~overlaps(case, at.positions, at.axes, -1e-3)
        seen, close = seen + len(at), close + near.sum()
        for kind in np.unique(at.kinds):
            kinds.setdefault(kind, []).extend(free[at.kinds == kind])
    assert seen >= 100_000 and close > 5000
    assert differing < 1e-3 * seen  # the band is for rounding, not for whole kinds of poses
    for kind, hits in kinds.items():
        assert 0.02 < np.mean(hits) < 0.98, kind


def test_the_comparison_would_find_a_micrometre():
    rng = np.random.default_rng(3)
    case = cases(rng)[2]
    at = poses(case, rng, 4000)
    blocked = overlaps(case, at.positions, at.axes)
    for change in (-1e-3, 1e-3):
        check = bare_check(case)
        wrong = check.space.cylinders + change * np.array([1.0, -1.0, 1.0])
        check.space = check.space._replace(cylinders=wrong)
        found = disagreements(case, at, answers(check, at), blocked, depth=BAND, gap=BAND)
        assert len(found.missed_clearly if change < 0 else found.imagined_clearly) > 20


@pytest.mark.parametrize("spacing", [(0.2, 0.38, 1.0), (1.0, 0.25, 0.3), (0.45, 0.9, 0.2)])
def test_agrees_on_voxels_that_are_no_cubes(spacing):
    rng = np.random.default_rng(int(1000 * spacing[0]))
    bones = {
        "long": milled_bone(rng),
        "thin": scattered(rng, share=0.01),
        "short": milled_bone(rng, radius=4.0),
    }
    for name, solid in bones.items():
        case = ShaftCase(f"bone, {name}", solid, np.array(spacing), np.array(DRILLS[name].cylinders))
        at = poses(case, rng, 3000)
        free = answers(bare_check(case), at)
        blocked = overlaps(case, at.positions, at.axes)
        found = disagreements(case, at, free, blocked, depth=BAND, gap=BAND)
        assert not len(found.missed_clearly) and not len(found.imagined_clearly), case.name
        assert 0.02 < free.mean() < 0.98


def test_from_far_outside_and_out_of_the_volume():
    """Shafts that come into the volume from outside, leave it, pass it or never meet it."""
    rng = np.random.default_rng(9)
    solid = np.ones((9, 11, 13), np.uint8)
    solid[3:6, :6, 4:9] = 0
    case = ShaftCase("block, long", solid, np.array([0.4, 0.5, 0.3]), np.array(Drill().cylinders))
    n = 4000
    positions = case.extent / 2 + units(rng, n) * rng.uniform(0, 130, (n, 1))
    aims = rng.uniform(-1, 2, (n, 3)) * case.extent - positions
    axes = aims / np.linalg.norm(aims, axis=1, keepdims=True)
    axes[::4] = units(rng, len(axes[::4]))
    at = Poses(positions, axes, np.full(n, "outside"))
    free = answers(bare_check(case), at)
    np.testing.assert_array_equal(free, ~overlaps(case, positions, axes))
    assert 0.1 < free.mean() < 0.9


@pytest.mark.parametrize("spacing", [(0.4, 0.4, 0.4), (0.9, 0.3, 0.5)])
def test_voxels_that_the_burr_overlaps_do_not_block(spacing):
    rng = np.random.default_rng(12)
    spacing, solid = np.array(spacing), pocket(rng)
    drill = Drill()
    check, strict = DirectionCheck(solid, spacing, drill), DirectionCheck(solid, spacing, drill, burr=False)
    freed = 0
    for voxel in near_bone(rng, solid, 60):
        position = (voxel + rng.choice([0.0, 0.37], 3)) * spacing
        axes = units(rng, 100)
        axes[:, 1] = -np.abs(axes[:, 1])
        free = check.free(position, axes)
        np.testing.assert_array_equal(free, brute_free(solid, spacing, drill, position, axes))
        freed += np.count_nonzero(free & ~strict.free(position, axes))
    assert freed > 20


@settings(max_examples=15)
@given(SEEDS)
def test_a_cone_called_free_is_free_in_every_direction(seed):
    rng = np.random.default_rng(seed)
    spacing = rng.uniform(0.25, 0.7, 3)
    solid = pocket(rng)
    space = DirectionCheck(solid, spacing).space
    hit = np.zeros(3, np.int64)
    for voxel in near_bone(rng, solid, 40):
        middle = grid_axes(rng.uniform(-0.7, 0.7, 1), rng.uniform(-0.7, 0.7, 1))[0, 0]
        spread = 10 ** rng.uniform(-3, -0.7)
        at = tuple(voxel + rng.choice([0.0, 0.5], 3))
        if not single.shaft_is_free(space, *at, *middle, spread, 0, hit):
            continue
        aside = np.cross(units(rng, 60), middle)
        aside /= np.linalg.norm(aside, axis=1, keepdims=True)
        angles = spread * np.where(rng.random((60, 1)) < 0.5, 1.0, rng.random((60, 1)))
        axes = np.cos(angles) * middle + np.sin(angles) * aside
        free = np.empty(60, np.bool_)
        search.directions_free(space, *at, axes, free)
        assert free.all()


def test_the_exact_kernel_keeps_corners_that_lie_in_a_cap():
    """A cap through a cube's edge cuts off all beyond it and nothing before."""
    rng = np.random.default_rng(2)
    found, origin = [], np.zeros(3)
    for _ in range(4000):
        axis = units(rng, 1)[0]
        axis[rng.integers(3)] = 0.0
        axis /= np.linalg.norm(axis)
        low = rng.uniform(-1, 0.2, 3)
        high = low + rng.uniform(0.2, 0.9, 3)
        corner = np.where(rng.random(3) < 0.5, low, high)
        cap = corner[0] * axis[0] + corner[1] * axis[1] + corner[2] * axis[2]
        found.append(
            [cylinder_overlaps_box(origin, axis, 0.4, cap - 2, cap + d, low, high) for d in (-BAND, 0, BAND)]
        )
        found.append(
            [cylinder_overlaps_box(origin, axis, 0.4, cap - d, cap + 2, low, high) for d in (-BAND, 0, BAND)]
        )
    shorter, exact, longer = np.array(found).T
    assert (shorter <= exact).all() and (exact <= longer).all()
    assert 0.1 < exact.mean() < 0.9 and (shorter < longer).sum() > 100


# Many directions


def test_a_window_is_its_single_looks():
    rng = np.random.default_rng(77)
    outcomes = {"all": 0, "none": 0, "some": 0}
    for spacing in ((0.38, 0.38, 0.38), (0.8, 0.3, 0.45)):
        solid = pocket(rng)
        check = DirectionCheck(solid, np.array(spacing))
        for voxel in near_bone(rng, solid, 180):
            n = int(rng.choice([1, 2, 3, 5, 7, 8, 12, 18]))
            half = np.deg2rad(rng.choice([2.5, 10.0, 25.0, 40.0]))
            tilts, tips = (rng.uniform(-0.7, 0.7) + np.linspace(-half, half, n) for _ in range(2))
            position = (voxel + rng.choice([0.0, 0.3], 3)) * spacing
            window = check.window(position, tilts, tips)
            np.testing.assert_array_equal(
                window.ravel(), check.free(position, grid_axes(tilts, tips).reshape(-1, 3))
            )
            if n > 1:
                outcomes["all" if window.all() else "some" if window.any() else "none"] += 1
    assert min(outcomes.values()) > 35, outcomes


def nearest_by_brute_force(space, solid, spacing, drill, voxel, u):
    """Cosine to the nearest free direction of the cone, None if there is none, and which are free."""
    free = brute_free(solid, spacing, drill, voxel * spacing, space.directions)
    return (space.directions[free] @ u).max() if free.any() else None, free


@settings(max_examples=9)
@given(SEEDS, st.sampled_from([20.0, 45.0, 75.0]))
def test_the_nearest_free_direction_is_that_of_brute_force_while_bone_goes(seed, max_tilt):
    """Searches follow each other, so each starts with the witnesses of the one before."""
    rng = np.random.default_rng(seed)
    spacing = rng.uniform(0.25, 0.9, 3)
    solid, drill = pocket(rng, n_balls=5, radius=4.0), Drill(rng.uniform(2.5, 6.0), (2.0, 5.0, 9.0))
    space = build_free_space(solid, spacing, drill, np.deg2rad(max_tilt), np.deg2rad(max_tilt / 6), sweep=0.0)
    hit = np.zeros(3, np.int64)
    voxels = near_bone(rng, solid, 8)
    for voxel in np.concatenate([voxels, voxels[::-1]]):
        u = grid_axes(rng.uniform(-0.3, 0.3, 1), rng.uniform(-0.3, 0.3, 1))[0, 0]
        best, free = nearest_by_brute_force(space, solid, spacing, drill, voxel, u)
        found = search.nearest_free(space, *voxel, *u, hit)
        if best is None:
            assert found == -1
        else:
            assert found >= 0 and free[found]
            assert space.directions[found] @ u > best - 5e-7  # cosines are compared in float32
        rest = [found] if found >= 0 else []
        while len(rest) < 4 and rest and (m := search.next_free(space, *voxel, hit)) >= 0:
            assert free[m] and m not in rest
            rest.append(m)
        left = np.argwhere(solid)
        for i, j, k in left[rng.integers(len(left), size=200)]:
            if solid[i, j, k]:
                solid[i, j, k] = 0
                field.remove_voxel(space, i, j, k)


def test_bone_on_the_axis_that_the_burr_overlaps_strikes_no_direction_off():
    """Wide voxels reach far under the burr: one that the axis meets well outside may still be removed."""
    spacing, drill, up = np.array([0.3, 1.0, 0.3]), Drill(), np.array([0.0, -1.0, 0.0])
    outcomes = []
    for j in range(9, 15):
        solid = np.zeros((21, 21, 21), np.uint8)
        solid[10, j, 10] = 1
        space = build_free_space(solid, spacing, drill, np.deg2rad(1), sweep=0.0)
        for depth in np.arange(15.0, 16.0, 0.05):
            at = np.array([10.0, depth, 10.0])
            found = search.nearest_free(space, *at, *up, np.zeros(3, np.int64))
            outcomes.append(found == 0)
            assert outcomes[-1] == brute_free(solid, spacing, drill, at * spacing, up[None])[0]
    assert 0.2 < np.mean(outcomes) < 0.8


@pytest.mark.parametrize("along", [0, 1, 2])
def test_a_shaft_in_a_grid_plane_sees_the_whole_side_of_a_voxel(along):
    """Across a direction in a grid plane two edges of a cube lie in line and make one side together."""
    rng = np.random.default_rng(along)
    solid = np.zeros((40, 40, 40), np.uint8)
    solid[20, 20, 20] = 1
    case = ShaftCase("voxel, thin", solid, np.array([0.4, 0.9, 0.25]), np.array(DRILLS["thin"].cylinders))
    n = 4000
    axes = units(rng, n)
    axes[:, along] = rng.choice([0.0, 1e-17, 1e-15, 1e-13, 1e-11], n)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    aside = units(rng, n) * rng.uniform(0, 1.8, (n, 1))
    at = Poses(20 * case.spacing + aside - rng.uniform(0.6, 4.9, (n, 1)) * axes, axes, np.full(n, "plane"))
    free = answers(bare_check(case), at)
    np.testing.assert_array_equal(free, ~overlaps(case, at.positions, at.axes))
    assert 0.2 < free.mean() < 0.8


# While bone is removed


@settings(max_examples=12)
@given(SEEDS)
def test_answers_stay_those_of_a_fresh_check_while_bone_is_removed(seed):
    rng = np.random.default_rng(seed)
    spacing, solid = rng.uniform(0.25, 0.7, 3), pocket(rng)
    stale, fresh_now = DirectionCheck(solid, spacing), DirectionCheck(solid, spacing)
    left = rng.permutation(np.argwhere(solid))
    deep = left[np.argsort(np.abs(left - [17, 10, 18]).sum(axis=1) + rng.uniform(0, 6, len(left)))]
    changed = 0
    for part in np.array_split(deep[:6000], 4):
        before = stale.space.distance.copy()
        for check in (stale, fresh_now):
            check.remove(part)
        fresh_now.refresh()
        solid[tuple(part.T)] = 0
        fresh = DirectionCheck(solid, spacing)
        np.testing.assert_array_equal(stale.space.distance, before)  # out of date, and may stay so
        np.testing.assert_array_equal(stale.space.bits, fresh.space.bits)
        assert (fresh_now.space.distance <= fresh.space.distance).all()
        changed += np.count_nonzero(fresh_now.space.distance > before)
        for voxel in near_bone(rng, solid, 12):
            position = voxel * spacing
            tilts, tips = (rng.uniform(-0.6, 0.6) + np.linspace(-0.3, 0.3, 6) for _ in range(2))
            expected = fresh.window(position, tilts, tips)
            axes = grid_axes(tilts, tips).reshape(-1, 3)
            for check in (stale, fresh_now):
                np.testing.assert_array_equal(check.window(position, tilts, tips), expected)
                np.testing.assert_array_equal(check.free(position, axes), expected.ravel())
    assert changed > 1000


@settings(max_examples=25)
@given(SEEDS, st.floats(0.5, 6.0))
def test_the_distance_field_is_that_of_brute_force_rounded_down(seed, cap):
    rng = np.random.default_rng(seed)
    shape, spacing = rng.integers(3, 12, 3), rng.uniform(0.15, 1.2, 3)
    solid = (rng.random(shape) < rng.choice([0.002, 0.02, 0.3])).astype(np.uint8)
    true = brute_distance(solid, spacing)
    distance = np.zeros(tuple(shape), np.uint8)
    low, high = np.zeros(3, np.int64), shape.astype(np.int64)
    field.raise_distance(solid, spacing, distance, low, high, cap)
    read = distance * field.UNIT
    assert (read <= true).all()
    assert (read > np.minimum(true, cap) - field.UNIT - 1e-5).all()
    # A box is brought up to date alone, and nothing is ever lowered.
    solid[rng.random(shape) < 0.5] = 0
    low = rng.integers(0, shape)
    high = np.array([rng.integers(a + 1, n + 1) for a, n in zip(low, shape, strict=True)])
    box = tuple(slice(a, z) for a, z in zip(low, high, strict=True))
    old = distance.copy()
    field.raise_distance(solid, spacing, distance, low, high, cap)
    true, read = brute_distance(solid, spacing), distance * field.UNIT
    assert (read <= true).all() and (distance >= old).all()
    assert (read[box] > np.minimum(true, cap)[box] - field.UNIT - 1e-5).all()
    outside = np.ones(tuple(shape), bool)
    outside[box] = False
    np.testing.assert_array_equal(distance[outside], old[outside])


def brute_distance(solid, spacing) -> np.ndarray:
    """mm from each voxel's centre to the nearest solid cube; infinite without one."""
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in solid.shape], indexing="ij"), axis=-1)
    out = np.full(solid.shape, np.inf)
    for voxel in np.argwhere(solid):
        apart = np.maximum(np.abs(grid - voxel) - 0.5, 0) * spacing
        out = np.minimum(out, np.sqrt((apart**2).sum(axis=-1)))
    return out


# Turning


@settings(max_examples=12)
@given(SEEDS)
def test_a_turn_called_free_is_free_all_along_the_arc(seed):
    """Sampled twenty times finer than the kernel looks, with the drill as it is."""
    rng = np.random.default_rng(seed)
    spacing, solid = rng.uniform(0.25, 0.7, 3), pocket(rng)
    space = build_free_space(solid, spacing, Drill(), np.pi / 4)
    bare = DirectionCheck(solid, spacing)
    blind = space._replace(distance=np.zeros_like(space.distance))
    hit, turns = np.zeros(3, np.int64), 0
    for voxel in near_bone(rng, solid, 60):
        u, v = grid_axes(rng.uniform(-0.7, 0.7, 2), rng.uniform(-0.7, 0.7, 2))[[0, 1], [0, 1]]
        if not single.shaft_is_free(space, *voxel, *u, 0.0, 0, hit):
            continue
        free = single.turn_is_free(space, *voxel, *u, *v, hit)
        assert free == single.turn_is_free(blind, *voxel, *u, *v, hit)  # however stale the field
        whole = np.arccos(u @ v)
        f = np.linspace(0, whole, 20 * int(np.ceil(whole / space.turn_step)) + 1)[:, None]
        arc = (np.sin(whole - f) * u + np.sin(f) * v) / np.sin(whole)
        if free:
            turns += 1
            assert bare.free(voxel * spacing, arc / np.linalg.norm(arc, axis=1, keepdims=True)).all()
        else:  # and is refused only where the widened shaft is barred somewhere
            wide = np.empty(len(arc), np.bool_)
            search.directions_free(space, *voxel, arc, wide)
            assert not wide.all()
    assert turns > 0


def test_a_turn_over_a_single_thin_obstacle_is_refused():
    """A voxel between two free directions, seen by neither."""
    solid = np.zeros((41, 41, 41), np.uint8)
    solid[20, 5, 20] = 1
    spacing, at = np.full(3, 0.4), (20.0, 30.0, 20.0)
    space = build_free_space(solid, spacing, Drill(), np.pi / 4)
    hit = np.zeros(3, np.int64)
    for degrees, expected in ((60.0, False), (30.0, False)):
        u, v = grid_axes(np.deg2rad([-degrees, degrees]), np.zeros(2))[:, 0]
        assert single.shaft_is_free(space, *at, *u, 0.0, 0, hit)
        assert single.shaft_is_free(space, *at, *v, 0.0, 0, hit)
        assert single.turn_is_free(space, *at, *u, *v, hit) == expected
    u, v = grid_axes(np.deg2rad([30.0, 40.0]), np.zeros(2))[:, 0]
    assert single.turn_is_free(space, *at, *u, *v, hit)


# Use


def test_bad_input_is_refused():
    solid = np.ones((5, 6, 7), np.uint8)
    spacing = np.full(3, 0.4)
    for bad in (solid[0], np.zeros((0, 3, 3))):
        with pytest.raises(InputError, match="solid"):
            DirectionCheck(bad, spacing)
    for bad in (0.4, [0.4, 0.4], [0.4, 0.4, 0.0], [0.4, np.nan, 0.4]):
        with pytest.raises(InputError, match="spacing"):
            DirectionCheck(solid, bad)
    check = DirectionCheck(solid, spacing)
    up = np.array([0.0, -1.0, 0.0])
    for bad in (np.zeros(2), [0.0, np.inf, 0.0], np.zeros((1, 3))):
        with pytest.raises(InputError, match="position"):
            check.is_free(bad, up)
        with pytest.raises(InputError, match="position"):
            check.window(bad, np.zeros(1), np.zeros(1))
    for bad in (np.zeros(3), np.array([0.0, -2.0, 0.0]), np.array([np.nan, 0, 0]), np.zeros(2)):
        with pytest.raises(InputError, match="axes"):
            check.is_free(np.zeros(3), bad)
    for tilts, tips in (
        (np.zeros(2), np.arange(3.0)),
        (np.zeros((2, 2)), np.zeros((2, 2))),
        (np.zeros(0), np.zeros(0)),
        (np.array([0.0, np.nan]), np.arange(2.0)),
        (np.array([0.0, 0.2, 0.1]), np.arange(3.0)),  # tiles are looked at between their ends
    ):
        with pytest.raises(InputError, match="window"):
            check.window(np.zeros(3), tilts, tips)
    for bad in ([[0, 0, 7]], [[-1, 0, 0]], [[0, 0]], [0.5, 0, 0], [[0.0, np.nan, 0.0]]):
        with pytest.raises(InputError, match="voxels"):
            check.remove(np.array(bad))
    assert not check.is_free(np.array([1.0, 10.0, 1.0]), up)
    check.remove(np.argwhere(solid))
    check.refresh()
    assert check.is_free(np.array([1.0, 10.0, 1.0]), up)
    for tilt, step in ((0.0, 0.1), (np.pi / 2, 0.1), (0.5, 0.0)):
        with pytest.raises(InputError, match="cone"):
            build_free_space(solid, spacing, Drill(), tilt, step)
