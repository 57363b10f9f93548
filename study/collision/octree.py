"""The dissertation's collision check: an octree of the bone's surface against three cylinders by GJK (2.2.3).

It is the reference that the faster check of this room is compared with and timed against; `coal` does
the work.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np

from study.collision.drill import Drill
from study.collision.exact._kernels import cylinder_overlaps_box
from study.errors import GeometryError, InputError

#: Voxels: a gap up to this counts as contact, which makes up for GJK's rounding (see `OctreeCheck`).
MARGIN = 1e-4

_GJK_TOLERANCE = 1e-6  # voxels; the least that coal recommends
_CUBE_TOLERANCE = 1e-6
_UNIT_TOLERANCE = 1e-6


def surface_voxels(solid: np.ndarray) -> np.ndarray:
    """The one voxel thick surface of a solid: its voxels with a face neighbour that is not solid.

    Parameters
    ----------
    solid : (nx, ny, nz) array
        Non-zero where there is bone. Outside the volume nothing is solid.

    Returns
    -------
    (n, 3) int array
        Indices.
    """
    padded = np.pad(np.asarray(solid) != 0, 1)
    inner = padded[1:-1, 1:-1, 1:-1]
    buried = inner.copy()
    for axis in range(3):
        for shift in (-1, 1):
            buried &= np.roll(padded, shift, axis)[1:-1, 1:-1, 1:-1]
    return np.argwhere(inner & ~buried)


class OctreeCheck:
    """Whether the drill's shaft is free of unmilled bone: surface octree, three cylinders, GJK (2.2.3).

    The surface of the bone, one voxel thick, is kept in an octree whose leaves are the voxels
    themselves, concentric with them and of their size. A pose is checked cylinder by cylinder, the
    shaft first, from the largest box down to the voxels near the cylinder, and there by GJK between
    voxel and cylinder; the first contact ends it.

    Parameters
    ----------
    solid : (nx, ny, nz) array
        Non-zero where there is unmilled bone, targeted or protected.
    spacing : (3,) array
        mm; the octree needs cubes.
    drill : Drill
    cylinders : sequence of (radius, start, end), optional
        mm along the axis from the burr's centre, in place of those of `drill`.
    timed : bool
        Add up in `seconds` what the checks take in `coal` itself, without Python around it.

    Raises
    ------
    GeometryError
        If the voxels are no cubes (1e-6 of their size).
    InputError
        If `solid` is not three-dimensional or a cylinder has no volume.

    Notes
    -----
    The burr is not part of the check. On arrival it removes the voxels that it overlaps, and those do
    not block: the caller removes them and calls `update`.

    A cylinder that lies in the bone whole touches no surface voxel. The drill cannot get there, since
    its far end is outside; for poses that nobody drilled, a far end in a solid voxel counts as
    collision. With it the surface decides as the whole bone would: the three cylinders together are one
    connected piece, and a piece that is partly in the bone and partly not crosses its surface.

    Lengths are passed to `coal` in voxels, so that the leaves' faces are whole numbers, free of
    rounding. What is left is GJK's. Asked for yes or no only, `coal` 3 takes a distance below 1e-12 for
    contact, while its GJK stops within 1e-6 of the origin: along grid axes overlaps of three voxels
    were overlooked, elsewhere such of 0.04 voxels. A security margin cures it. Of 1.2 million contacts
    built between a voxel's face, edge or corner and a cylinder's side, cap or rim, apart or overlapping
    by 1e-9 to 0.03 mm, the deepest overlap that was overlooked measured 1.4e-4 voxels with a margin of
    1e-6, 2.2e-5 with 1e-5, and none was overlooked with 1e-4, which is taken. So "free" may be refused
    within `gap_mm` of the bone and is never granted in it.

    One check must not be used by two threads at once: `coal`'s solver keeps its simplex in it.
    """

    def __init__(
        self,
        solid: np.ndarray,
        spacing: np.ndarray,
        drill: Drill | None = None,
        *,
        cylinders: Sequence[tuple[float, float, float]] | None = None,
        timed: bool = False,
    ):
        spacing = np.asarray(spacing, float)
        if spacing.shape != (3,) or not np.isfinite(spacing).all() or (spacing <= 0).any():
            raise GeometryError(f"spacing: expected three positive mm, got {spacing.tolist()}")
        if np.ptp(spacing) > _CUBE_TOLERANCE * spacing.max():
            raise GeometryError(
                f"spacing: expected cubic voxels, which an octree of voxels needs, got {spacing.tolist()} mm"
            )
        self.voxel = float(spacing.mean())
        self.cylinders = np.array((drill or Drill()).cylinders if cylinders is None else cylinders, float)
        radius, start, end = self.cylinders.reshape(-1, 3).T
        if self.cylinders.ndim != 2 or not len(radius) or (radius <= 0).any() or (start >= end).any():
            raise InputError(
                "cylinders: expected (radius, start, end) in mm with radius > 0 and start < end, "
                f"got {self.cylinders.tolist()}"
            )
        self._spread = float(np.ptp(spacing) / self.voxel)
        self._shapes = [coal.Cylinder(r, z - a) for r, a, z in self.cylinders / self.voxel]
        self._middles = (start + end) / 2 / self.voxel
        self._far = float(end.max() / self.voxel)
        self._request = coal.CollisionRequest(coal.CollisionRequestFlag.NO_REQUEST, 1)
        self._request.gjk_tolerance = _GJK_TOLERANCE
        self._request.enable_timings = timed
        self._request.security_margin = MARGIN
        self._request.distance_upper_bound = 10 * MARGIN  # how far beyond does not matter
        self._result = coal.CollisionResult()
        self.seconds = 0.0
        self._world, self._pose = coal.Transform3s(), coal.Transform3s()
        self.update(solid)

    def update(self, solid: np.ndarray) -> None:
        """Take the bone as it is now; the octree is built anew.

        Parameters
        ----------
        solid : (nx, ny, nz) array
            Copied.
        """
        solid = np.asarray(solid)
        if solid.ndim != 3 or not solid.size:
            raise InputError(f"solid: expected a three-dimensional array, got shape {solid.shape}")
        self.solid = solid != 0
        leaves = surface_voxels(self.solid) + 0.5  # voxel i is the cube from i to i + 1
        self._octree = coal.makeOctree(np.ascontiguousarray(leaves), 1.0) if len(leaves) else None
        self._read: np.ndarray | None = None
        self._checks = [coal.ComputeCollision(self._octree, s) for s in self._shapes] if len(leaves) else []

    @property
    def gap_mm(self) -> float:
        """The widest gap in mm between shaft and bone at which a pose may still be refused."""
        return 1.01 * MARGIN * self.voxel + self.uneven_mm

    @property
    def uneven_mm(self) -> float:
        """How far in mm the cubes may lie from the given voxels, because those are no exact cubes."""
        return self._spread * max(self.solid.shape) * self.voxel

    def is_free(self, position: np.ndarray, axis: np.ndarray) -> bool:
        """Whether the shaft at one pose meets no bone.

        Parameters
        ----------
        position : (3,) array
            Burr's centre, mm of the index frame (a voxel's centre is its index times the spacing).
        axis : (3,) array
            Unit vector from the burr's centre towards the drill's body, index axes.
        """
        return bool(self.free(position, np.asarray(axis, float)[None])[0])

    def free(self, position: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """Whether the shaft meets no bone, for many directions at one position.

        Parameters
        ----------
        position : (3,) or (n, 3) array
            Burr's centre, or one for each direction, mm of the index frame.
        axes : (n, 3) array
            Unit vectors towards the drill's body, index axes.

        Returns
        -------
        (n,) bool array

        Raises
        ------
        InputError
            If a shape is wrong, a number is not finite or an axis is not a unit vector.
        """
        position, axes = np.asarray(position, float), np.asarray(axes, float)
        if axes.ndim != 2 or axes.shape[1] != 3 or position.shape not in {(3,), axes.shape}:
            raise InputError(
                "expected a (3,) position, or one for each of the (n, 3) axes, "
                f"got shapes {position.shape} and {axes.shape}"
            )
        lengths = np.linalg.norm(axes, axis=1)
        if not np.isfinite(position).all() or not (np.abs(lengths - 1) < _UNIT_TOLERANCE).all():
            raise InputError(
                "expected finite positions and unit vectors, got lengths from "
                f"{lengths.min(initial=1)} to {lengths.max(initial=1)}"
            )
        burrs = position / self.voxel + 0.5
        free = ~self._is_solid(burrs + self._far * axes)
        if self._checks:
            middles = burrs + self._middles[:, None, None] * axes
            self._meet(np.flatnonzero(free), _turns(axes), middles, free)
        return free

    def _meet(self, rows: np.ndarray, turns: np.ndarray, middles: np.ndarray, free: np.ndarray) -> None:
        """Clear `free` in each of the rows in which one of the cylinders meets the octree."""
        place, world, pose = self._pose.setTransform, self._world, self._pose
        request, result = self._request, self._result
        parts = list(zip(self._checks, middles, strict=True))
        timed = request.enable_timings
        result.clear()
        for n in rows:
            for check, middle in parts:
                place(turns[n], middle[n])
                hit = check(world, pose, request, result)
                if timed:
                    self.seconds += 1e-6 * result.timings.user
                if hit:
                    free[n] = False
                    result.clear()
                    break

    def _is_solid(self, points: np.ndarray) -> np.ndarray:
        index = np.floor(points).astype(np.int64)
        inside = ((index >= 0) & (index < self.solid.shape)).all(axis=1)
        out = np.zeros(len(points), bool)
        out[inside] = self.solid[tuple(index[inside].T)]
        return out

    @property
    def levels(self) -> int:
        """How many levels the octree has, from the voxels to the one box around all of them."""
        return int(self._leaves().max(initial=0)).bit_length() + 1

    def boxes(self, level: int | None = None) -> np.ndarray:
        """The octree's boxes, to be drawn.

        Parameters
        ----------
        level : int, optional
            0 is the surface voxels, `levels` - 1 the box around everything; all levels by default,
            the largest box first.

        Returns
        -------
        (n, 4) array
            Centre and edge length, mm of the index frame.
        """
        if level is None:
            return np.concatenate([self.boxes(n) for n in reversed(range(self.levels))])
        if not 0 <= level < self.levels:
            raise InputError(f"level: expected 0 to {self.levels - 1}, got {level}")
        return self._boxes(self._nodes(level), level)

    def met(self, position: np.ndarray, axis: np.ndarray) -> list[np.ndarray]:
        """The boxes that the shaft at a pose overlaps, level by level: what a check looks into.

        Parameters
        ----------
        position, axis : (3,) arrays
            As for `is_free`.

        Returns
        -------
        list of (n, 4) arrays
            Like `boxes`, from the voxels to the box around everything. The first is empty if the pose
            is free.
        """
        position, axis = np.asarray(position, float), np.asarray(axis, float)
        out: list[np.ndarray] = []
        nodes = self._nodes(self.levels - 1)
        for level in reversed(range(self.levels)):
            boxes = self._boxes(nodes, level)
            corners = boxes[:, None, :3] + np.array([[-0.5], [0.5]]) * boxes[:, None, 3:]
            met = [
                any(cylinder_overlaps_box(position, axis, *part, low, high) for part in self.cylinders)
                for low, high in corners
            ]
            met = np.array(met, bool)
            out.insert(0, boxes[met])
            if level:
                children = self._nodes(level - 1)
                nodes = children[np.isin(_keys(children >> 1), _keys(nodes[met]))]
        return out

    def _nodes(self, level: int) -> np.ndarray:
        """(n, 3) places of a level's boxes, counted in boxes."""
        return np.unique(self._leaves() >> level, axis=0)

    def _boxes(self, nodes: np.ndarray, level: int) -> np.ndarray:
        size = 1 << level
        centres = (nodes * size + (size - 1) / 2) * self.voxel
        return np.column_stack([centres, np.full(len(nodes), size * self.voxel)])

    def _leaves(self) -> np.ndarray:
        """(n, 3) indices of the octree's leaves, read back from it."""
        if self._read is None:
            boxes = self._octree.toBoxes() if self._octree is not None else np.empty((0, 3))
            self._read = np.floor(np.array(boxes)[:, :3]).astype(np.int64)
        return self._read


def _keys(nodes: np.ndarray) -> np.ndarray:
    """One number for each place: `coal` counts to 2^16 along an axis."""
    return nodes @ np.array([1, 1 << 16, 1 << 32])


def _turns(axes: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotations that take z, along which `coal` lays its cylinders, to each axis."""
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    helper = np.zeros_like(axes)
    helper[np.arange(len(axes)), np.abs(axes).argmin(axis=1)] = 1.0
    first = np.cross(axes, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(axes, first), axes], axis=2)
