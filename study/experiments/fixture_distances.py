"""Distances to a mesh by libraries that no fixture uses: VTK for points, coal for capsules."""

from __future__ import annotations

import coal
import numpy as np
import vtk
from scipy.spatial.transform import Rotation
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

from study.experiments.fixture_meshes import Mesh

#: Radius of what stands for a segment in coal, mm.
THIN_MM = 1e-9


class VtkDistance:
    """Distance of points to a mesh, and what a line crosses, by VTK in double precision.

    Parameters
    ----------
    mesh : tuple of arrays
        Vertices (v, 3) in mm and triangles (n, 3). Turned evenly, outward, if it is to tell sides.
    """

    def __init__(self, mesh: Mesh) -> None:
        vertices, faces = mesh
        points = vtk.vtkPoints()
        points.SetDataTypeToDouble()
        points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices), deep=True))
        cells = vtk.vtkCellArray()
        cells.SetData(3, numpy_to_vtkIdTypeArray(np.asarray(faces, dtype=np.int64).ravel(), deep=True))
        self.body = vtk.vtkPolyData()
        self.body.SetPoints(points)
        self.body.SetPolys(cells)
        self.locator = vtk.vtkStaticCellLocator()
        self.locator.SetDataSet(self.body)
        self.locator.BuildLocator()
        self._cell = vtk.vtkGenericCell()
        self._signed: vtk.vtkImplicitPolyDataDistance | None = None

    def __call__(self, point: np.ndarray) -> float:
        """Unsigned, of one point (3,), mm."""
        closest, cell, part, squared = [0.0] * 3, vtk.reference(0), vtk.reference(0), vtk.reference(0.0)
        self.locator.FindClosestPoint(point, closest, self._cell, cell, part, squared)
        return float(squared) ** 0.5

    def distances(self, points: np.ndarray) -> np.ndarray:
        """(q,) unsigned, of points (q, 3), mm."""
        return np.array([self(point) for point in points])

    def inside(self, points: np.ndarray) -> np.ndarray:
        """(q,) whether points (q, 3) are behind the nearest triangle of a closed, evenly turned mesh."""
        if self._signed is None:
            self._signed = vtk.vtkImplicitPolyDataDistance()
            self._signed.SetInput(self.body)
        values = vtk.vtkDoubleArray()
        self._signed.EvaluateFunction(numpy_to_vtk(np.ascontiguousarray(points), deep=True), values)
        return vtk_to_numpy(values) < 0

    def crosses(self, start: np.ndarray, stop: np.ndarray) -> bool:
        """Whether the line from one point (3,) to another meets a triangle."""
        t, where, local, part = vtk.reference(0.0), [0.0] * 3, [0.0] * 3, vtk.reference(0)
        return bool(self.locator.IntersectWithLine(start, stop, 0.0, t, where, local, part))


class CapsuleDistance:
    """Distance of a tool of capsules to a mesh, by coal.

    Parameters
    ----------
    mesh : tuple of arrays
    bodies : (b, 7) array
        See `study.fixtures.ShaftTool.bodies`.
    """

    def __init__(self, mesh: Mesh, bodies: np.ndarray) -> None:
        vertices, faces = mesh
        self._mesh = coal.BVHModelOBBRSS()
        self._mesh.beginModel(len(faces), len(vertices))
        self._mesh.addVertices(np.asarray(vertices, dtype=np.float64))
        self._mesh.addTriangles(np.asarray(faces, dtype=np.int64))
        self._mesh.endModel()
        self._bodies = [self._placed(body) for body in bodies]
        self._request = coal.DistanceRequest()

    @staticmethod
    def _placed(body: np.ndarray) -> tuple[coal.CollisionGeometry, float, np.ndarray, np.ndarray]:
        along = body[3:6] - body[:3]
        length = float(np.linalg.norm(along))
        turn = np.eye(3)
        if length > 0:
            turn = Rotation.align_vectors([along / length], [[0, 0, 1.0]])[0].as_matrix()
        # All but a segment: its radius is taken off what is found, which so goes on below zero.
        shape = coal.Capsule(THIN_MM, length) if length > 0 else coal.Sphere(THIN_MM)
        return shape, float(body[6]) - THIN_MM, (body[:3] + body[3:6]) / 2, turn

    def __call__(self, pose: np.ndarray) -> float:
        """Least distance of the mesh to a segment less its radius, mm, for a pose (3,) or (6,)."""
        turn = Rotation.from_rotvec(pose[3:]).as_matrix() if len(pose) == 6 else np.eye(3)
        least = np.inf
        for shape, radius, middle, own in self._bodies:
            place = coal.Transform3s(turn @ own, pose[:3] + turn @ middle)
            result = coal.DistanceResult()
            coal.distance(self._mesh, coal.Transform3s.Identity(), shape, place, self._request, result)
            least = min(least, result.min_distance - radius)
        return least
