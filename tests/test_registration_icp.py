"""Iterative closest point in a kernel: against a plain one in numpy, known transforms, and bad input."""

import itertools

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from study.errors import GeometryError, InputError
from study.registration import IcpSettings, SurfaceTree, register_points, register_surface
from study.registration.icp import fits
from study.registration.icp.nearest import _kernels
from study.registration.icp.nearest.tree import LEAF


def best_fit(moving, fixed):
    """Least squares by a singular value decomposition; None where another rotation fits as well."""
    a, b = moving.mean(axis=0), fixed.mean(axis=0)
    u, size, vt = np.linalg.svd((moving - a).T @ (fixed - b))
    sign = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    if size[1] + sign * size[2] < 1e-9 * ((moving - a) ** 2).sum():
        return None
    out = np.eye(4)
    out[:3, :3] = vt.T @ np.diag([1, 1, sign]) @ u.T
    out[:3, 3] = b - out[:3, :3] @ a
    return out


def first_order_fit(pose, moving, fixed):
    """One Gauss-Newton step in the moving points' own axes, as the exponential of a twist."""
    centre = moving.mean(axis=0)
    own = moving - centre
    rest = (fixed - moved(pose, moving)) @ pose[:3, :3]
    design = np.concatenate([np.concatenate([-cross(p), np.eye(3)], axis=1) for p in own])
    turn, shift = np.split(np.linalg.lstsq(design, rest.ravel(), rcond=None)[0], 2)
    twist = np.zeros((4, 4))
    twist[:3, :3], twist[:3, 3] = cross(turn), shift
    to_centre = np.eye(4)
    to_centre[:3, 3] = centre
    return pose @ to_centre @ expm(twist) @ np.linalg.inv(to_centre)


def cross(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def plain_icp(vertices, swab, start, settings=None, kept=None):
    """What it says: match all, fit in closed form, until nothing changes or the step is small."""
    settings = settings or IcpSettings()
    seen = vertices if kept is None else vertices[kept]
    tree = cKDTree(seen)
    pose, small, before = start, False, None
    for iteration in range(settings.max_iterations + 1):
        distances, matches = tree.query(moved(pose, swab))
        rms = np.sqrt((distances**2).mean())
        same = np.array_equal(matches, before)
        if small or (same and settings.step == "closed_form"):
            pose = best_fit(swab, seen[matches]) if same else pose
            return pose, True, iteration, np.sqrt((tree.query(moved(pose, swab))[0] ** 2).mean())
        if settings.step == "closed_form":
            new = best_fit(swab, seen[matches])
        else:
            new = first_order_fit(pose, swab, seen[matches])
        if new is None or iteration == settings.max_iterations:
            return pose, False, iteration, rms
        shift = np.linalg.norm((moved(new, swab) - moved(pose, swab)).mean(axis=0))
        angle = Rotation.from_matrix(new[:3, :3] @ pose[:3, :3].T).magnitude()
        small = shift < settings.translation_tolerance and angle < settings.rotation_tolerance
        pose, before = new, matches
    raise AssertionError


def moved(transform, points):
    return points @ transform[:3, :3].T + transform[:3, 3]


def starts_about(rng, centre, count, position=3.0, degrees=8.0):
    turns = Rotation.from_rotvec(rng.normal(size=(count, 3)) * np.deg2rad(degrees)).as_matrix()
    out = np.tile(np.eye(4), (count, 1, 1))
    out[:, :3, :3] = turns
    out[:, :3, 3] = centre - turns @ centre + rng.normal(size=(count, 3)) * position
    return out


def bumpy(rng, count):
    """Points scattered over half of an ellipsoid with bumps, which no rotation leaves alone; mm."""
    d = rng.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    d[:, 2] = abs(d[:, 2])
    size = 1 + 0.15 * np.sin(5 * d[:, 0]) * np.cos(4 * d[:, 1]) + 0.1 * d[:, 0]
    return d * size[:, None] * [40.0, 28.0, 25.0] + [100.0, -60.0, 900.0]


def a_case(seed, vertices, points, starts, own_swabs=False, share=None, **spread):
    rng = np.random.default_rng(seed)
    surface = bumpy(rng, vertices)
    swab = bumpy(rng, points) + rng.normal(scale=0.3, size=(points, 3))
    if own_swabs:
        swab = swab + rng.normal(scale=0.3, size=(starts, points, 3))
    kept = None if share is None else rng.random((starts, vertices)) < share
    return surface, swab, starts_about(rng, surface.mean(axis=0), starts, **spread), kept


def assert_as_plain(surface, swab, starts, kept=None, settings=None):
    done = register_surface(surface, swab, starts, settings, kept)
    for n, start in enumerate(starts):
        own = swab if swab.ndim == 2 else swab[n]
        mask = None if kept is None else kept[n]
        # The start is applied to the swab in numpy, so that the composition is checked too.
        pose, converged, iterations, rms = plain_icp(surface, own, start, settings, mask)
        assert (done.converged[n], done.iterations[n]) == (converged, iterations)
        np.testing.assert_allclose(moved(done.transforms[n], own), moved(pose, own), rtol=0, atol=1e-9)
        np.testing.assert_allclose(done.transforms[n, :3, :3], pose[:3, :3], rtol=0, atol=1e-9)
        np.testing.assert_allclose(done.rms[n], rms, rtol=0, atol=1e-9)
        assert np.array_equal(done.transforms[n, 3], [0, 0, 0, 1])
    return done


SIZES = [(3, 3), (7, 5), (9, 40), (60, 30), (500, 80), (3000, 200)]


@pytest.mark.parametrize(("vertices", "points"), SIZES)
@pytest.mark.parametrize("own_swabs", [False, True])
def test_as_a_plain_fit(vertices, points, own_swabs):
    for seed in range(3):
        assert_as_plain(*a_case(seed, vertices, points, 8, own_swabs))


@pytest.mark.parametrize("share", [0.1, 0.6])
@pytest.mark.parametrize("own_swabs", [False, True])
def test_only_kept_vertices_are_matched(share, own_swabs):
    surface, swab, starts, kept = a_case(5, 800, 90, 10, own_swabs, share)
    done = assert_as_plain(surface, swab, starts, kept)
    full = register_surface(surface, swab, starts)
    assert not np.allclose(done.transforms, full.transforms, atol=1e-3)


@pytest.mark.parametrize("position", [0.1, 60.0])
def test_near_and_far_starts(position):
    done = assert_as_plain(*a_case(2, 1500, 120, 12, position=position, degrees=position))
    assert done.converged.all()


@pytest.mark.parametrize(
    "settings",
    [
        IcpSettings.published(),
        IcpSettings(max_iterations=1),
        IcpSettings(max_iterations=7),
        IcpSettings(translation_tolerance=0.05, rotation_tolerance=0.002),
        IcpSettings(translation_tolerance=0, rotation_tolerance=0),
        IcpSettings(step="gauss_newton"),
        IcpSettings(translation_tolerance=0.05, rotation_tolerance=0.002, step="gauss_newton"),
    ],
)
def test_stops_when_a_plain_fit_does(settings):
    done = assert_as_plain(*a_case(3, 1500, 120, 20), settings=settings)
    assert done.settings is settings
    stopped = done.iterations == settings.max_iterations
    assert (done.converged | stopped).all()


def test_iterations_that_run_out_are_reported():
    done = register_surface(*a_case(3, 1500, 120, 20)[:3], IcpSettings(max_iterations=3))
    assert not done.converged.any() and (done.iterations == 3).all()


def test_converged_result_is_a_fixed_point():
    """The closest vertices of the result lead back to it; a start at the result stays there."""
    surface, swab, starts, _ = a_case(8, 2500, 150, 30)
    done = register_surface(surface, swab, starts)
    assert done.converged.all() and done.iterations.min() > 3
    tree = cKDTree(surface)
    for n, transform in enumerate(done.transforms):
        distances, matches = tree.query(moved(transform, swab))
        again = register_points(swab, surface[matches])
        np.testing.assert_allclose(again.transform, transform, rtol=0, atol=1e-9)
        np.testing.assert_allclose(np.sqrt((distances**2).mean()), done.rms[n], rtol=0, atol=1e-12)
    again = register_surface(surface, swab, done.transforms)
    assert (again.iterations == 1).all() and again.converged.all()
    np.testing.assert_allclose(again.transforms, done.transforms, rtol=0, atol=1e-9)


@pytest.mark.parametrize("between", [(0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 1, 1), (0.5, 0, 0)])
def test_points_amid_equally_near_vertices_come_to_rest(between):
    """On a lattice with points half way between vertices, where the choice is free."""
    axis = 2.0 * np.arange(6)
    surface = np.stack(np.meshgrid(axis, axis, axis[:3], indexing="ij"), axis=-1).reshape(-1, 3)
    starts = np.tile(np.eye(4), (4, 1, 1))
    starts[:, :3, 3] = [[0, 0, 0], [1, 0, 0], [1, 1, 1], [0.5, 0, 0]]
    swab = surface + between
    done = register_surface(surface, swab, starts)
    assert done.converged.all() and done.iterations.max() < 10
    for transform, rms in zip(done.transforms, done.rms, strict=True):
        nearest = cKDTree(surface).query(moved(transform, swab))[0]
        np.testing.assert_allclose(rms, np.sqrt((nearest**2).mean()), rtol=0, atol=1e-9)


def test_known_transform_is_recovered():
    """A swab of vertices themselves, moved by a known transform: fits from nearby find it exactly."""
    rng = np.random.default_rng(4)
    surface = bumpy(rng, 400)
    truth = starts_about(rng, surface.mean(axis=0), 20, position=50, degrees=60)
    picked = surface[rng.choice(400, 100, replace=False)]
    swabs = np.stack([moved(np.linalg.inv(transform), picked) for transform in truth])
    nudges = starts_about(rng, surface.mean(axis=0), 20, position=0.3, degrees=0.3)
    done = register_surface(surface, swabs, nudges @ truth)
    assert done.converged.all()
    np.testing.assert_allclose(done.transforms, truth, rtol=0, atol=1e-8)
    assert done.rms.max() < 1e-9


def test_two_threads_change_no_byte(monkeypatch):
    surface, swab, starts, kept = a_case(1, 1200, 100, 64, True, 0.7)

    def pieces(sizes):
        def in_pieces(work, count, least):
            ends = np.linspace(0, count, sizes + 1).astype(int)
            for a, b in itertools.pairwise(ends):
                work(slice(int(a), int(b)))

        return in_pieces

    runs = [register_surface(surface, swab, starts, kept=kept)]  # as many threads as there are
    for count in (1, 3):
        monkeypatch.setattr(fits, "in_threads", pieces(count))
        runs.append(register_surface(surface, swab, starts, kept=kept))
    for other in runs[1:]:
        for name in ("transforms", "converged", "iterations", "rms"):
            assert getattr(runs[0], name).tobytes() == getattr(other, name).tobytes()


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_moving_all_moves_the_answer(seed):
    rng = np.random.default_rng(seed)
    surface, swab, starts, _ = a_case(seed, 300, 40, 3)
    move = starts_about(rng, surface.mean(axis=0), 1, position=30, degrees=90)[0]
    aside = starts_about(rng, swab.mean(axis=0), 1, position=30, degrees=90)[0]
    before = register_surface(surface, swab, starts)
    after = register_surface(moved(move, surface), moved(aside, swab), move @ starts @ np.linalg.inv(aside))
    assert np.array_equal(before.iterations, after.iterations)
    expected = move @ before.transforms @ np.linalg.inv(aside)
    np.testing.assert_allclose(after.transforms, expected, rtol=0, atol=1e-7)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_order_of_vertices_and_points_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    surface, swab, starts, kept = a_case(seed, 300, 40, 3, share=0.8)
    a, b = rng.permutation(300), rng.permutation(40)
    before = register_surface(surface, swab, starts, kept=kept)
    after = register_surface(surface[a], swab[b], starts, kept=kept[:, a])
    assert np.array_equal(before.iterations, after.iterations)
    np.testing.assert_allclose(after.transforms, before.transforms, rtol=0, atol=1e-8)


@numba.njit
def searched(points, ends, boxes, mask, masked, queries, guesses, indices, distances):
    stack, bounds = np.empty(_kernels.DEPTH, np.int64), np.empty(_kernels.DEPTH)
    for i in range(len(queries)):
        x, y, z = queries[i]
        first, near, next_ = _kernels.nearest_two(
            points, ends, boxes, mask, masked, stack, bounds, x, y, z, guesses[i]
        )
        indices[i] = first
        distances[i] = near, next_


@numba.njit
def walked(points, around, planes, mask, masked, queries, guesses, three, slacks, bests, free):
    for i in range(len(queries)):
        x, y, z = queries[i]
        first, one, other, slacks[i, 0], free[i] = _kernels.walk(
            points, around, planes, mask, masked, 1e-10, x, y, z, guesses[i]
        )
        three[i] = first, one, other
        best, slacks[i, 1] = _kernels.best_of(points, first, one, other, x, y, z)
        bests[i] = best


KINDS = ["scattered", "surface", "lattice", "doubled", "one plane", "one place"]
COUNTS = [3, 8, 9, 100, 500]


def a_tree(kind, count):
    """Vertices of a kind; half of them (three at least); queries, some of them amid lattice points."""
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3)) * 10
    points = {
        "scattered": points,
        "surface": bumpy(rng, count) - [100, -60, 900],
        "lattice": np.round(points / 4) * 4,
        "doubled": np.concatenate([points, points]),
        "one plane": points * [1, 1, 0],
        "one place": np.ones((count, 3)),
    }[kind]
    tree = SurfaceTree.of(points)
    mask = rng.random(len(points)) < 0.5
    mask[:3] = True
    queries = rng.normal(size=(60, 3)) * 12
    queries[::2] = np.round(queries[::2] / 2) * 2 - tree.origin
    return rng, tree, mask, queries


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", KINDS)
def test_search_in_the_tree_finds_the_two_nearest(kind, count):
    """Whatever bounds it, also among equally near vertices and several at the same place."""
    rng, tree, mask, queries = a_tree(kind, count)
    points = tree.points
    assert np.array_equal(np.sort(tree.order), np.arange(len(points)))
    np.testing.assert_array_equal(points, tree.vertices[tree.order] - tree.origin)
    assert np.diff(tree.ends).max() <= LEAF
    for masked in (False, True):
        seen = np.flatnonzero(mask) if masked else np.arange(len(points))
        for known in (False, True):
            guesses = rng.choice(seen, 60) if known else np.full(60, -1)
            indices, found = np.empty(60, int), np.empty((60, 2))
            searched(points, tree.ends, tree.boxes, mask, masked, queries, guesses, indices, found)
            for query, index, distances in zip(queries, indices, found, strict=True):
                all_ = ((points[seen] - query) ** 2).sum(axis=1)
                best = seen[all_.argmin()]
                elsewhere = (points[seen] != points[best]).any(axis=1)
                second = all_[elsewhere].min() if elsewhere.any() else np.inf
                assert index == best
                np.testing.assert_allclose(distances, (all_.min(), second), rtol=1e-13)


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("kind", KINDS)
def test_walk_knows_how_far_a_point_has_to_another_vertex(kind, count):
    """Against the distances to all planes half way between the match and the other vertices."""
    rng, tree, mask, queries = a_tree(kind, count)
    points, around, planes = tree.points, tree.around, tree.planes
    if kind == "surface":
        queries = points[rng.integers(len(points), size=60)] + rng.normal(size=(60, 3))
    sure = 0
    for masked in (False, True):
        seen = np.flatnonzero(mask) if masked else np.arange(len(points))
        three, slacks = np.empty((60, 3), int), np.empty((60, 2))
        bests, free = np.empty(60, int), np.empty(60)
        guesses = rng.choice(seen, 60)
        walked(points, around, planes, mask, masked, queries, guesses, three, slacks, bests, free)
        assert np.isin(three, seen).all()
        for k in np.flatnonzero(free >= 0):  # negative: says that it does not know
            sure += 1
            match, best = three[k, 0], bests[k]
            others = ~np.isin(seen, three[k])
            from_match, from_best = (to_planes(points, seen, at, queries[k]) for at in (match, best))
            assert from_best.min() > -1e-9, "another vertex is nearer"
            assert free[k] <= from_match[others].min(initial=np.inf) + 1e-9
            np.testing.assert_allclose(slacks[k, 0], from_match[~others].min(), atol=1e-9)
            np.testing.assert_allclose(slacks[k, 1], from_best[~others].min(), atol=1e-9)
    assert sure > 20 or kind != "surface"


def to_planes(points, seen, match, query):
    """Distances to the planes half way between a match and others; infinite for those at its place."""
    away = points[seen] - points[match]
    gaps = np.linalg.norm(away, axis=1)
    along = (away * ((points[seen] + points[match]) / 2 - query)).sum(axis=1)
    return np.divide(along, gaps, out=np.full(len(seen), np.inf), where=gaps > 0)


def test_vertices_listed_twice_change_nothing():
    surface, swab, starts, kept = a_case(6, 500, 60, 6, share=0.5)
    once = register_surface(surface, swab, starts, kept=kept)
    twice = register_surface(np.repeat(surface, 3, axis=0), swab, starts, kept=np.repeat(kept, 3, axis=1))
    assert np.array_equal(once.iterations, twice.iterations)
    np.testing.assert_allclose(twice.transforms, once.transforms, rtol=0, atol=1e-9)


def test_a_tree_made_before_gives_the_same():
    surface, swab, starts, _ = a_case(6, 500, 60, 6)
    tree = SurfaceTree.of(surface)
    with_tree, without = (register_surface(given, swab, starts) for given in (tree, surface))
    assert with_tree.transforms.tobytes() == without.transforms.tobytes()
    assert len(with_tree) == 6


def test_arguments_are_left_as_they_were():
    given = a_case(6, 500, 60, 6, own_swabs=True, share=0.5)
    copies = [x.copy() for x in given]
    register_surface(*given[:3], kept=given[3])
    for x, copy in zip(given, copies, strict=True):
        np.testing.assert_array_equal(x, copy)


def test_a_start_from_which_all_points_match_one_line_has_not_converged():
    surface, swab, starts, _ = a_case(6, 500, 60, 3)
    starts[1, :3, 3] += [1e6, 2e5, 3e5]  # a kilometre away one vertex is nearest to all
    done = register_surface(surface, swab, starts)
    assert done.converged.tolist() == [True, False, True]
    assert done.iterations[1] == 0
    np.testing.assert_allclose(done.transforms[1], starts[1], rtol=1e-12)


# Bad input


def replaced(array, index, value):
    out = np.array(array, dtype=float)
    out[index] = value
    return out


SURFACE, SWAB, STARTS, KEPT = a_case(0, 50, 20, 4, share=0.9)
LINE = np.linspace(0, 1, 20)[:, None] * [10.0, 20.0, 30.0]


@pytest.mark.parametrize(
    ("change", "error", "says"),
    [
        ({"vertices": np.empty((0, 3))}, InputError, "vertices: expected at least 3 points, got 0"),
        ({"vertices": SURFACE[:, :2]}, InputError, r"vertices: .*\(50, 2\)"),
        ({"vertices": replaced(SURFACE, (4, 1), np.nan)}, InputError, "vertices: expected finite .*nan"),
        ({"swab": SWAB[:2]}, InputError, "swab: expected at least 3 points, got 2"),
        (
            {"swab": LINE},
            InputError,
            "swab: expected points that do not lie on one line; their .* 50.8 mm",
        ),
        ({"swab": replaced(SWAB, (3, 0), np.inf)}, InputError, r"point 3 of swab 0 is \[inf"),
        ({"swab": np.stack([SWAB] * 3)}, InputError, "each of 4 starts, got 3"),
        ({"swab": np.stack([SWAB, SWAB, LINE, SWAB])}, InputError, r"on one line.*\(swab 2\)"),
        ({"swab": SWAB[0]}, InputError, r"swab: expected shape .*\(3,\)"),
        ({"swab": SWAB / 1000}, GeometryError, "swab: its extent is 0.0.* surface .* mm .*0.02 to 3"),
        ({"swab": SWAB * 1000}, GeometryError, "swab: its extent is .* surface .* mm .*0.02 to 3"),
        ({"vertices": np.ones((10, 3))}, GeometryError, "that of the surface 0, inf times"),
        ({"starts": np.eye(4)}, InputError, r"starts: .*\(n, 4, 4\), got \(4, 4\)"),
        ({"starts": STARTS[:0]}, InputError, "starts: expected at least one"),
        ({"starts": replaced(STARTS, (2, 0, 3), np.nan)}, InputError, "number 2 is .*nan"),
        ({"starts": STARTS * [[[1.0], [1], [-1], [1]]]}, InputError, "starts: expected rigid .*number 0"),
        ({"starts": replaced(STARTS, (1, 0, 0), 1.1)}, InputError, "number 1 is .*1.1"),
        ({"starts": replaced(STARTS, (3, 3, 0), 1)}, InputError, "number 3 is"),
        ({"kept": KEPT[:, :-1]}, InputError, r"kept: .*\(4, 50\) .*\(4, 49\)"),
        ({"kept": KEPT.astype(float)}, InputError, "kept: expected a bool array .* float64"),
        ({"kept": KEPT & (np.arange(4) != 2)[:, None]}, InputError, "start 2 has 0"),
        ({"settings": 20}, InputError, "settings: expected IcpSettings, got int"),
    ],
)
def test_bad_input_is_named(change, error, says):
    given = {"vertices": SURFACE, "swab": SWAB, "starts": STARTS, "kept": KEPT, **change}
    with pytest.raises(error, match=says):
        register_surface(**given)


@pytest.mark.parametrize(
    "wrong",
    [
        {"max_iterations": 0},
        {"max_iterations": 2.5},
        {"max_iterations": True},
        {"translation_tolerance": -1e-3},
        {"translation_tolerance": "0.1"},
        {"rotation_tolerance": np.nan},
        {"rotation_tolerance": np.inf},
        {"step": "newton"},
    ],
)
def test_settings_out_of_range_are_named(wrong):
    ((name, value),) = wrong.items()
    with pytest.raises(InputError, match=f"{name}: expected .*got {value!r}"):
        IcpSettings(**wrong)
