"""Closed triangle surfaces of labels, in STL files and back to voxels."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from study.errors import FileFormatError, GeometryError, InputError, LabelError
from study.files import written_whole
from study.volumes.file_checks import existing_file, parsing
from study.volumes.label_volume import LabelVolume

# Imported where a surface is made: most of what needs volumes makes none.
if TYPE_CHECKING:
    import trimesh

_HEADER = b"study label surface; SPACE=LPS; unit mm"
_MOST_VOXELS = 2**31
#: Kinds of files that `read_surface` knows, and what it says to their reader.
SURFACE_KINDS = {
    "stl": {},
    "ply": {"fix_texture": False},
    "obj": {"skip_materials": True, "maintain_order": True},
}
_FARTHEST = 1e6  # mm; merging equal corners works on integers and must not overflow
_OFF_LEVEL = 1e-3
# Voxels; decides about centres on the surface, above the tolerance of VTK's scan conversion (2^-17).
_NUDGE = 1e-4


def surface(
    volume: LabelVolume,
    name: str | Sequence[str],
    smooth_mm: float = 0.0,
    pitch_mm: float | None = None,
) -> trimesh.Trimesh:
    """The closed surface of a label by marching cubes.

    Parameters
    ----------
    volume : LabelVolume
    name : str or sequence of str
        One label, or several taken together.
    smooth_mm : float
        Standard deviation in mm of a Gaussian that smooths the voxel steps first. It rounds edges and
        shrinks what is convex (a ball of radius r by about ``smooth_mm**2 / r``); 0 leaves the steps.
    pitch_mm : float, optional
        mm between the points of the lattice on whose edges the vertices lie, about 1.5 vertices for
        ``pitch_mm**2`` of area; the volume's own grid by default. What is thinner is lost.

    Returns
    -------
    trimesh.Trimesh
        Vertices in mm (LPS), watertight also where the label reaches the volume's edge, faces outward.

    Raises
    ------
    LabelError
        If a name is not the volume's, or no voxel has it.
    InputError
        If a length is negative or not finite, or smoothing or a coarse lattice leaves nothing.
    """
    import trimesh
    from skimage import measure

    names = [name] if isinstance(name, str) else list(name)
    mask = volume.mask(*names)
    if not mask.any():
        raise LabelError(f"expected voxels of {names}, got none in {volume!r}")
    if not np.isfinite(smooth_mm) or smooth_mm < 0:
        raise InputError(f"smooth_mm: expected a length of at least 0 mm, got {smooth_mm}")
    if pitch_mm is not None and not (np.isfinite(pitch_mm) and pitch_mm > 0):
        raise InputError(f"pitch_mm: expected a length above 0 mm, got {pitch_mm}")
    box = ndimage.find_objects(mask.astype(np.uint8))[0]
    sigma = smooth_mm / volume.spacing
    pad = np.ceil(4 * sigma).astype(int) + 1
    field = np.pad(mask[box].astype(np.float32), [(n, n) for n in pad])
    if smooth_mm > 0:
        field = ndimage.gaussian_filter(field, sigma)
        if field.max() <= 0.5:
            raise InputError(
                f"smooth_mm: expected less than the thickness of {names}, "
                f"got {smooth_mm} mm, which leaves nothing"
            )
    step = np.ones(3)
    if pitch_mm is not None:
        field, step = _on_lattice(field, pitch_mm / volume.spacing)
        if field.max() <= 0.5:
            raise InputError(
                f"pitch_mm: expected less than the thickness of {names}, "
                f"got {pitch_mm} mm, which leaves nothing"
            )
    # Vertices that meet at a grid point would become one in an STL file: keep values off the level.
    near = np.abs(field - 0.5) < _OFF_LEVEL
    field[near] = 0.5 + np.where(field[near] < 0.5, -_OFF_LEVEL, _OFF_LEVEL)
    # The Lewiner variant decides ambiguous faces by a comparison that a binary field leaves tied, and
    # joins four triangles at an edge; the classic one does not.
    vertices, faces, _, _ = measure.marching_cubes(field, 0.5, method="lorensen")
    start = np.array([part.start for part in box]) - pad
    mesh = trimesh.Trimesh(volume.points(vertices.astype(float) * step + start), faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def _on_lattice(field: np.ndarray, step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values of a padded field, linear between its voxels, on a lattice from the first voxel on."""
    # The last point may lie beyond the field, where it is as empty as at its edge.
    counts = [int(np.ceil((n - 1) / s)) + 1 for n, s in zip(field.shape, step, strict=True)]
    return ndimage.affine_transform(field, step, output_shape=counts, order=1, mode="nearest"), step


def write_surface(mesh: trimesh.Trimesh, path: str | os.PathLike[str]) -> None:
    """Write a surface in mm (LPS) as a binary STL file.

    The header says ``SPACE=LPS``, which 3D Slicer reads. STL keeps single precision.

    Raises
    ------
    FileFormatError
        If the suffix is not ``.stl``.
    InputError
        If the mesh has no faces or a vertex is not finite.
    """
    import trimesh

    path = Path(path)
    if path.suffix.lower() != ".stl":
        raise FileFormatError(f"{path}: expected a name that ends with .stl")
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        raise InputError(f"mesh: expected finite vertices and at least one face, got {mesh!r}")
    content = trimesh.exchange.stl.export_stl(mesh)
    with written_whole(path) as temporary:
        temporary.write_bytes(_HEADER.ljust(80) + content[80:])


def read_surface(path: str | os.PathLike[str]) -> trimesh.Trimesh:
    """Read a surface from an STL, PLY or OBJ file, binary or text.

    Parameters
    ----------
    path : path-like
        Coordinates in mm. LPS, unless the header says ``SPACE=RAS``, as 3D Slicer writes it.

    Returns
    -------
    trimesh.Trimesh
        In LPS; equal corners of neighbouring triangles are one vertex. Triangles that are squeezed to a line
        are left out; how many is ``metadata["squeezed"]``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    FileFormatError
        If it is not such a file, is truncated, has no triangle, or a coordinate is not finite or more than a
        kilometre.
    """
    import trimesh

    path = existing_file(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in SURFACE_KINDS:
        raise FileFormatError(f"{path}: expected a name that ends with .stl, .ply or .obj")
    with parsing(path, f"a file of a surface ({kind.upper()})"):
        mesh = trimesh.load(path, file_type=kind, process=False, force="mesh", **SURFACE_KINDS[kind])
        vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    if faces.ndim != 2 or len(faces) == 0:
        raise FileFormatError(f"{path}: expected a file with triangles, got none")
    if not (np.abs(vertices) < _FARTHEST).all():
        worst = vertices[~(np.abs(vertices) < _FARTHEST)][0]
        raise FileFormatError(f"{path}: expected coordinates within {_FARTHEST:g} mm, got {worst}")
    with path.open("rb") as stream:
        header = stream.read(256)
    if b"SPACE=RAS" in header:
        vertices = vertices * [-1, -1, 1]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    # Triangles that single precision has squeezed to a line carry no surface, but break up edges.
    corners = np.sort(mesh.faces, axis=1)
    whole = (corners[:, 1:] != corners[:, :-1]).all(axis=1)
    mesh.update_faces(whole)
    mesh.metadata["squeezed"] = int(np.count_nonzero(~whole))
    return mesh


def volume_from_surface(
    mesh: trimesh.Trimesh | str | os.PathLike[str],
    spacing: float | Sequence[float] | None = None,
    name: str = "target",
    *,
    like: LabelVolume | None = None,
) -> LabelVolume:
    """The voxels whose centres lie inside a closed surface.

    Of centres on the surface itself those at the high end of i, j and k count as inside, those at the
    low end do not, so that a box as wide as n voxels holds n.

    Parameters
    ----------
    mesh : trimesh.Trimesh or path-like
        Closed surface in mm (LPS), or an STL file of one. Of nested surfaces the inner one is a cavity.
    spacing : float or (3,) floats, optional
        mm; the grid has the axes of the frame and at least one voxel of air around the surface.
    name : str
        Name of label 1, what is inside; 0 is air.
    like : LabelVolume, optional
        Take this volume's grid instead of a spacing. What lies outside the grid is cut off.

    Returns
    -------
    LabelVolume

    Raises
    ------
    InputError
        If the surface is not closed, no voxel centre lies inside, `name` is "air", or not exactly one
        of `spacing` and `like` is given.
    GeometryError
        If the spacing is not positive and finite, or the grid would be unreasonably large.
    FileNotFoundError, FileFormatError
        See `read_surface`.
    """
    import trimesh

    source = "mesh"
    if not isinstance(mesh, trimesh.Trimesh):
        source = str(mesh)
        mesh = read_surface(mesh)
    if (spacing is None) == (like is None):
        raise InputError("expected exactly one of spacing and like")
    if name == "air":
        raise InputError('name: expected a name other than "air", which is what lies outside')
    if len(mesh.faces) == 0 or not mesh.is_watertight:
        edges = np.unique(mesh.edges_sorted, axis=0, return_counts=True)[1]
        raise InputError(
            f"{source}: expected a closed surface, got one of {len(mesh.faces)} triangles "
            f"with {np.count_nonzero(edges != 2)} edges that do not join two triangles"
        )
    if like is None:
        shape, affine = _grid_around(mesh, spacing)
    else:
        shape, affine = like.shape, like.affine
    inverse = np.linalg.inv(affine)
    corners = mesh.vertices @ inverse[:3, :3].T + inverse[:3, 3]
    inside = _inside(corners + _NUDGE, mesh.faces, shape)
    if not inside.any():
        raise InputError(f"{source}: expected a surface around at least one voxel centre, got none")
    return LabelVolume(inside.astype(np.uint8), affine, {"air": 0, name: 1})


def _grid_around(
    mesh: trimesh.Trimesh, spacing: float | Sequence[float]
) -> tuple[tuple[int, int, int], np.ndarray]:
    step = np.broadcast_to(np.asarray(spacing, dtype=float), (3,))
    if not np.isfinite(step).all() or (step <= 0).any():
        raise GeometryError(f"spacing: expected positive numbers of mm, got {np.asarray(spacing).tolist()}")
    low, high = mesh.bounds
    count = np.ceil((high - low) / step - 1e-9) + 2
    if count.prod() > _MOST_VOXELS:
        raise GeometryError(f"spacing: expected at most {_MOST_VOXELS} voxels, got {count.tolist()}")
    affine = np.diag([*step, 1.0])
    affine[:3, 3] = (low + high) / 2 - (count - 1) / 2 * step
    return tuple(count.astype(int).tolist()), affine


def _inside(vertices: np.ndarray, faces: np.ndarray, shape: tuple[int, int, int]) -> np.ndarray:
    """(nx, ny, nz) bool array of grid points inside, by VTK's scan conversion; vertices as indices."""
    import pyvista as pv  # imports VTK, which nobody else in this room needs

    body = pv.PolyData.from_regular_faces(vertices, faces)
    grid = pv.ImageData(dimensions=shape)
    mask = body.voxelize_binary_mask(reference_volume=grid)["mask"]
    return np.asarray(mask).reshape(shape, order="F").astype(bool)
