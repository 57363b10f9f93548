"""Bone to collide with, and poses of a drill's shaft in it that every check is tested on.

`contacts` builds poses whose shaft touches one voxel's face, edge or corner with side, cap or rim and
moves them apart or together by a known amount, so that for a voxel alone the answer is known without
any check. `disagreements` compares any check with the plain exact kernel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.collision import Drill
from study.collision.exact import _kernels
from study.collision.octree import surface_voxels

#: The drill, one whose cylinders all end inside these volumes, and one that finds way between voxels.
LONG = Drill().cylinders
SHORT = Drill(shaft_ends=(5.0, 7.5, 11.0)).cylinders
THIN = ((0.3, 0.5, 2.0), (0.7, 2.0, 3.5), (1.1, 3.5, 5.0))
OFFSETS = (0.0, *(10.0**-n for n in range(3, 10)))  # mm


@dataclass(frozen=True, eq=False)
class ShaftCase:
    """Bone (uint8, index order), spacing (3,) mm, a shaft's cylinders (m, 3): radius, start, end in mm."""

    name: str
    solid: np.ndarray
    spacing: np.ndarray
    cylinders: np.ndarray

    @property
    def extent(self) -> np.ndarray:
        return np.array(self.solid.shape) * self.spacing


@dataclass(frozen=True, eq=False)
class Poses:
    """Burr's centres (n, 3) mm of the index frame, unit vectors (n, 3), where they come from (n,) str."""

    positions: np.ndarray
    axes: np.ndarray
    kinds: np.ndarray

    def __len__(self) -> int:
        return len(self.positions)

    @staticmethod
    def joined(parts: list[Poses]) -> Poses:
        fields = ("positions", "axes", "kinds")
        return Poses(*(np.concatenate([getattr(part, name) for part in parts]) for name in fields))


# Bone


def single_voxel(spacing: float = 0.38) -> np.ndarray:
    solid = np.zeros((7, 8, 9), np.uint8)
    solid[3, 4, 5] = 1
    return solid


def scattered(rng, shape=(26, 28, 30), share=0.0015) -> np.ndarray:
    """Single voxels far apart: what else there is seldom hides a grazing contact."""
    return (rng.random(shape) < share).astype(np.uint8)


def milled_bone(rng, shape=(40, 38, 36), air=7, radius=6.0, n_balls=10) -> np.ndarray:
    """A rough block below air along the first axis, from which balls have been milled along a random walk."""
    grid = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), axis=-1)
    solid = (grid[..., 0] >= air + rng.integers(0, 3, shape[1:])) & (rng.random(shape) > 0.01)
    at = np.array([air, shape[1] / 2, shape[2] / 2])
    for _ in range(n_balls):
        solid &= ((grid - at) ** 2).sum(axis=-1) >= radius**2
        at = np.clip(at + rng.normal(0, 2.5, 3) + [2.0, 0, 0], radius, np.array(shape) - radius)
    return solid.astype(np.uint8)


def cases(rng) -> list[ShaftCase]:
    """Scattered voxels, milled blocks and a full block, each under shafts of different size."""
    bones = {
        "scattered": (scattered(rng), {"long": LONG, "short": SHORT, "thin": THIN}),
        "milled": (milled_bone(rng), {"long": LONG, "short": SHORT, "thin": THIN}),
        "deep": (milled_bone(rng, radius=4.0, n_balls=16), {"long": LONG, "thin": THIN}),
        "block": (np.ones((9, 11, 10), np.uint8), {"long": LONG, "thin": THIN}),
    }
    sizes = iter((0.4, 0.38, 0.5, 0.3, 0.384, 0.4, 0.38, 0.25, 0.6, 0.4))
    return [
        ShaftCase(f"{bone}, {shaft}", solid, np.full(3, next(sizes)), np.array(cylinders))
        for bone, (solid, shafts) in bones.items()
        for shaft, cylinders in shafts.items()
    ]


# Poses


def units(rng, n) -> np.ndarray:
    v = rng.normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def across(rng, normals) -> np.ndarray:
    """Random unit vectors, each perpendicular to its normal."""
    v = units(rng, len(normals))
    v -= (v * normals).sum(axis=1, keepdims=True) * normals
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def random_poses(case: ShaftCase, rng, n) -> Poses:
    """Anywhere in or near the volume, in any direction; every second one from air, as a burr would be."""
    positions = rng.uniform(-0.2, 1.2, (n, 3)) * case.extent
    air = np.argwhere(case.solid == 0)
    if len(air):
        chosen = air[rng.integers(len(air), size=n // 2)]
        positions[: n // 2] = (chosen + rng.uniform(-0.5, 0.5, (n // 2, 3))) * case.spacing
    return Poses(positions, units(rng, n), np.full(n, "random"))


def pocket_poses(case: ShaftCase, rng, n) -> Poses:
    """From voxel centres of air, towards the outside (against the first axis) within 40 degrees."""
    air = np.argwhere(case.solid == 0)
    if not len(air):
        return random_poses(case, rng, n)
    positions = air[rng.integers(len(air), size=n)] * case.spacing
    tilt, turn = rng.uniform(0, np.deg2rad(40), n), rng.uniform(0, 2 * np.pi, n)
    axes = np.stack([-np.cos(tilt), np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn)], axis=1)
    return Poses(positions, axes, np.full(n, "pocket"))


def aligned_poses(case: ShaftCase, rng, n) -> Poses:
    """Along grid axes and grid planes, exactly or nearly, with a side or cap in the plane of voxel faces."""
    axes = np.zeros((n, 3))
    along = rng.integers(3, size=n)
    rows = np.arange(n)
    axes[rows, along] = rng.choice([-1.0, 1.0], n)
    tilted = rng.random(n) < 0.4
    beside = (along + rng.integers(1, 3, n)) % 3
    axes[rows[tilted], beside[tilted]] = 10.0 ** rng.uniform(-10, -1, tilted.sum())
    diagonal = rng.random(n) < 0.15
    axes[rows[diagonal], beside[diagonal]] = rng.choice([-1.0, 1.0], diagonal.sum())
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    faces = np.stack([rng.integers(0, m + 1, n) for m in case.solid.shape], axis=1) - 0.5
    positions = (faces + 0.5 * rng.integers(0, 2, (n, 3))) * case.spacing  # on faces or centres
    radius, start, end = case.cylinders[rng.integers(len(case.cylinders), size=n)].T
    side = np.where(rng.random(n) < 0.5, radius, 0.0)
    positions[rows, beside] += side * rng.choice([-1, 1], n)
    cap = np.where(rng.random(n) < 0.5, np.where(rng.random(n) < 0.5, start, end), 0.0)
    positions -= cap[:, None] * axes
    positions[rows, beside] += rng.choice(OFFSETS, n) * rng.choice([-1, 1], n)
    return Poses(positions, axes, np.full(n, "aligned"))


def contacts(case: ShaftCase, rng, n, offsets=OFFSETS) -> tuple[Poses, np.ndarray]:
    """Poses that touch a surface voxel's face, edge or corner with a cylinder's side, cap or rim.

    Returns
    -------
    Poses, (n,) array
        The gap in mm by which that cylinder has been moved away from that voxel; negative where it
        has been pushed into it. Other voxels and cylinders may collide whatever the gap.
    """
    voxels = surface_voxels(case.solid)
    voxels = voxels[rng.integers(len(voxels), size=n)]
    outward = rng.choice([-1.0, 1.0], (n, 3))
    # 1, 2 or 3 components of the contact's normal: a face, an edge, a corner
    held = np.argsort(rng.random((n, 3)), axis=1) <= rng.integers(0, 3, n)[:, None]
    normals = np.where(held, outward * rng.uniform(0.05, 1, (n, 3)), 0.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    points = (voxels + np.where(held, outward / 2, rng.uniform(-0.45, 0.45, (n, 3)))) * case.spacing
    feature = rng.integers(5, size=n)[:, None]
    last = len(case.cylinders) - 1  # only its far cap is bare
    chosen = np.where((feature[:, 0] == 2) | (feature[:, 0] == 4), last, rng.integers(last + 1, size=n))
    radius, start, end = case.cylinders[chosen].T[:, :, None]
    covered = np.where(feature == 1, np.r_[0.0, case.cylinders[:, 0]][chosen][:, None], 0.0)
    beside = across(rng, normals)
    inside = covered + (0.98 * radius - covered) * np.sqrt(rng.random((n, 1)))
    lean = rng.uniform(0.05, 1.5, (n, 1))
    rising = np.cos(lean) * normals + np.sin(lean) * beside
    falling = -np.cos(lean) * normals + np.sin(lean) * beside
    axes = np.choose(feature, [beside, normals, -normals, rising, falling])
    nearest = [  # from the contact to the axis' point that the contact is beside
        normals * radius,
        -beside * inside,
        -beside * inside,
        (np.sin(lean) * normals - np.cos(lean) * beside) * radius,
        (np.sin(lean) * normals + np.cos(lean) * beside) * radius,
    ]
    along = [start + (end - start) * rng.random((n, 1)), start, end, start, end]
    positions = points + np.choose(feature, nearest) - np.choose(feature, along) * axes
    gaps = rng.choice(offsets, n) * rng.choice([-1.0, 1.0], n)
    kinds = np.array(["side", "near cap", "far cap", "near rim", "far rim"])[feature[:, 0]]
    return Poses(positions + gaps[:, None] * normals, axes, kinds), gaps


def buried_poses(case: ShaftCase, rng, n) -> Poses:
    """From inside the bone, or pointing into it: poses that no drilled path has."""
    voxels = np.argwhere(case.solid)
    chosen = voxels[rng.integers(len(voxels), size=n)]
    positions = (chosen + rng.uniform(-0.5, 0.5, (n, 3))) * case.spacing
    return Poses(positions, units(rng, n), np.full(n, "buried"))


def grazing_poses(case: ShaftCase, rng, n, offsets=OFFSETS) -> Poses:
    """Free poses moved and tilted until the exact answer turns, then a little back or further.

    Unlike `contacts` these graze whatever comes first, in pockets too. Fewer than `n` where little is free.
    """
    at = Poses.joined([pocket_poses(case, rng, n), random_poses(case, rng, n), buried_poses(case, rng, n)])
    ways, tilts = rng.uniform(0, 4, (len(at), 1)) * units(rng, len(at)), rng.uniform(0, 0.6, (len(at), 1))
    tilts = tilts * across(rng, at.axes)

    def moved(rows, share):
        axes = at.axes[rows] + share[:, None] * tilts[rows]
        axes /= np.linalg.norm(axes, axis=1, keepdims=True)
        return at.positions[rows] + share[:, None] * ways[rows], axes

    rows = np.arange(len(at))
    turns = ~overlaps(case, *moved(rows, np.zeros(len(rows)))) & overlaps(
        case, *moved(rows, np.ones(len(rows)))
    )
    rows = rows[turns][:n]
    free, blocked = np.zeros(len(rows)), np.ones(len(rows))
    for _ in range(36):
        middle = (free + blocked) / 2
        hit = overlaps(case, *moved(rows, middle))
        free, blocked = np.where(hit, free, middle), np.where(hit, middle, blocked)
    steps = (
        rng.choice(offsets, len(rows)) / np.linalg.norm(ways[rows], axis=1) * rng.choice([-1, 1], len(rows))
    )
    return Poses(*moved(rows, free + steps), np.full(len(rows), "grazing"))


def poses(case: ShaftCase, rng, n) -> Poses:
    """About `n` poses of every kind."""
    parts = [contacts(case, rng, n // 3)[0], grazing_poses(case, rng, n // 20)]
    for build in (random_poses, pocket_poses, aligned_poses, buried_poses):
        parts.append(build(case, rng, n // 6))
    return Poses.joined(parts)


# The exact answer


def overlaps(case: ShaftCase, positions, axes, grow: float = 0.0) -> np.ndarray:
    """(n,) bool of the plain exact kernel, for cylinders grown by `grow` mm on all sides."""
    cylinders = case.cylinders + grow * np.array([1.0, -1.0, 1.0])
    cylinders = np.ascontiguousarray(cylinders[(cylinders[:, 0] > 0) & (cylinders[:, 1] < cylinders[:, 2])])
    hit = np.zeros(3, np.int64)
    positions, axes = np.ascontiguousarray(positions), np.ascontiguousarray(axes)
    test = _kernels.drill_overlaps_voxels
    return np.array(
        [test(case.solid, case.spacing, p, a, cylinders, hit) for p, a in zip(positions, axes, strict=True)],
        dtype=bool,
    )


@dataclass(frozen=True, eq=False)
class Disagreements:
    """Where a check differs from the exact answer.

    Attributes
    ----------
    missed, imagined : (m,) int arrays
        Rows called free that overlap, and called blocked that do not.
    missed_clearly, imagined_clearly : (m,) int arrays
        Those of them outside the rounding band: the shaft overlaps even if shrunk by the band's depth,
        or is free even if grown by its gap.
    """

    missed: np.ndarray
    imagined: np.ndarray
    missed_clearly: np.ndarray
    imagined_clearly: np.ndarray


def disagreements(
    case: ShaftCase, at: Poses, free: np.ndarray, blocked: np.ndarray, *, depth: float, gap: float
) -> Disagreements:
    """Compare a check with the exact answer (`overlaps`), within a band in mm on either side of touching."""
    missed, imagined = np.flatnonzero(free & blocked), np.flatnonzero(~free & ~blocked)
    deep = overlaps(case, at.positions[missed], at.axes[missed], -depth)
    wide = ~overlaps(case, at.positions[imagined], at.axes[imagined], gap)
    return Disagreements(missed, imagined, missed[deep], imagined[wide])
