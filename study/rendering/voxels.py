"""Single voxels as cubes, for pictures in which each of them matters."""

from __future__ import annotations

import numpy as np
import pyvista as pv

from study.errors import InputError
from study.volumes import LabelVolume


def voxel_cubes(
    volume: LabelVolume, points: np.ndarray, values: np.ndarray | None = None, scale: float = 0.94
) -> pv.PolyData:
    """A cube for every point, as large as a voxel, along the volume's axes.

    Parameters
    ----------
    volume : LabelVolume
        Gives size and directions.
    points : (n, 3) array
        Centres, mm.
    values : (n,) array, optional
        Cell data "value" of each cube's faces.
    scale : float
        Edge over voxel size; below 1 leaves a gap, so that neighbours are told apart.

    Raises
    ------
    InputError
        If there is no point.
    """
    points = np.asarray(points, float).reshape(-1, 3)
    if not len(points):
        raise InputError("points: expected at least one voxel to draw, got none")
    signs = np.array([[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1],
                      [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]])  # fmt: skip
    quads = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [2, 3, 7, 6], [1, 2, 6, 5], [0, 4, 7, 3]])
    corners = scale / 2 * signs @ volume.affine[:3, :3].T
    vertices = (points[:, None] + corners[None]).reshape(-1, 3)
    faces = (8 * np.arange(len(points))[:, None, None] + quads[None]).reshape(-1, 4)
    mesh = pv.PolyData(vertices, np.column_stack([np.full(len(faces), 4), faces]).ravel())
    if values is not None:
        mesh.cell_data["value"] = np.repeat(np.asarray(values), 6)
    return mesh


def box_edges(volume: LabelVolume, centre: np.ndarray, reach: np.ndarray) -> pv.PolyData:
    """The twelve edges of the box of voxels within `reach` (voxels) of a centre (mm)."""
    half = np.asarray(reach, float) + 0.5
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, -1).T
    corners = np.asarray(centre, float) + (signs * half) @ volume.affine[:3, :3].T
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8) if np.abs(signs[a] - signs[b]).sum() == 2]
    lines = np.array([[2, a, b] for a, b in pairs]).ravel()
    return pv.PolyData(corners, lines=lines)
