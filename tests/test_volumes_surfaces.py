"""Surfaces of labels and labels of surfaces."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from real_data import real
from volume_cases import random_affine

from study.errors import FileFormatError, GeometryError, InputError, LabelError
from study.volumes import (
    LabelVolume,
    read_surface,
    read_volume,
    surface,
    volume_from_surface,
    write_surface,
)


def ball_volume(radius=5.0, step=(0.5, 0.6, 0.7)):
    count = np.ceil(2 * (radius + 2) / np.array(step)).astype(int)
    affine = np.diag([*step, 1.0])
    affine[:3, 3] = -(count - 1) / 2 * step
    volume = LabelVolume(np.zeros(count, np.uint8), affine)
    points = volume.points(np.argwhere(volume.labels == 0))
    return volume.with_labels((np.linalg.norm(points, axis=1) < radius).reshape(count).astype(np.uint8))


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32), share=st.sampled_from([0.02, 0.3, 0.5, 0.7, 1]))
def test_surface_of_any_voxels_is_closed_and_gives_them_back(seed, share):
    rng = np.random.default_rng(seed)
    labels = (rng.random(tuple(rng.integers(1, 8, 3))) < share).astype(np.uint8)
    labels.flat[0] = 1
    volume = LabelVolume(labels, random_affine(rng))
    mesh = surface(volume, "protected")
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0  # faces outward, also of mirrored frames
    back = volume_from_surface(mesh, like=volume, name="protected")
    assert (back.mask("protected") == volume.mask("protected")).all()
    assert (back.affine == volume.affine).all()


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32), smooth_mm=st.floats(0.1, 1.0))
def test_smoothed_surface_survives_an_stl_file(tmp_path_factory, seed, smooth_mm):
    rng = np.random.default_rng(seed)
    volume = ball_volume(3, tuple(rng.uniform(0.4, 0.8, 3)))
    affine = volume.affine.copy()
    affine[:3, 3] += rng.uniform(-300, 300, 3)
    volume = LabelVolume(volume.labels, affine)
    mesh = surface(volume, "protected", smooth_mm=smooth_mm)
    path = tmp_path_factory.mktemp("stl") / "ball.stl"
    write_surface(mesh, path)
    back = read_surface(path)
    assert mesh.is_watertight
    assert back.is_watertight
    assert back.volume == pytest.approx(mesh.volume, rel=1e-4)
    assert back.bounds == pytest.approx(mesh.bounds, abs=1e-4)


def test_surface_of_a_ball_is_where_the_ball_is():
    mesh = surface(ball_volume(), "protected", smooth_mm=0.5)
    distance = np.linalg.norm(mesh.vertices, axis=1)
    # Half the diagonal of a voxel bounds how far a staircase is off.
    assert np.abs(distance - 5).max() < 0.5 * np.linalg.norm([0.5, 0.6, 0.7])
    # Smoothing is heat flow for sigma^2 / 2: the surface moves inward by that times its curvature, 2 / r.
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * (5 - 0.5**2 / 5) ** 3, rel=0.01)
    assert mesh.face_normals[0] @ mesh.triangles_center[0] > 0
    steps = surface(ball_volume(), "protected")
    assert steps.area > mesh.area


def test_several_labels_and_what_cannot_be_drawn():
    labels = np.zeros((6, 6, 6), np.uint8)
    labels[1:5, 1:5, 1:3], labels[1:5, 1:5, 3:5] = 1, 2
    volume = LabelVolume(labels, np.eye(4))
    both = surface(volume, ["protected", "target"])
    assert both.volume > 1.9 * surface(volume, "target").volume
    with pytest.raises(LabelError, match="expected labels among"):
        surface(volume, "nerve")
    with pytest.raises(LabelError, match="got none"):
        surface(volume.with_labels(labels * 0), "target")
    for smooth_mm in (-1, np.nan):
        with pytest.raises(InputError, match="smooth_mm: expected"):
            surface(volume, "target", smooth_mm)
    with pytest.raises(InputError, match="leaves nothing"):
        surface(volume, "target", 5)


def test_stl_header_tells_slicer_the_frame(tmp_path):
    write_surface(trimesh.creation.box(), tmp_path / "a.stl")
    content = (tmp_path / "a.stl").read_bytes()
    assert b"SPACE=LPS" in content[:80]
    mesh = trimesh.creation.box()
    mesh.apply_translation([10, 20, 30])
    write_surface(mesh, tmp_path / "b.stl")
    content = (tmp_path / "b.stl").read_bytes()
    (tmp_path / "b.stl").write_bytes(content.replace(b"SPACE=LPS", b"SPACE=RAS"))
    moved = read_surface(tmp_path / "b.stl")
    assert moved.center_mass == pytest.approx([-10, -20, 30])
    assert moved.volume == pytest.approx(1)


def test_stl_as_text(tmp_path):
    text = trimesh.exchange.stl.export_stl_ascii(trimesh.creation.icosphere(subdivisions=1))
    (tmp_path / "a.stl").write_text(text)
    mesh = read_surface(tmp_path / "a.stl")
    assert mesh.is_watertight
    assert len(mesh.vertices) == 42


def test_bad_stl_files(tmp_path):
    good = tmp_path / "good.stl"
    write_surface(trimesh.creation.icosphere(subdivisions=1), good)
    content = good.read_bytes()
    absurd = []
    for number in (np.nan, np.inf, 1e30):
        changed = bytearray(content)
        changed[84 + 12 : 84 + 16] = np.float32(number).tobytes()
        absurd.append(bytes(changed))
    empty = content[:80] + bytes(4)
    for bad in (
        b"",
        b"some text\n",
        b"solid\nendsolid\n",
        content[:-7],
        content[:200],
        *absurd,
        empty,
    ):
        (tmp_path / "bad.stl").write_bytes(bad)
        with pytest.raises(FileFormatError, match=r"bad\.stl"):
            read_surface(tmp_path / "bad.stl")
    with pytest.raises(FileNotFoundError, match=r"none\.stl"):
        read_surface(tmp_path / "none.stl")
    good.rename(tmp_path / "good.vtk")
    with pytest.raises(FileFormatError, match=r"\.stl"):
        read_surface(tmp_path / "good.vtk")
    with pytest.raises(FileFormatError, match=r"\.stl"):
        write_surface(trimesh.creation.box(), tmp_path / "a.ply")
    with pytest.raises(InputError, match="mesh: expected"):
        write_surface(trimesh.Trimesh(), tmp_path / "a.stl")


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32))
def test_voxels_of_a_convex_body_are_those_behind_all_its_faces(seed):
    rng = np.random.default_rng(seed)
    mesh = trimesh.convex.convex_hull(rng.normal(0, 4, (20, 3)))
    volume = volume_from_surface(mesh, tuple(rng.uniform(0.3, 1, 3)), "tumour")
    points = volume.points(np.argwhere(np.ones(volume.shape, bool)))
    heights = (points[:, None] - mesh.triangles_center[None]) * mesh.face_normals[None]
    depth = heights.sum(axis=2).max(axis=1).reshape(volume.shape)
    clear = np.abs(depth) > 1e-3  # a centre on a face may fall either way
    assert (volume.mask("tumour") == (depth < 0))[clear].all()
    assert volume.names == {"air": 0, "tumour": 1}
    for axis in range(3):
        ends = np.moveaxis(volume.labels, axis, 0)[[0, -1]]
        assert not ends.any()  # air all around


@pytest.mark.parametrize("shift", [0, 0.25, 0.5, 0.9])
def test_a_box_of_n_voxels_holds_n_wherever_it_lies(shift):
    grid = LabelVolume(np.zeros((10, 11, 12), np.uint8), np.eye(4))
    mesh = trimesh.creation.box(extents=(4, 3, 5))
    mesh.apply_translation(np.array([5, 5, 5]) + shift)
    assert volume_from_surface(mesh, like=grid).mask("target").sum() == 60
    assert volume_from_surface(mesh, 1.0).mask("target").sum() == 60
    assert volume_from_surface(mesh, 1.0).shape == (6, 5, 7)


def test_inner_surface_is_a_cavity_and_a_file_will_do(tmp_path):
    outer, inner = (trimesh.creation.icosphere(subdivisions=4, radius=radius) for radius in (5, 3))
    write_surface(trimesh.util.concatenate(outer, inner), tmp_path / "shell.stl")
    volume = volume_from_surface(tmp_path / "shell.stl", 0.25, "shell")
    assert volume.volume_mm3("shell") == pytest.approx(outer.volume - inner.volume, rel=0.01)
    assert not volume.labels[tuple(np.array(volume.shape) // 2)]


def test_open_surfaces_and_bad_requests_are_refused(tmp_path):
    mesh = trimesh.creation.box(extents=(4, 4, 4))
    grid = LabelVolume(np.zeros((10, 10, 10), np.uint8), np.eye(4))
    opened = trimesh.Trimesh(mesh.vertices, mesh.faces[1:])
    write_surface(opened, tmp_path / "open.stl")
    for source, says in (
        (opened, "mesh: expected a closed"),
        (tmp_path / "open.stl", r"open\.stl: expected"),
    ):
        with pytest.raises(InputError, match=says) as caught:
            volume_from_surface(source, 1.0)
        assert "3 edges" in str(caught.value)
    with pytest.raises(InputError, match="closed surface"):
        volume_from_surface(trimesh.Trimesh(), 1.0)
    for request in ({}, {"spacing": 1.0, "like": grid}):
        with pytest.raises(InputError, match="exactly one"):
            volume_from_surface(mesh, **request)
    for spacing in (0, -1, np.nan, (1, 1, np.inf), 1e-6):
        with pytest.raises(GeometryError, match="spacing: expected"):
            volume_from_surface(mesh, spacing)
    with pytest.raises(InputError, match="air"):
        volume_from_surface(mesh, 1.0, "air")
    mesh.apply_translation([100, 0, 0])
    with pytest.raises(InputError, match="at least one voxel centre"):
        volume_from_surface(mesh, like=grid)


def test_real_kidney_surface_and_its_labels_agree():
    labels = read_volume(
        real("kidney/case_00101/labels_1mm.nrrd"), names={"air": 0, "kidney": 1, "tumour": 2}
    )
    mesh = read_surface(real("kidney/case_00101/kidney_with_tumour.stl"))
    assert mesh.is_watertight
    inside = volume_from_surface(mesh, like=labels, name="body").mask("body")
    expected = labels.mask("kidney", "tumour")
    # Their surface is of the mask after a 1 mm Gaussian, on a 2.2 mm lattice.
    overlap = 2 * (inside & expected).sum() / (inside.sum() + expected.sum())
    assert overlap > 0.97
    own = surface(labels, ["kidney", "tumour"], smooth_mm=1)
    assert own.is_watertight
    distance = trimesh.proximity.closest_point(mesh, own.vertices[::200])[1]
    assert distance.mean() < 0.5


def test_real_bone_surface_is_closed():
    volume = read_volume(real("temporal_bone/RT143/labels_0p38.nrrd"))
    mesh = surface(volume, "label_1")
    assert mesh.is_watertight
    back = volume_from_surface(mesh, like=volume, name="bone")
    assert (back.mask("bone") == volume.mask("label_1")).all()


def test_surface_on_another_lattice():
    i, j, k = np.indices((50, 50, 34))
    ball = (i - 25) ** 2 + (j - 25) ** 2 + (1.5 * (k - 17)) ** 2 <= 20**2
    volume = LabelVolume(ball.astype(np.uint8), np.diag([1, 1, 1.5, 1]), {"air": 0, "ball": 1})
    meshes = [surface(volume, "ball", 1.0, pitch) for pitch in (None, 0.8, 2.0, 3.7)]
    for mesh in meshes:
        assert mesh.is_watertight
        assert mesh.is_winding_consistent
        assert mesh.volume == pytest.approx(meshes[0].volume, rel=0.03)
        away = np.linalg.norm(mesh.vertices - [25, 25, 25.5], axis=1)
        assert np.abs(away - 20).max() < 0.8
    assert [
        len(mesh.vertices) * pitch**2 / mesh.area
        for mesh, pitch in zip(meshes[1:], (0.8, 2.0, 3.7), strict=True)
    ] == pytest.approx([1.5] * 3, rel=0.1)
    assert np.array_equal(surface(volume, "ball", 1.0).vertices, meshes[0].vertices)
    for pitch in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="pitch_mm"):
            surface(volume, "ball", 1.0, pitch)
    dot = LabelVolume((i + j + k == 67).astype(np.uint8), np.eye(4), {"air": 0, "dot": 1})
    with pytest.raises(InputError, match="mm, which leaves nothing"):
        surface(dot, "dot", 0.0, 40.0)
