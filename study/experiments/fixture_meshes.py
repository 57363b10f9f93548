"""Meshes that are hard on a virtual fixture: thin, sharp, turned round, not manifold, and bone."""

from __future__ import annotations

import numpy as np
import pyvista as pv
import trimesh

from study.specimens import specimen
from study.volumes import LabelVolume, surface

#: Vertices (v, 3) in mm and triangles (n, 3).
Mesh = tuple[np.ndarray, np.ndarray]


def plate(count: int = 40, size: float = 12.0, seed: int = 0) -> Mesh:
    """A flat plate at z = 0 of unevenly shaped triangles; `count` vertices along each edge, `size` mm."""
    line = np.linspace(-size / 2, size / 2, count)
    x, y = np.meshgrid(line, line, indexing="ij")
    vertices = np.c_[x.ravel(), y.ravel(), np.zeros(x.size)]
    jitter = np.random.default_rng(seed).uniform(-0.3, 0.3, (len(vertices), 2)) * (line[1] - line[0])
    vertices[:, :2] += jitter
    i = np.arange(count * count).reshape(count, count)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    return vertices, np.r_[np.c_[a, b, c], np.c_[a, c, d]]


def wall(thickness: float = 0.02) -> Mesh:
    """A wall thinner than a step, mm."""
    mesh = trimesh.creation.box((8.0, 8.0, thickness))
    for _ in range(4):
        mesh = mesh.subdivide()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def spikes(count: int = 150, seed: int = 1) -> Mesh:
    """Needles 3 mm long and 20 micrometres wide at their foot, touching nothing."""
    rng = np.random.default_rng(seed)
    foot = rng.uniform(-4, 4, (count, 3)) * [1, 1, 0.3]
    along = rng.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    corners = np.stack([foot + 0.01 * across, foot - 0.01 * across, foot + 3 * along], axis=1)
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def rough(seed: int = 2, subdivisions: int = 4) -> Mesh:
    """A ball of 5 mm with dents and bumps; 5120 triangles at four subdivisions."""
    mesh = trimesh.creation.icosphere(subdivisions, 5.0)
    vertices = np.asarray(mesh.vertices)
    waves = np.random.default_rng(seed).normal(size=(6, 3))
    bumps = sum(np.sin(2.5 * vertices @ wave / np.linalg.norm(wave)) for wave in waves)
    return vertices * (1 + 0.06 * bumps[:, None]), np.asarray(mesh.faces)


def flipped(mesh: Mesh, part: float = 0.1, seed: int = 3) -> Mesh:
    """The same triangles, a part of them the wrong way round."""
    vertices, faces = mesh
    faces = faces.copy()
    turned = np.random.default_rng(seed).random(len(faces)) < part
    faces[turned] = faces[turned][:, ::-1]
    return vertices, faces


def decimated(mesh: Mesh, part: float) -> Mesh:
    """The same surface with a part of its triangles taken away, by VTK: not everywhere manifold."""
    vertices, faces = mesh
    body = pv.PolyData(vertices, np.c_[np.full(len(faces), 3), faces].ravel()).decimate(part)
    return np.asarray(body.points, dtype=np.float64), body.regular_faces


def ball(radius: float = 5.0, subdivisions: int = 3) -> Mesh:
    """A ball of even triangles."""
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def together(*meshes: Mesh) -> Mesh:
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def fan(blades: int = 5) -> Mesh:
    """Sheets that all meet at one edge, which is not manifold."""
    angles = np.linspace(0, 2 * np.pi, blades, endpoint=False)
    outer = np.c_[4 * np.cos(angles), 4 * np.sin(angles)]
    vertices = [[0.0, 0, -3], [0, 0, 3]]
    faces = []
    for k, (x, y) in enumerate(outer):
        vertices += [[x, y, -3], [x, y, 3]]
        faces += [[0, 1, 2 + 2 * k], [1, 3 + 2 * k, 2 + 2 * k]]
    return np.array(vertices), np.array(faces)


def bone(name: str = "CH01", smooth_mm: float = 0.0, middle: bool = False) -> Mesh:
    """The surface of a procedural specimen's bone by marching cubes; its `middle` is an eighth of it."""
    volume = specimen(name).anatomy
    if middle:
        quarter = np.array(volume.labels.shape) // 4
        x, y, z = (slice(a, -a) for a in quarter)
        affine = volume.affine.copy()
        affine[:3, 3] += affine[:3, :3] @ quarter
        volume = LabelVolume(volume.labels[x, y, z], affine, volume.names)
    mesh = surface(volume, "bone", smooth_mm)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)
