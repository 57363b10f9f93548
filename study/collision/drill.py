"""The surgical drill: a spherical burr at the end of three coaxial cylinders (Siebold, figure 2.6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import InputError


@dataclass(frozen=True)
class Drill:
    """Burr and shaft of a surgical drill.

    Parameters
    ----------
    burr_diameter : float
        mm (2.4.1: 5 mm).
    shaft_diameters : (3,) floats
        mm of shaft, chuck and barrel (2.4.1: 2.4, 6.8 and 11.6 mm).
    shaft_ends : (3,) floats
        mm along the axis from the burr's centre at which shaft, chuck and barrel end. The text
        prints no lengths; 20, 35 and 110 mm are taken (the shaft starts where it leaves the burr).

    Raises
    ------
    InputError
        If a length is not positive and finite, the shaft is wider than the burr, or ends do not grow.
    """

    burr_diameter: float = 5.0
    shaft_diameters: tuple[float, float, float] = (2.4, 6.8, 11.6)
    shaft_ends: tuple[float, float, float] = (20.0, 35.0, 110.0)

    def __post_init__(self) -> None:
        values = np.array([self.burr_diameter, *self.shaft_diameters, *self.shaft_ends], dtype=float)
        if values.size != 7 or not np.isfinite(values).all() or (values <= 0).any():
            raise InputError(
                "Drill: expected a burr diameter, three shaft diameters and three shaft ends, positive mm; "
                f"got {self.burr_diameter}, {self.shaft_diameters}, {self.shaft_ends}"
            )
        if self.shaft_diameters[0] >= self.burr_diameter:
            raise InputError(
                "Drill: the shaft must be thinner than the burr it carries; "
                f"got shaft {self.shaft_diameters[0]} mm, burr {self.burr_diameter} mm"
            )
        if list(self.shaft_diameters) != sorted(self.shaft_diameters):
            raise InputError(
                f"Drill: expected shaft diameters growing away from the burr, got {self.shaft_diameters}"
            )
        if not self.burr_radius < self.shaft_ends[0] < self.shaft_ends[1] < self.shaft_ends[2]:
            raise InputError(
                "Drill: expected shaft ends beyond the burr and increasing, "
                f"got {self.shaft_ends} mm for a burr of radius {self.burr_radius} mm"
            )

    @property
    def burr_radius(self) -> float:
        """Mm."""
        return self.burr_diameter / 2

    @property
    def cylinders(self) -> tuple[tuple[float, float, float], ...]:
        """``((radius, start, end), ...)`` mm along the axis from the burr's centre towards the drill body.

        The first cylinder starts inside the ball, where its rim meets the ball's surface.
        """
        radii = [diameter / 2 for diameter in self.shaft_diameters]
        first = float(np.sqrt(self.burr_radius**2 - radii[0] ** 2))
        starts = (first, *self.shaft_ends[:-1])
        return tuple(zip(radii, starts, self.shaft_ends, strict=True))
