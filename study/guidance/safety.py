"""When the guided robot stops by itself, and what it calls the reason (Baron, sections 3.1 and 3.2).

The text stops on lost line of sight and on a missed handshake. Other reasons are ours: a tracker that
repeats itself, samples that the fusion does not believe, a patient who jumps, and a tip that is seen off
its line while it is in the bone. After any of them the robot goes on only when it is told to.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from study.errors import InputError

# Plain numbers for the compiled loop, which knows no enumerations.
RUNNING = 0
DONE = 1
LINE_OF_SIGHT = 2
HANDSHAKE = 3
FROZEN = 4
OUTLIERS = 5
PATIENT_MOVED = 6
OFF_LINE = 7


class Status(IntEnum):
    """State of a guided robot; all above ``DONE`` are stops."""

    RUNNING = RUNNING
    DONE = DONE
    LINE_OF_SIGHT = LINE_OF_SIGHT
    HANDSHAKE = HANDSHAKE
    FROZEN = FROZEN
    OUTLIERS = OUTLIERS
    PATIENT_MOVED = PATIENT_MOVED
    OFF_LINE = OFF_LINE

    @property
    def stopped(self) -> bool:
        """Whether the robot stands and waits for a command."""
        return self > DONE


@dataclass(frozen=True)
class SafetySettings:
    """Limits beyond which the robot stops.

    Attributes
    ----------
    frozen_samples : int
        As many samples in a row that repeat the one before; 0 never stops for it, for a noiseless simulation.
    missing_samples : int
        More than as many samples in a row that do not arrive.
    outlying_samples : int
        As many samples in a row that the fusion's gate refuses.
    patient_jump_mm : float
        Of the patient's marker from its filtered place between two samples, while the tip is in the bone; at
        least ``patient_jump_stds`` times the measured noise.
    patient_jump_stds : float
    off_line_mm : float
        Estimated distance of the tip from its line, while it is in the bone.

    Raises
    ------
    InputError
        If a number of samples is not whole or a limit not positive.
    """

    frozen_samples: int = 2
    missing_samples: int = 1
    outlying_samples: int = 3
    patient_jump_mm: float = 1.0
    patient_jump_stds: float = 8.0
    off_line_mm: float = 1.0

    def __post_init__(self) -> None:
        for name, least in (("frozen_samples", 0), ("missing_samples", 0), ("outlying_samples", 1)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
                raise InputError(f"{name}: expected a whole number of at least {least}, got {value!r}")
        for name in ("patient_jump_mm", "patient_jump_stds", "off_line_mm"):
            value = getattr(self, name)
            if not value > 0:
                raise InputError(f"{name}: expected more than 0, got {value!r}")
