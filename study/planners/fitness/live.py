"""Terms of the fitness that follow the milling: cutting force and incidence angle (Siebold, 2.5.3)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from study.errors import InputError

#: Density is kept in thousandths, in 16 bits.
MOST_DENSITY = 65.0


def _check_weight(term: CuttingForce | IncidenceAngle) -> None:
    if not np.isfinite(term.weight):
        raise InputError(f"{term.name}: expected a finite weight, got {term.weight!r}")


@dataclass(frozen=True, eq=False)
class CuttingForce:
    """Prefer candidates that need little force: little bone to cut there, and soft.

    The score is 1 less the bone that the burr would still meet at the candidate, every voxel weighed by
    its density, over half of the burr's own voxels: 1 is no bone, 0 half a burr of bone of density 1 (a
    burr that moves on rarely meets more) or less of denser bone. It is not divided by the length of
    the step: that made plans longer and their cuts no lighter.

    Parameters
    ----------
    weight : float
        Relative to the printed 1, 1, 10, 5, 1.
    density : (nx, ny, nz) array, optional
        Of the bone on the volume's grid, relative to 1, at least 0 and at most 65; kept in thousandths. All
        target counts 1 without it. From a CT: `study.robots.relative_density`. Where only labels are
        known, 0 in air cells that belong to the target, which the printed count takes for bone.
        It need not be true to the bone: larger values near a structure ask for lighter cuts there.

    Raises
    ------
    InputError
        If the weight is not finite, or the density has another number of axes or values outside its range.
    """

    weight: float
    density: np.ndarray | None = None
    name: ClassVar[str] = "cutting force"

    def __post_init__(self) -> None:
        _check_weight(self)
        if self.density is None:
            return
        density = np.asarray(self.density)
        if density.ndim != 3 or not np.isfinite(density).all():
            raise InputError(f"density: expected a finite (nx, ny, nz) array, got shape {density.shape}")
        if density.size and not (density.min() >= 0 and density.max() <= MOST_DENSITY):
            raise InputError(
                f"density: expected from 0 to {MOST_DENSITY:g} relative to 1 (study.robots.relative_density "
                f"makes it from HU), got {density.min():g} to {density.max():g}"
            )


@dataclass(frozen=True)
class IncidenceAngle:
    """Prefer candidates where the burr cuts with its equator: a spherical burr cuts badly at its pole.

    The score is the sine of the angle between the shaft, as it points now, and the direction from the
    burr's centre at the candidate to the middle of the bone it would still meet there: 1 with the
    equator (and where no bone is met), 0 with the pole. The exact 5-DOF planner may then turn the shaft
    for the same reason (`PlannerSettings.least_incidence_gain`).

    Parameters
    ----------
    weight : float
        Relative to the printed 1, 1, 10, 5, 1.
    by_bone : bool
        Times the share of half of the burr's voxels that is bone, and 0 where none is met. The plain
        sine only avoids bad cuts, and what is avoided has to be cut in the end; this seeks good ones, and the
        heavier they are the better, so it costs force.

    Raises
    ------
    InputError
        If the weight is not finite.
    """

    weight: float
    by_bone: bool = False
    name: ClassVar[str] = "incidence angle"

    def __post_init__(self) -> None:
        _check_weight(self)
