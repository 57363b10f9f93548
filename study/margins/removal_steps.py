"""What pictures of a margin to be removed show, one registration and one step at a time.

Nothing here decides anything: margins come from `study.margins.grow_margin`. The rule by which a point
protrudes is that of `study.margins.protrusion`, written out again without its shortcuts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from study.errors import InputError
from study.margins.margin import SafetyMargin
from study.margins.protrusion import boundary_centres
from study.margins.published import shell_of
from study.margins.region import Region
from study.margins.task import Task
from study.margins.violations import Violations, closed, reach_of_most
from study.registration.sources import ErrorSource, checked_transforms
from study.volumes import LabelVolume


@dataclass(frozen=True, eq=False)
class RemovalStep:
    """One step of the printed growth of a margin to be removed.

    Attributes
    ----------
    number : int
        From 0.
    before : (nx, ny, nz) bool array
        Margin at its start.
    violations : (nx, ny, nz) int array
        Registrations that put the structure's boundary into each voxel outside structure and margin.
    counted : int
        Registrations of which they were counted.
    chosen, enclosed : (nx, ny, nz) bool arrays
        Voxels that enter the margin for their violations, and those that the morphological closing adds.
    risk, transfer_share : float
        Overall damage risk at the start; share of the shell that is to be transferred.
    """

    number: int
    before: np.ndarray
    violations: np.ndarray
    counted: int
    chosen: np.ndarray
    enclosed: np.ndarray
    risk: float
    transfer_share: float

    @property
    def after(self) -> np.ndarray:
        """Margin at the end of the step."""
        return self.before | self.chosen | self.enclosed

    def shell(self, structure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The analyzed shell of chapter 4 at the start of the step, and how often it is overlapped.

        Parameters
        ----------
        structure : (nx, ny, nz) bool array

        Returns
        -------
        (m, 3) int array
            Voxels that are violated, or touch structure and margin.
        (m,) array
            Share of the registrations that overlap each: its point damage risk (4.2.4).
        """
        around = shell_of((structure | self.before).astype(np.uint8))
        voxels = np.argwhere((self.violations > 0) | around)
        return voxels, self.violations[tuple(voxels.T)] / self.counted


def removal_step(margin: SafetyMargin, risk: float, rng: object = None) -> RemovalStep:
    """The step of a printed growth whose overall damage risk was nearest to `risk`.

    The steps are gone through again, with the same registrations.

    Parameters
    ----------
    margin : SafetyMargin
        To remove, spatially varying, grown with ``method="published"``.
    risk : float
    rng : anything `numpy.random.default_rng` takes
        What the margin was grown with.

    Raises
    ------
    InputError
        If the margin has no such steps, or is not what it was grown to with this `rng`.
    """
    history = margin.history
    if margin.purpose != "remove" or history is None or margin.shape != "spatially_varying":
        raise InputError(
            f"{margin.structure}: expected a spatially varying margin to remove, grown in steps; got "
            f"{margin.shape} to {margin.purpose} by method {margin.settings.method!r}"
        )
    if len(history) < 2:
        raise InputError(f"{margin.structure}: expected a margin grown in steps, got one that needed none")
    number = int((history["risk"].iloc[:-1] - risk).abs().to_numpy().argmin())
    settings = margin.settings
    task = Task(
        margin.volume,
        margin.structure_mask,
        margin.model,
        None,
        None,
        margin.acceptable_risk,
        settings.decay_start_of(margin.structure),
        settings,
    )
    growing = np.random.default_rng(rng).spawn(1)[0]
    transforms = task.registrations(growing)
    region = Region.around(task.mask, task.volume, reach_of_most(task, transforms))
    violations = Violations(task, transforms, growing)
    union = region.solid.copy()
    for step in range(number + 1):
        row = history.iloc[step]
        before = union.astype(bool) & ~region.solid.astype(bool)
        wanted = max(settings.least_transfer, int(row["transfer_share"] * row["shell_voxels"]))
        counts, counted = violations.counted(region, union, wanted)
        candidates = np.flatnonzero(counts >= settings.least_violations)
        order = np.lexsort((candidates, -counts.reshape(-1)[candidates]))
        chosen = np.zeros(region.shape, bool)
        chosen.reshape(-1)[candidates[order[:wanted]]] = True
        union[chosen] = 1
        enclosed = closed(union).astype(bool) & (union == 0)
        union[enclosed] = 1
        grown = int(np.count_nonzero(union) - np.count_nonzero(region.solid))
        if grown != history["margin_voxels"].iloc[step + 1]:
            raise InputError(
                f"rng: expected what the margin was grown with; step {step} led to {grown} voxels now, to "
                f"{history['margin_voxels'].iloc[step + 1]} then"
            )
    violations_of = np.zeros(region.whole, np.int32)
    violations_of[region.box] = counts
    return RemovalStep(
        number,
        region.full(before),
        violations_of,
        counted,
        region.full(chosen),
        region.full(enclosed),
        float(row["risk"]),
        float(row["transfer_share"]),
    )


@dataclass(frozen=True, eq=False)
class Protrusion:
    """One simulated registration of a structure that is to be removed with its margin.

    Attributes
    ----------
    transform : (4, 4) array
        Where the patient's points appear in the image, mm.
    centres, appear : (n, 3) arrays
        Centres of the structure's boundary voxels, and where they appear, mm.
    outside : (n,) bool array
        Which appear outside structure and margin.
    hits, registrations : int
        In how many of the registrations drawn any does.
    """

    transform: np.ndarray
    centres: np.ndarray
    appear: np.ndarray
    outside: np.ndarray
    hits: int
    registrations: int


def protruding(
    volume: LabelVolume, union: np.ndarray, centres: np.ndarray, transform: np.ndarray
) -> np.ndarray:
    """(n,) bool array: which of the points (mm) a registration shows outside `union`.

    Parameters
    ----------
    volume : LabelVolume
    union : (nx, ny, nz) bool array
        Structure and margin. What is beyond the volume is outside.
    centres : (n, 3) array
        mm.
    transform : (4, 4) array
        Where the patient's points appear in the image, mm.
    """
    appear = centres @ transform[:3, :3].T + transform[:3, 3]
    index = np.floor(volume.indices(appear) + 0.5).astype(int)
    within = ((index >= 0) & (index < volume.shape)).all(axis=1)
    outside = np.ones(len(centres), bool)
    outside[within] = ~union[tuple(index[within].T)]
    return outside


def typical_protrusion(
    volume: LabelVolume,
    structure: np.ndarray,
    margin: np.ndarray,
    model: ErrorSource,
    registrations: int = 400,
    rng: object = None,
    share: float = 0.5,
) -> Protrusion:
    """Draw registrations and pick one that does damage, by how many points protrude.

    Parameters
    ----------
    volume : LabelVolume
    structure, margin : (nx, ny, nz) bool arrays
    model : ErrorSource
    registrations : int
    rng : anything `numpy.random.default_rng` takes
    share : float
        Of those that do damage, how many have fewer points outside; the median one by default.

    Returns
    -------
    Protrusion
        If the structure protrudes in none: the registration that moves it most.
    """
    transforms = np.linalg.inv(checked_transforms(model, registrations, np.random.default_rng(rng)))
    centres = volume.points(boundary_centres(structure))
    union = structure | margin
    counts = np.array([protruding(volume, union, centres, one).sum() for one in transforms])
    harmful = np.flatnonzero(counts)
    if len(harmful):
        chosen = harmful[np.argsort(counts[harmful], kind="stable")[int(share * len(harmful))]]
    else:
        middle = centres.mean(axis=0)
        moved = transforms[:, :3, :3] @ middle + transforms[:, :3, 3] - middle
        chosen = int(np.argmax(np.linalg.norm(moved, axis=1)))
    one = transforms[chosen]
    appear = centres @ one[:3, :3].T + one[:3, 3]
    outside = protruding(volume, union, centres, one)
    return Protrusion(one, centres, appear, outside, len(harmful), registrations)


def outermost(mask: np.ndarray) -> np.ndarray:
    """Voxels of a mask that have a face outside it: what is seen of it."""
    return mask & ~ndimage.binary_erosion(mask)
