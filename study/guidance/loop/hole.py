"""One drilled hole: what the loop logged, and what is left in the material."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import GuidanceError
from study.guidance.safety import Status


@dataclass(frozen=True, eq=False)
class DrilledHole:
    """One hole: the log of the loop, and what was left in the material.

    Attributes
    ----------
    entry, direction : (3,) arrays
        Of the planned line, image frame, mm.
    length, beyond : float
        From entry to target, and how far the tip was to go on, mm.
    time_s : (n,) array
    tip : (n, 3) array
        True tip of a bit that does not bend, image frame, mm.
    axis : (n, 3) array
        From the drill's body to the tip.
    bent : (n, 3) array
        By how much the bit's tip is bent, mm.
    depth : (n,) array
        Desired tip beyond the entry, mm.
    seen_across : (n,) array
        Distance from the line that the robot believes, mm.
    status : (n,) array of int
        See `Status`.
    phase : (n,) array of int
        0 finds the line, 1 inserts, 2 stays, 3 comes back.
    nis : (n,) array
        Normalised innovation squared of the fused position, 3 on average when the noise that it is told is
        right; -1 where no picture came.
    """

    entry: np.ndarray
    direction: np.ndarray
    length: float
    beyond: float
    time_s: np.ndarray
    tip: np.ndarray
    axis: np.ndarray
    bent: np.ndarray
    depth: np.ndarray
    seen_across: np.ndarray
    status: np.ndarray
    phase: np.ndarray
    nis: np.ndarray

    @property
    def end(self) -> Status:
        """How it ended, as far as it is."""
        return Status(int(self.status[-1])) if len(self.status) else Status.RUNNING

    @property
    def along(self) -> np.ndarray:
        """(n,) true tip beyond the entry, mm."""
        return (self.tip - self.entry) @ self.direction

    @property
    def across(self) -> np.ndarray:
        """(n,) true distance of the tip, bent as it is, from the planned line, mm."""
        off = self.tip + self.bent - self.entry
        return np.linalg.norm(off - (off @ self.direction)[:, None] * self.direction, axis=1)

    def centre(self, depth: float, burr_mm: float = 8.0) -> np.ndarray:
        """(3,) centre of the hole in the plane across the planned line at a depth, image frame, mm.

        The mean over the time in which the cutting part of the burr went through the plane on its way in.

        Parameters
        ----------
        depth : float
            Beyond the entry, mm.
        burr_mm : float
            Length of the cutting part.

        Raises
        ------
        GuidanceError
            If the drill did not come that deep.
        """
        past = self.along - depth
        rows = (self.phase <= 2) & (past >= 0) & (past <= burr_mm)
        if not rows.any():
            raise GuidanceError(
                f"centre: the drill did not reach {depth:.3g} mm; it ended as {self.end.name}"
            )
        share = past[rows] / (self.axis[rows] @ self.direction)
        middle = self.tip[rows] + self.bent[rows] - share[:, None] * self.axis[rows]
        return middle.mean(axis=0)

    def error_at(self, depth: float) -> np.ndarray:
        """(3,) centre of the hole minus the planned line at a depth, image frame, mm."""
        return self.centre(depth) - (self.entry + depth * self.direction)

    @property
    def bottom(self) -> np.ndarray:
        """(3,) where the tip stayed at the end of the hole, image frame, mm.

        Raises
        ------
        GuidanceError
            If it did not come to the end.
        """
        rows = self.phase == 2
        if not rows.any():
            raise GuidanceError(f"bottom: the drill did not reach the end; it ended as {self.end.name}")
        return (self.tip[rows] + self.bent[rows]).mean(axis=0)
