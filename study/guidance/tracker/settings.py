"""What an optical tracker is made of, as numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import InputError


@dataclass(frozen=True)
class TrackerSettings:
    """An optical tracker, by the causes of its errors.

    A spec sheet's volumetric accuracy, such as the 0.25 mm r.m.s. printed for one of the two (section 3.2),
    is an error of *spheres* over the whole volume. As white noise it would shake a tip 180 mm away from a
    marker of 80 mm by some 0.4 mm in every frame. It is two causes here: a distortion of the measuring
    volume that changes slowly from place to place and stays the same from frame to frame, so that
    neighbouring markers share it and differences between near places cancel it; and jitter of each sphere
    and frame. The pose of a marker follows from its spheres: more of them, or farther apart, err less.

    Attributes
    ----------
    cycle_s : float
        Between frames; printed: 25 Hz (section 3.2). Trackers of the kind have 0.017 to 0.1.
    delay_s : float
        From exposure to delivery. Printed as two working cycles (3.2) and about 40 ms (5.3); 0.02 to 0.08.
    jitter_mm : (3,) tuple
        Standard deviation of one sphere in one frame along the camera's axes; z is the viewing depth.
        Plausible: 0.01 to 0.12 across, 1.5 to 5 times as much in depth.
    distortion_mm : float
        Root of the mean squared 3-D length of the distortion, over places and trackers. Plausible: 0.05 to
        0.4; with the jitter above, 0.23 makes a spec sheet's 0.25.
    distortion_length_mm : float
        Over which the distortion changes: its correlation is ``exp(-r^2 / (2 length^2))``. Plausible: 150
        to 600, a fraction of the measuring volume.
    quantum_mm : float
        To which positions are rounded; 0 for none. Trackers report two digits, 0.01.
    waves : int
        Of which the distortion is made.

    Raises
    ------
    InputError
        If a number is not finite, negative, or zero where that has no meaning.
    """

    cycle_s: float = 0.04
    delay_s: float = 0.04
    jitter_mm: tuple[float, float, float] = (0.03, 0.03, 0.09)
    distortion_mm: float = 0.2
    distortion_length_mm: float = 300.0
    quantum_mm: float = 0.01
    waves: int = 64

    def __post_init__(self) -> None:
        jitter = np.array(self.jitter_mm, dtype=float)
        if jitter.shape != (3,) or not np.isfinite(jitter).all() or (jitter < 0).any():
            raise InputError(f"jitter_mm: expected three numbers of at least 0, got {self.jitter_mm!r}")
        object.__setattr__(self, "jitter_mm", tuple(float(j) for j in jitter))
        for name in ("delay_s", "distortion_mm", "quantum_mm"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0:
                raise InputError(f"{name}: expected a finite number of at least 0, got {value!r}")
        for name in ("cycle_s", "distortion_length_mm"):
            value = getattr(self, name)
            if not np.isfinite(value) or value <= 0:
                raise InputError(f"{name}: expected a finite number above 0, got {value!r}")
        if isinstance(self.waves, bool) or int(self.waves) != self.waves or self.waves < 1:
            raise InputError(f"waves: expected a whole number of at least 1, got {self.waves!r}")

    @property
    def sphere_rms_mm(self) -> float:
        """Root mean squared 3-D error of one sphere in one frame, which a spec sheet would print."""
        return float(np.sqrt(self.distortion_mm**2 + np.square(self.jitter_mm).sum()))
