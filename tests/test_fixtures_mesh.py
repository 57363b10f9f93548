"""Meshes for fixtures: bad ones are refused with values, neighbours are found, formats are read."""

import numpy as np
import pytest
import trimesh
from fixture_cases import fan, rough

from study.errors import GeometryError, InputError
from study.fixtures import MeshFixture, checked_mesh
from study.volumes import LabelVolume

TRIANGLE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 4, 0], [2, 2, 0]])


def test_triangles_without_area_are_dropped_and_counted():
    mesh = checked_mesh((TRIANGLE, [[0, 1, 2], [0, 0, 1], [1, 3, 2], [2, 1, 0]]))
    assert mesh.dropped == 2
    assert mesh.kept.tolist() == [0, 3]
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1], [0, 0, -1]])


def test_needles_stay():
    mesh = checked_mesh(([[0, 0, 0], [5, 0, 0], [2, 1e-8, 0]], [[0, 1, 2]]))
    assert mesh.dropped == 0


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (TRIANGLE, np.zeros((0, 3), int), "at least one triangle"),
        (TRIANGLE, [[0, 1, 1]], "got 1 without"),
        (TRIANGLE, [[0, 1, 4]], "numbers from 0 to 4"),
        (TRIANGLE, [[0, 1, -1]], "numbers from -1 to 1"),
        (TRIANGLE, [[0.0, 1, 2]], "float64"),
        (TRIANGLE[:, :2], [[0, 1, 2]], r"\(4, 2\)"),
        (np.where(np.arange(4)[:, None] == 1, np.nan, TRIANGLE), [[0, 1, 2], [0, 2, 3]], "first number 1"),
    ],
)
def test_bad_meshes(vertices, faces, message):
    with pytest.raises(InputError, match=message):
        checked_mesh((vertices, faces))


def test_something_else_is_no_mesh():
    with pytest.raises(InputError, match="got str"):
        checked_mesh("bone.stl")


def test_a_vertex_that_no_triangle_uses_may_be_anything():
    vertices = np.vstack([TRIANGLE, [np.nan] * 3, [1e9] * 3])
    assert checked_mesh((vertices, [[0, 1, 2]])).extent.tolist() == [4, 4, 0]


@pytest.mark.parametrize(("scale", "hint"), [(1e-3, "0.01.* mm; is it in metres"), (1e3, "micrometres")])
def test_another_unit_is_suspected(scale, hint):
    vertices, faces = rough()
    with pytest.raises(GeometryError, match=hint):
        checked_mesh((vertices * scale, faces))
    assert len(checked_mesh((vertices * scale, faces), plausible_mm=(0, np.inf)).faces) == len(faces)


def test_neighbours_of_a_tetrahedron():
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) * 5
    around = checked_mesh((vertices, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])).adjacency
    assert around.closed
    assert around.edge_counts.tolist() == [2] * 6
    assert sorted(around.at_edge(0, 0)) == [0, 3]  # 0-2
    assert sorted(around.at_edge(1, 2)) == [1, 3]  # 3-0
    assert sorted(around.at_vertex(0, 2)) == [0, 1, 2]  # vertex 1


def test_neighbours_at_an_edge_of_five_sheets():
    around = checked_mesh(fan(5)).adjacency
    assert around.non_manifold == 1
    assert sorted(around.at_edge(0, 0)) == [0, 2, 4, 6, 8]
    assert not around.closed


def test_a_soup_has_neighbours_where_its_corners_meet():
    vertices, faces = rough(subdivisions=2)
    soup = checked_mesh((vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)))
    assert soup.adjacency.closed
    assert len(soup.adjacency.edge_counts) == 3 * len(faces) // 2


@pytest.mark.parametrize("suffix", ["stl", "stl_ascii", "obj", "ply"])
def test_formats(tmp_path, suffix):
    mesh = trimesh.Trimesh(*rough(subdivisions=2), process=False)
    path = tmp_path / f"bone.{suffix.removesuffix('_ascii')}"
    mesh.export(path, file_type=suffix)
    fixture = MeshFixture(trimesh.load_mesh(path))
    assert len(fixture.mesh.faces) == len(mesh.faces)
    np.testing.assert_allclose(fixture.distances(mesh.triangles_center), 0, atol=1e-5)


def test_a_structure_of_a_volume():
    labels = np.zeros((20, 20, 20), np.uint8)
    labels[5:15, 5:15, 5:15] = 2
    volume = LabelVolume(labels, np.diag([0.5, 0.5, 0.5, 1.0]), {"air": 0, "bone": 1, "nerve": 2})
    fixture = MeshFixture.from_volume(volume, "nerve")
    assert fixture.name == "nerve"
    assert fixture.mesh.adjacency.closed
    # The surface lies half a voxel outside of the outermost centres, 2.5 and 7 mm.
    assert fixture.distances([[4.75, 4.75, 9.25]])[0] == pytest.approx(2.0, abs=1e-3)
    assert fixture.index.inside([4.75, 4.75, 4.75])
