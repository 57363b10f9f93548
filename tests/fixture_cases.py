"""Meshes that are hard on a virtual fixture, and distances by other means."""

import numpy as np
import pyvista as pv
import trimesh
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray


def plate(count=40, size=12.0, seed=0):
    """A flat plate at z = 0 of unevenly shaped triangles."""
    line = np.linspace(-size / 2, size / 2, count)
    x, y = np.meshgrid(line, line, indexing="ij")
    vertices = np.c_[x.ravel(), y.ravel(), np.zeros(x.size)]
    jitter = np.random.default_rng(seed).uniform(-0.3, 0.3, (len(vertices), 2)) * (line[1] - line[0])
    vertices[:, :2] += jitter
    i = np.arange(count * count).reshape(count, count)
    a, b, c, d = i[:-1, :-1].ravel(), i[1:, :-1].ravel(), i[1:, 1:].ravel(), i[:-1, 1:].ravel()
    return vertices, np.r_[np.c_[a, b, c], np.c_[a, c, d]]


def wall(thickness=0.02):
    """A wall thinner than a step."""
    mesh = trimesh.creation.box((8.0, 8.0, thickness))
    for _ in range(4):
        mesh = mesh.subdivide()
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def spikes(count=150, seed=1):
    """Needles 3 mm long and 20 micrometres wide at their foot, touching nothing."""
    rng = np.random.default_rng(seed)
    foot = rng.uniform(-4, 4, (count, 3)) * [1, 1, 0.3]
    along = rng.normal(size=(count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(count, 3)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    corners = np.stack([foot + 0.01 * across, foot - 0.01 * across, foot + 3 * along], axis=1)
    return corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)


def rough(seed=2, subdivisions=4):
    """A ball with dents and bumps, of about a triangle for each tenth of a square millimetre."""
    mesh = trimesh.creation.icosphere(subdivisions, 5.0)
    vertices = np.asarray(mesh.vertices)
    waves = np.random.default_rng(seed).normal(size=(6, 3))
    bumps = sum(np.sin(2.5 * vertices @ wave / np.linalg.norm(wave)) for wave in waves)
    return vertices * (1 + 0.06 * bumps[:, None]), np.asarray(mesh.faces)


def flipped(mesh, part=0.1, seed=3):
    """The same triangles, some of them the wrong way round."""
    vertices, faces = mesh
    faces = faces.copy()
    turned = np.random.default_rng(seed).random(len(faces)) < part
    faces[turned] = faces[turned][:, ::-1]
    return vertices, faces


def decimated(mesh, part):
    """The same surface with a part of its triangles taken away, by VTK: not everywhere manifold."""
    vertices, faces = mesh
    body = pv.PolyData(vertices, np.c_[np.full(len(faces), 3), faces].ravel()).decimate(part)
    return np.asarray(body.points, dtype=np.float64), body.regular_faces


def ball(radius=5.0, subdivisions=3):
    """A ball of even triangles."""
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def together(*meshes):
    """Several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    faces = [faces + start for (_, faces), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(faces)


def fan(blades=5):
    """Sheets that all meet at one edge, which is not manifold."""
    angles = np.linspace(0, 2 * np.pi, blades, endpoint=False)
    outer = np.c_[4 * np.cos(angles), 4 * np.sin(angles)]
    vertices = [[0.0, 0, -3], [0, 0, 3]]
    faces = []
    for k, (x, y) in enumerate(outer):
        vertices += [[x, y, -3], [x, y, 3]]
        faces += [[0, 1, 2 + 2 * k], [1, 3 + 2 * k, 2 + 2 * k]]
    return np.array(vertices), np.array(faces)


HARD = {
    "plate": plate(),
    "wall": wall(),
    "spikes": spikes(),
    "rough": rough(),
    "flipped": flipped(rough()),
    "fan": fan(),
}


def closest_points(corners, point):
    """Of triangles (n, 3, 3), the points closest to a point (n, 3), by all edges and the plane."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    choices = []
    for start, stop in ((a, b), (b, c), (c, a)):
        along = stop - start
        length = np.maximum((along**2).sum(1), 1e-300)
        t = np.clip(((point - start) * along).sum(1) / length, 0, 1)
        choices.append(start + t[:, None] * along)
    u, v = b - a, c - a
    normal = np.cross(u, v)
    area = np.maximum((normal**2).sum(1), 1e-300)
    w = point - a
    s = (np.cross(w, v) * normal).sum(1) / area
    t = (np.cross(u, w) * normal).sum(1) / area
    foot = a + s[:, None] * u + t[:, None] * v
    foot[(s < 0) | (t < 0) | (s + t > 1)] = np.inf
    choices.append(foot)
    choices = np.stack(choices)
    best = ((choices - point) ** 2).sum(2).argmin(0)
    return choices[best, np.arange(len(corners))]


class VtkDistance:
    """Unsigned distance of a point to a mesh by VTK."""

    def __init__(self, mesh):
        vertices, faces = mesh
        points = vtk.vtkPoints()
        points.SetDataTypeToDouble()
        points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices), deep=True))
        cells = vtk.vtkCellArray()
        cells.SetData(3, numpy_to_vtkIdTypeArray(faces.astype(np.int64).ravel(), deep=True))
        self.body = vtk.vtkPolyData()
        self.body.SetPoints(points)
        self.body.SetPolys(cells)
        self.locator = vtk.vtkStaticCellLocator()
        self.locator.SetDataSet(self.body)
        self.locator.BuildLocator()
        self.cell = vtk.vtkGenericCell()

    def __call__(self, point):
        closest, cell, part, squared = [0.0] * 3, vtk.reference(0), vtk.reference(0), vtk.reference(0.0)
        self.locator.FindClosestPoint(point, closest, self.cell, cell, part, squared)
        return float(squared) ** 0.5

    def crosses(self, start, stop):
        """Whether a line from one point to another meets the mesh."""
        t, where, local, part = vtk.reference(0.0), [0.0] * 3, [0.0] * 3, vtk.reference(0)
        return bool(self.locator.IntersectWithLine(start, stop, 0.0, t, where, local, part))
