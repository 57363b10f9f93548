"""Meshes that are hard on a virtual fixture, and distances by other means."""

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

from study.experiments.fixture_meshes import (
    ball,
    decimated,
    fan,
    flipped,
    plate,
    rough,
    spikes,
    together,
    wall,
)

__all__ = [
    "HARD",
    "VtkDistance",
    "ball",
    "closest_points",
    "decimated",
    "fan",
    "flipped",
    "plate",
    "rough",
    "spikes",
    "together",
    "wall",
    "winding_number",
]


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


def winding_number(mesh, x):
    """How often a surface goes round a point: 1 inside, 0 outside; by the solid angles of its triangles."""
    a, b, c = np.moveaxis(mesh[0][mesh[1]] - x, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    over = (a * np.cross(b, c)).sum(1)
    under = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return np.arctan2(over, under).sum() / (2 * np.pi)


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
