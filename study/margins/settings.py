"""How a margin is grown, and what the printed example takes (Siebold, 3.3.1)."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from study.errors import InputError

METHODS = ("exact", "published")
SHAPES = ("spatially_varying", "constant_thickness")
#: What a margin is for: tissue that must be spared, tissue that must be removed, a rim to stay inside of.
PURPOSES = ("protect", "remove", "stay_inside")

#: Overall damage risk that the surgeon accepts for a tumour that is to be removed (Siebold, 4.3.1).
REMOVAL_RISK = 0.01

#: Overall damage risk that the surgeon accepts for each structure.
ACCEPTABLE_RISKS = {
    "facial_nerve": 0.001,
    "chorda_tympani": 0.05,
    "internal_auditory_canal": 0.01,
    "sigmoid_sinus": 0.01,
    "external_auditory_canal": 0.05,
}

#: Overall damage risk below which the transfer percentage decays.
DECAY_STARTS = {
    "facial_nerve": 0.3,
    "chorda_tympani": 0.4,
    "internal_auditory_canal": 0.5,
    "sigmoid_sinus": 1.0,
    "external_auditory_canal": 0.5,
}
_DECAY_START = 0.5


@dataclass(frozen=True)
class GrowthSettings:
    """Settings of `grow_margin`.

    Parameters
    ----------
    method : {"exact", "published"}
        "exact": every registration is asked for the smallest margin that makes it harmless, and the margin is
        an order statistic of the answers. "published": the printed loop, which grows by a percentage of the
        analyzed shell until the share of damaging ones among fresh registrations is acceptable.
    registrations : int
        Simulated registrations, N_r (3.3.1); with "published", in every step.
    confidence : float or None
        "exact" only: probability with which the true risk shall be acceptable (Wilks). None takes the
        plain quantile, whose true risk is above the tolerance about as often as not.
    validation_registrations : int
        Registrations never used before on which the margin's risk is estimated; 0 for no validation.
    initial_transfer : float
        "published" only, as the rest: share of the analyzed shell that a step transfers at first (3.3.1).
    decay_start : float or None
        Overall damage risk below which that share decays, linearly to 0 at the acceptable risk
        (figure 3.8). None takes the printed one of the structure, 0.5 for others.
    least_transfer : int
        Voxels that a step transfers at least.
    most_steps : int
        Steps after which growth counts as stalled.
    violation_registrations : int
        To remove and to stay inside only, as the rest: registrations of which violations are counted at a
        time, N_p (4.3.1). With "exact" a set of its own that ranks the voxels; with "published" the first
        are those on which growth stops, as printed.
    violation_ratio : float
        "published" only, as the rest: R_s, not printed. As long as there are no more violated voxels than
        this times the voxels to be transferred, violations of N_p more registrations are counted (4.2.4).
        More of it ranks the voxels better and takes longer.
    least_violations : int
        T_r, not printed: voxels that fewer registrations violate never enter the margin (4.2.4). More of it
        keeps single gross misregistrations out and may stall growth above the acceptable risk.
    most_batches : int
        How often N_p registrations are counted in a step at most.

    Raises
    ------
    InputError
        If a value cannot be.
    """

    method: str = "exact"
    registrations: int = 25_000
    confidence: float | None = 0.95
    validation_registrations: int = 25_000
    initial_transfer: float = 0.20
    decay_start: float | None = None
    least_transfer: int = 1
    most_steps: int = 5_000
    violation_registrations: int = 5_000
    violation_ratio: float = 1.0
    least_violations: int = 1
    most_batches: int = 10

    @classmethod
    def for_removal(cls, method: str = "exact", **changes: object) -> GrowthSettings:
        """What chapter 4 prints (4.3.1): 5000 registrations; of the shell half, and 150 voxels at least.

        Parameters
        ----------
        method : {"exact", "published"}
        **changes
            Settings that shall be others.
        """
        printed = {
            "registrations": 5_000,
            "validation_registrations": 5_000,
            "initial_transfer": 0.5,
            "decay_start": 0.1,
            "least_transfer": 150,
        }
        return cls(**{"method": method, **printed, **changes})

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"method: expected one of {METHODS}, got {self.method!r}")
        for name, least in (
            ("registrations", 1),
            ("validation_registrations", 0),
            ("least_transfer", 1),
            ("most_steps", 1),
            ("violation_registrations", 1),
            ("least_violations", 1),
            ("most_batches", 1),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
                raise InputError(f"{name}: expected a whole number of at least {least}, got {value!r}")
            object.__setattr__(self, name, int(value))
        if not isinstance(self.violation_ratio, Real) or not 0 < self.violation_ratio < np.inf:
            raise InputError(f"violation_ratio: expected a number above 0, got {self.violation_ratio!r}")
        if self.confidence is not None:
            checked_share("confidence", self.confidence)
        for name in ("initial_transfer", "decay_start"):
            value = getattr(self, name)
            if value is None and name == "decay_start":
                continue
            if not isinstance(value, Real) or not 0 < value <= 1:
                raise InputError(f"{name}: expected a number in (0, 1], got {value!r}")

    def decay_start_of(self, structure: str) -> float:
        """Overall damage risk below which the transfer percentage decays for a structure."""
        return self.decay_start or DECAY_STARTS.get(structure, _DECAY_START)


def checked_share(name: str, value: float) -> float:
    """A number strictly between 0 and 1.

    Raises
    ------
    InputError
        If it is not.
    """
    if not (isinstance(value, Real) and 0 < value < 1):
        raise InputError(f"{name}: expected a number between 0 and 1, both excluded, got {value!r}")
    return float(value)
