"""What both methods are given and what both find."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from study.margins.overall_risk import RiskEstimate
from study.margins.settings import GrowthSettings
from study.registration.moments import DisplacementMoments
from study.registration.sources import ErrorSource, checked_transforms
from study.volumes import LabelVolume


@dataclass(frozen=True, eq=False)
class Task:
    """A structure to grow a margin around.

    Attributes
    ----------
    volume : LabelVolume
    mask : (nx, ny, nz) bool array
        The structure.
    model : ErrorSource
    moments : DisplacementMoments or None
        Of the model, to protect.
    metric : DisplacementMoments or None
        By which voxels are ranked to protect: `moments`, or such that distances are mm.
    acceptable_risk, decay_start : float
    settings : GrowthSettings
    shape, purpose : str
    """

    volume: LabelVolume
    mask: np.ndarray
    model: ErrorSource
    moments: DisplacementMoments | None
    metric: DisplacementMoments | None
    acceptable_risk: float
    decay_start: float
    settings: GrowthSettings
    shape: str = "spatially_varying"
    purpose: str = "protect"

    def registrations(self, rng: np.random.Generator) -> np.ndarray:
        """(n, 4, 4) simulated registrations to grow on."""
        return checked_transforms(self.model, self.settings.registrations, rng)

    def ranking_registrations(self, rng: np.random.Generator) -> np.ndarray:
        """(n, 4, 4) simulated registrations to rank voxels by."""
        return checked_transforms(self.model, self.settings.violation_registrations, rng)

    def fresh_registrations(self, rng: np.random.Generator) -> np.ndarray:
        """(n, 4, 4) simulated registrations for validation, possibly none."""
        count = self.settings.validation_registrations
        return checked_transforms(self.model, count, rng) if count else np.empty((0, 4, 4))


@dataclass(frozen=True, eq=False)
class Grown:
    """A margin and how it was found; the attributes are those of `SafetyMargin`.

    Volume and structure where the margin needed room beyond the volume that was given, or simply those.
    """

    mask: np.ndarray
    estimate: RiskEstimate
    validation: RiskEstimate | None
    distance: float
    history: pd.DataFrame | None = None
    choice: object = None
    volume: LabelVolume | None = None
    structure_mask: np.ndarray | None = None
