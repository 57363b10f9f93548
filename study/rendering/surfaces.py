"""Triangle surfaces of voxel masks for pictures: in mm, smoothed just enough to hide the voxel steps."""

from __future__ import annotations

import numpy as np
import pyvista as pv
from scipy import ndimage

from study.errors import InputError

#: A mask with more voxels than this in its box is drawn from every second voxel, or fewer.
MOST_VOXELS = 12_000_000


def _box(mask: np.ndarray) -> tuple[slice, slice, slice]:
    found = ndimage.find_objects(mask.view(np.uint8))
    if not found or found[0] is None:
        raise InputError(f"mask: expected at least one voxel set, got none of {mask.shape}")
    return found[0]


def _to_mm(affine: np.ndarray, start: np.ndarray, step: int) -> np.ndarray:
    """Index of the cropped grid to mm."""
    shift = np.eye(4)
    shift[:3, :3] *= step
    shift[:3, 3] = start
    return affine @ shift


def mask_surface(mask: np.ndarray, affine: np.ndarray, *, smooth: int = 30) -> pv.PolyData:
    """The closed surface of a mask.

    Parameters
    ----------
    mask : (nx, ny, nz) bool array
    affine : (4, 4) array
        Voxel index to mm, directions included.
    smooth : int
        Iterations of Taubin's smoothing, which unlike a Gaussian leaves a nerve one voxel wide as it is.

    Returns
    -------
    pyvista.PolyData
        With normals outward, in mm. It is closed also where the mask reaches the edge of the array.

    Raises
    ------
    InputError
        If no voxel is set.
    """
    mask = np.ascontiguousarray(mask, dtype=bool)
    box = _box(mask)
    cropped = mask[box]
    step = 1
    while cropped.size / step**3 > MOST_VOXELS:
        step += 1
    field = np.pad(cropped[::step, ::step, ::step].astype(np.float32), 1)
    start = np.array([part.start for part in box]) - step
    grid = pv.ImageData(dimensions=field.shape, spacing=(1, 1, 1))
    grid["inside"] = field.ravel(order="F")
    mesh = grid.contour([0.5], scalars="inside", method="flying_edges")
    if mesh.n_points == 0:  # every voxel of a thin structure fell between those taken
        return mask_surface_exact(mask, affine)
    mesh.clear_data()
    if smooth:
        mesh = mesh.smooth_taubin(n_iter=smooth, pass_band=0.03)
    return _placed(mesh, _to_mm(np.asarray(affine, float), start, step))


def mask_surface_exact(mask: np.ndarray, affine: np.ndarray) -> pv.PolyData:
    """The outer faces of a mask's voxels, as they are: for pictures in which voxels are counted.

    Raises
    ------
    InputError
        If no voxel is set.
    """
    mask = np.ascontiguousarray(mask, dtype=bool)
    box = _box(mask)
    inside = np.pad(mask[box], 1)
    low = np.array([part.start for part in box]) - 1
    corners, faces = [], []
    for axis in range(3):
        for sign in (-1, 1):
            outer = inside & ~np.roll(inside, -sign, axis=axis)
            centres = np.argwhere(outer).astype(float)
            u, w = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
            normal = sign * np.eye(3)[axis] / 2
            ring = np.array([-u - w, u - w, u + w, w - u]) / 2
            square = normal + (ring if sign > 0 else ring[::-1])
            corners.append((centres[:, None] + square[None]).reshape(-1, 3))
    points = np.concatenate(corners)
    quads = np.arange(len(points)).reshape(-1, 4)
    faces = np.column_stack([np.full(len(quads), 4), quads])
    mesh = pv.PolyData(points, faces.ravel())
    return _placed(mesh, _to_mm(np.asarray(affine, float), low, 1), smooth_normals=False)


def _placed(mesh: pv.PolyData, matrix: np.ndarray, smooth_normals: bool = True) -> pv.PolyData:
    points = mesh.points @ matrix[:3, :3].T + matrix[:3, 3]
    out = mesh.copy(deep=False)
    out.points = points.astype(np.float32)
    if np.linalg.det(matrix[:3, :3]) < 0:  # a mirrored grid turns every triangle inside out
        out = out.flip_faces()
    if smooth_normals:
        out = out.compute_normals(
            cell_normals=False, split_vertices=False, consistent_normals=False, auto_orient_normals=False
        )
    return out
