"""Triangles near a point: both trees against every triangle in numpy, features, inside and outside."""

import numpy as np
import pytest
import trimesh
from fixture_cases import HARD, closest_points, fan, flipped, rough
from hypothesis import given, settings
from hypothesis import strategies as st

from study.errors import InputError
from study.fixtures.index import TriangleIndex
from study.fixtures.mesh import checked_mesh

KINDS = ("aabb", "pd")


def soup(seed, count, thin=0.0, scale=5.0):
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) * scale + rng.normal(size=(count, 3, 3))
    if thin:  # slivers of both kinds: needles and flat obtuse ones
        for k in range(0, count, 2):
            along = corners[k, 1] - corners[k, 0]
            corners[k, 2] = corners[k, 0] + rng.uniform(0, 1) * along + thin * rng.normal(size=3)
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def compare_with_all(mesh, kind, leaf, points, radius):
    index = TriangleIndex.of(mesh, kind, leaf)
    corners = mesh.vertices[mesh.faces]
    for point in points:
        reference = closest_points(corners, point)
        distances = np.linalg.norm(reference - point, axis=1)
        found = index.within(point, radius)
        assert len(set(found.faces)) == len(found.faces)
        np.testing.assert_allclose(found.distances, distances[found.faces], atol=1e-9)
        assert np.linalg.norm(found.points - point, axis=1) == pytest.approx(found.distances, abs=1e-12)
        assert set(np.flatnonzero(distances < radius - 1e-9)) <= set(found.faces)
        assert (distances[found.faces] <= radius + 1e-9).all()
        nearest = index.nearest(point[None])
        assert nearest.distances[0] == pytest.approx(distances.min(), abs=1e-9)
        assert distances[nearest.faces[0]] == pytest.approx(distances.min(), abs=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@given(
    seed=st.integers(0, 2**31),
    count=st.integers(1, 90),
    leaf=st.sampled_from([1, 3, 8]),
    thin=st.sampled_from([0.0, 1e-2, 1e-5, 1e-8]),
    radius=st.floats(0.0, 8.0),
)
@settings(deadline=None, max_examples=40)
def test_as_every_triangle(kind, seed, count, leaf, thin, radius):
    mesh = checked_mesh(soup(seed, count, thin), plausible_mm=(0, np.inf))
    points = np.random.default_rng(seed + 1).normal(size=(6, 3)) * 5
    compare_with_all(mesh, kind, leaf, points, radius)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", HARD)
def test_as_every_triangle_of_hard_meshes(kind, name):
    mesh = checked_mesh(HARD[name])
    rng = np.random.default_rng(0)
    points = mesh.vertices[rng.integers(len(mesh.vertices), size=8)] + rng.normal(size=(8, 3)) * 0.3
    compare_with_all(mesh, kind, 8, points, 1.3)


def test_both_trees_find_the_same():
    mesh = checked_mesh(rough())
    one, other = (TriangleIndex.of(mesh, kind) for kind in KINDS)
    rng = np.random.default_rng(4)
    for point in rng.normal(size=(50, 3)) * 4:
        a, b = one.within(point, 1.5), other.within(point, 1.5)
        order_a, order_b = np.argsort(a.faces), np.argsort(b.faces)
        np.testing.assert_array_equal(a.faces[order_a], b.faces[order_b])
        np.testing.assert_array_equal(a.features[order_a], b.features[order_b])
        np.testing.assert_array_equal(a.distances[order_a], b.distances[order_b])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("point", "feature", "closest"),
    [
        ((1, 1, 2), 0, (1, 1, 0)),
        ((2, -1, 1), 1, (2, 0, 0)),
        ((3, 3, -1), 2, (2, 2, 0)),
        ((-1, 2, 0), 3, (0, 2, 0)),
        ((-1, -1, 3), 4, (0, 0, 0)),
        ((6, -1, 0), 5, (4, 0, 0)),
        ((-1, 7, 0), 6, (0, 4, 0)),
    ],
)
def test_features(kind, point, feature, closest):
    index = TriangleIndex.of(checked_mesh(([[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[0, 1, 2]])), kind)
    found = index.within(np.array(point, float), 10.0)
    assert found.features[0] == feature
    np.testing.assert_allclose(found.points[0], closest, atol=1e-15)


def test_more_than_there_was_room_for():
    index = TriangleIndex.of(checked_mesh(rough()))
    assert len(index.within(np.zeros(3), 100.0).faces) == len(index.mesh.faces)


def test_equal_centres_are_halved_too():
    corners = np.tile([[0.0, 0, 0], [3, 0, 0], [0, 3, 0]], (100, 1))
    mesh = checked_mesh((corners, np.arange(300).reshape(-1, 3)))
    for kind in KINDS:
        assert len(TriangleIndex.of(mesh, kind).within([1, 1, 1], 1.5).faces) == 100


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("turned", [0.0, 0.1, 1.0])
def test_inside_whichever_way_triangles_face(turned, kind):
    mesh = trimesh.creation.box((4, 6, 8)).subdivide().subdivide()
    turned_mesh = checked_mesh(flipped((np.asarray(mesh.vertices), np.asarray(mesh.faces)), turned))
    index = TriangleIndex.of(turned_mesh, kind)
    points = np.random.default_rng(0).uniform(-5, 5, (200, 3))
    expected = (np.abs(points) < [2, 3, 4]).all(axis=1)
    assert [index.inside(point) for point in points] == expected.tolist()
    assert 0 < expected.sum() < 200
    assert index.inside([0, 0, 0])  # where rays go through symmetric edges


def test_an_open_surface_has_no_inside():
    with pytest.raises(InputError, match="16 open edges"):
        TriangleIndex.of(checked_mesh(fan())).inside([0.1, 0.2, 0.3])


def test_bad_queries():
    mesh = checked_mesh(rough())
    index = TriangleIndex.of(mesh)
    with pytest.raises(InputError, match="kind"):
        TriangleIndex.of(mesh, "octree")
    with pytest.raises(InputError, match="leaf"):
        TriangleIndex.of(mesh, leaf=0)
    with pytest.raises(InputError, match="finite"):
        index.within([0, 0, np.nan], 1.0)
    with pytest.raises(InputError, match="finite"):
        index.nearest([0, 0, 0])
    for radius in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="radius"):
            index.within([0, 0, 0], radius)
