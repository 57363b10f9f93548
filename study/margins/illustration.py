"""What pictures of a margin show, one registration and one step at a time, in plain Python.

Nothing here decides anything: margins come from `study.margins.grow_margin`. The rule by which a corner hits
is that of `study.margins.overall_risk`, written out again without its shortcuts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from study.errors import InputError
from study.margins.exact import in_order
from study.margins.margin import SafetyMargin
from study.margins.point_risk import all_distances, point_damage_risk
from study.margins.published import shell_of
from study.margins.region import Region
from study.registration.sources import ErrorSource, displacement_moments
from study.volumes import LabelVolume


def shell_corners(volume: LabelVolume, union: np.ndarray) -> np.ndarray:
    """Lattice corners between structure with margin and the shell around it.

    Parameters
    ----------
    volume : LabelVolume
    union : (nx, ny, nz) bool array
        Structure and margin. Voxels beyond the volume do not exist.

    Returns
    -------
    (n, 3) array
        mm.
    """
    low, box = _box(union, 1)
    inside, outside = np.pad(union[box], 1), np.pad(~union[box], 1)
    shape = tuple(n - 1 for n in inside.shape)
    touched = [np.zeros(shape, bool), np.zeros(shape, bool)]
    for step in product((0, 1), repeat=3):
        part = tuple(slice(a, a + n) for a, n in zip(step, shape, strict=True))
        touched[0] |= inside[part]
        touched[1] |= outside[part]
    return volume.points(np.argwhere(touched[0] & touched[1]) + low - 0.5)


def hit_corners(
    volume: LabelVolume, structure: np.ndarray, corners: np.ndarray, transform: np.ndarray
) -> np.ndarray:
    """Which corners a registration carries into the structure.

    Parameters
    ----------
    volume : LabelVolume
    structure : (nx, ny, nz) bool array
    corners : (n, 3) array
        mm.
    transform : (4, 4) array
        Where an image point lands instead of itself, mm.

    Returns
    -------
    (n,) bool array
    """
    landed = corners @ transform[:3, :3].T + transform[:3, 3]
    index = np.floor(volume.indices(landed) + 0.5).astype(int)
    within = ((index >= 0) & (index < volume.shape)).all(axis=1)
    hit = np.zeros(len(corners), bool)
    hit[within] = structure[tuple(index[within].T)]
    return hit


@dataclass(frozen=True, eq=False)
class Landing:
    """One simulated registration, chosen among several.

    Attributes
    ----------
    transform : (4, 4) array
        mm.
    corners, landed : (n, 3) arrays
        Corners of the shell as planned and where the registration puts them, mm.
    hit : (n,) bool array
        Landed in the structure.
    hits, registrations : int
        How many of the registrations drawn did damage.
    """

    transform: np.ndarray
    corners: np.ndarray
    landed: np.ndarray
    hit: np.ndarray
    hits: int
    registrations: int


def typical_damage(
    volume: LabelVolume,
    structure: np.ndarray,
    margin: np.ndarray,
    model: ErrorSource,
    registrations: int = 400,
    rng: object = None,
) -> Landing:
    """Draw registrations and pick the one with the median count of hits among those that do damage.

    Parameters
    ----------
    volume : LabelVolume
    structure, margin : (nx, ny, nz) bool arrays
    model : ErrorSource
    registrations : int
    rng : anything `numpy.random.default_rng` takes

    Returns
    -------
    Landing
        If none does damage: the one that moves the corners most.
    """
    transforms = model.sample(registrations, np.random.default_rng(rng))
    corners = shell_corners(volume, structure | margin)
    counts = np.array([hit_corners(volume, structure, corners, t).sum() for t in transforms])
    harmful = np.flatnonzero(counts)
    if len(harmful):
        chosen = harmful[np.argsort(counts[harmful], kind="stable")[len(harmful) // 2]]
    else:
        moved = corners.mean(axis=0) @ np.swapaxes(transforms[:, :3, :3], 1, 2) + transforms[:, :3, 3]
        chosen = int(np.argmax(np.linalg.norm(moved - corners.mean(axis=0), axis=1)))
    transform = transforms[chosen]
    landed = corners @ transform[:3, :3].T + transform[:3, 3]
    hit = hit_corners(volume, structure, corners, transform)
    return Landing(transform, corners, landed, hit, len(harmful), registrations)


@dataclass(frozen=True, eq=False)
class GrowthStep:
    """One step of the published growth.

    Attributes
    ----------
    number : int
        From 0.
    before : (nx, ny, nz) bool array
        Margin at its start.
    shell, chosen, next_shell : (nx, ny, nz) bool arrays
        Analyzed shell; the voxels of it that enter the margin; the shell afterwards.
    risk, transfer_share : float
        Overall damage risk at the start; share of the shell that is transferred.
    """

    number: int
    before: np.ndarray
    shell: np.ndarray
    chosen: np.ndarray
    next_shell: np.ndarray
    risk: float
    transfer_share: float

    @property
    def after(self) -> np.ndarray:
        """Margin at the end of the step."""
        return self.before | self.chosen


def growth_step(margin: SafetyMargin, risk: float) -> GrowthStep:
    """The step of a published growth whose overall damage risk was nearest to `risk`.

    The steps are gone through again from the recorded numbers of voxels: which voxels a step takes depends on
    the distances alone, how many on the simulations.

    Parameters
    ----------
    margin : SafetyMargin
        Spatially varying, grown with ``method="published"``.
    risk : float

    Raises
    ------
    InputError
        If the margin has no recorded steps or none that transferred voxels.
    """
    if margin.history is None or len(margin.history) < 2 or margin.shape != "spatially_varying":
        raise InputError(
            f"{margin.structure}: expected a spatially varying margin grown in steps, got "
            f"{margin.shape} by method {margin.settings.method!r}"
        )
    history = margin.history
    number = int((history["risk"].iloc[:-1] - risk).abs().to_numpy().argmin())
    sizes = history["margin_voxels"].to_numpy()
    region = _region(margin, margin.structure_mask | margin.mask)
    moments = displacement_moments(margin.model)
    solid = region.solid.copy()
    distances = np.full(region.shape, np.nan)
    known = 0.0
    for step in range(number + 1):
        shell = shell_of(solid)
        fresh = np.argwhere(shell & np.isnan(distances))
        distances[tuple(fresh.T)] = all_distances(region, fresh, moments, known)
        flat = np.flatnonzero(shell)
        order = in_order(distances.reshape(-1)[flat], flat)
        chosen = np.zeros(region.shape, bool)
        chosen.reshape(-1)[flat[order[: sizes[step + 1] - sizes[step]]]] = True
        known = float(distances[chosen].max())
        before = solid.astype(bool) & ~region.solid.astype(bool)
        solid[chosen] = 1
    return GrowthStep(
        number,
        region.full(before),
        region.full(shell),
        region.full(chosen),
        region.full(shell_of(solid)),
        float(history["risk"].iloc[number]),
        float(history["transfer_share"].iloc[number]),
    )


def analyzed_shell(margin: SafetyMargin) -> tuple[np.ndarray, np.ndarray]:
    """The analyzed shell around structure and margin: (n, 3) voxels, and their (n,) point damage risks."""
    region = _region(margin, margin.structure_mask | margin.mask)
    union = region.part(margin.structure_mask | margin.mask).view(np.uint8)
    voxels = np.argwhere(shell_of(union))
    distances = all_distances(region, voxels, displacement_moments(margin.model), 0.0)
    return voxels + region.low, point_damage_risk(distances)


@dataclass(frozen=True, eq=False)
class NearestPoints:
    """A voxel for which the point of the structure nearest in mm is not the one nearest in deviations.

    Attributes
    ----------
    voxel : (3,) array
        Its centre, mm.
    covariance : (3, 3) array
        Of the registration error there, mm^2.
    euclidean, mahalanobis : (3,) arrays
        The nearest surface points in either sense, mm.
    """

    voxel: np.ndarray
    covariance: np.ndarray
    euclidean: np.ndarray
    mahalanobis: np.ndarray

    def millimetres(self, point: np.ndarray) -> float:
        """Distance from the voxel's centre, mm."""
        return float(np.linalg.norm(point - self.voxel))

    def deviations(self, point: np.ndarray) -> float:
        """Distance from the voxel's centre, standard deviations."""
        step = point - self.voxel
        return float(np.sqrt(step @ np.linalg.solve(self.covariance, step)))


def telling_voxel(margin: SafetyMargin) -> NearestPoints:
    """The voxel of the final shell for which the two nearest points of the structure differ most.

    The structure's surface points are the corners between it and what surrounds it, as in 3.2.3.
    """
    volume = margin.volume
    surface = shell_corners(volume, margin.structure_mask)
    voxels = volume.points(margin.final_shell)
    moments = displacement_moments(margin.model)
    # The covariance hardly changes along a structure: for choosing a voxel that of the middle will do.
    middle = moments.at(surface.mean(axis=0)[None])[0]
    whiten = np.linalg.inv(np.linalg.cholesky(middle)).T
    _, near = cKDTree(surface).query(voxels)
    smallest, _ = cKDTree(surface @ whiten).query(voxels @ whiten)
    naive = np.linalg.norm((surface[near] - voxels) @ whiten, axis=1)
    voxel = voxels[int(np.argmax(naive / smallest))]
    covariance = moments.at(voxel[None])[0]
    steps = surface - voxel
    squared = np.einsum("ni,ni->n", steps, np.linalg.solve(covariance, steps.T).T)
    return NearestPoints(
        voxel,
        covariance,
        surface[int(np.argmin(np.linalg.norm(steps, axis=1)))],
        surface[int(np.argmin(squared))],
    )


def _region(margin: SafetyMargin, union: np.ndarray) -> Region:
    """The structure in a box that holds `union` and its shell."""
    box = Region.around(union, margin.volume, 0.0)
    return replace(box, solid=box.part(margin.structure_mask).view(np.uint8))


def _box(mask: np.ndarray, width: int) -> tuple[np.ndarray, tuple[slice, ...]]:
    found = np.argwhere(mask)
    low = np.maximum(found.min(axis=0) - width, 0)
    high = np.minimum(found.max(axis=0) + 1 + width, mask.shape)
    return low, tuple(slice(a, b) for a, b in zip(low, high, strict=True))
