"""Fixtures from files: STL, PLY and OBJ, binary and text, give the same surface."""

import numpy as np
import pytest
import trimesh
from fixture_cases import rough

from study.errors import FileFormatError, GeometryError
from study.fixtures import Controller, MeshFixture, SphereTool
from study.volumes import read_surface

KINDS = {"stl": "stl", "stl_ascii": "stl", "ply": "ply", "obj": "obj"}


def written(folder, mesh, kind):
    path = folder / f"{kind}.{KINDS[kind]}"
    content = mesh.export(file_type=kind)
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_from_file(tmp_path, kind):
    mesh = trimesh.Trimesh(*rough(subdivisions=3), process=False)
    fixture = MeshFixture.from_file(written(tmp_path, mesh, kind))
    assert fixture.name == kind
    assert len(fixture.mesh.faces) == len(mesh.faces)
    assert fixture.closed
    assert fixture.mesh.dropped == 0
    step = Controller([fixture], SphereTool(1.0)).step([0, 0, 8.0], [0, 0, -0.2])
    again = Controller([MeshFixture(mesh)], SphereTool(1.0)).step([0, 0, 8.0], [0, 0, -0.2])
    np.testing.assert_allclose(step.motion, again.motion, atol=1e-5)


def test_ply_as_text_and_from_slicer(tmp_path):
    mesh = trimesh.Trimesh(*rough(subdivisions=2), process=False)
    text = trimesh.exchange.ply.export_ply(mesh, encoding="ascii").decode()
    (tmp_path / "lps.ply").write_text(text)
    (tmp_path / "ras.ply").write_text(
        text.replace("\n", "\ncomment SPACE=RAS\n", 2).replace("comment SPACE=RAS\n", "", 1)
    )
    lps, ras = read_surface(tmp_path / "lps.ply"), read_surface(tmp_path / "ras.ply")
    np.testing.assert_allclose(np.asarray(lps.vertices) * [-1, -1, 1], ras.vertices)


def test_squeezed_triangles_are_counted(tmp_path):
    vertices, faces = rough(subdivisions=2)
    mesh = trimesh.Trimesh(vertices, np.vstack([faces, [[0, 1, 1], [5, 5, 5]]]), process=False)
    assert MeshFixture(mesh).mesh.dropped == 2
    assert MeshFixture.from_file(written(tmp_path, mesh, "stl")).mesh.dropped == 2


@pytest.mark.parametrize("name", ["a.ply", "a.obj", "a.stl"])
@pytest.mark.parametrize(
    "content", [b"", b"nothing", b"ply\nformat ascii 1.0\nelement vertex 3\n", b"v 0 0 0\nf 1 2 3\n"]
)
def test_broken_files_are_refused(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=name):
        read_surface(path)


def test_metres_and_unknown_kinds_are_refused(tmp_path):
    vertices, faces = rough(subdivisions=2)
    path = written(tmp_path, trimesh.Trimesh(vertices / 1000, faces, process=False), "ply")
    with pytest.raises(GeometryError, match=r"got 0\.01.* mm; is it in metres"):
        MeshFixture.from_file(path)
    other = tmp_path / "a.vtk"
    other.write_text("")
    with pytest.raises(FileFormatError, match="ends with"):
        MeshFixture.from_file(other)
    with pytest.raises(FileNotFoundError):
        MeshFixture.from_file(tmp_path / "none.stl")
