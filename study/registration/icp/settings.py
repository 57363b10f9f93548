"""When the iterative closest point fit stops."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.errors import InputError

#: How the next transform follows from the matches.
STEPS = ("closed_form", "gauss_newton")


@dataclass(frozen=True)
class IcpSettings:
    """When the iterative closest point fit stops; the text (Section 4.2.2) prints none of it.

    Both tolerances have to be met by the same step. The matches of a fit are vertices, so a step is either
    zero or moves at least one match from a vertex to the next, some hundredths of a millimetre over the
    number of points: the default tolerances are below that and run a fit into an exact fixed point.

    Parameters
    ----------
    max_iterations : int
        Fits at most, each followed by a search for the nearest vertices. A fit that is stopped by it is
        not converged, and says so.
    translation_tolerance : float
        Below which the last step of the swab's centroid counts as none, mm.
    rotation_tolerance : float
        Below which the angle of the last step counts as none, rad.
    step : str
        "closed_form": the best transform for the matches (Horn). "gauss_newton": the best one to first
        order in the rotation, as libraries that optimise it have. Both end in the same fixed points, but
        not always in the same one from the same start.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    max_iterations: int = 500
    translation_tolerance: float = 1e-5
    rotation_tolerance: float = 1e-7
    step: str = STEPS[0]

    def __post_init__(self) -> None:
        count = self.max_iterations
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
            raise InputError(f"max_iterations: expected a whole number of at least 1, got {count!r}")
        for name, unit in (("translation_tolerance", "mm"), ("rotation_tolerance", "rad")):
            value = getattr(self, name)
            if (
                isinstance(value, bool)
                or not isinstance(value, int | float | np.number)
                or not 0 <= value < np.inf
            ):
                raise InputError(f"{name}: expected a finite number of at least 0 {unit}, got {value!r}")

        if self.step not in STEPS:
            raise InputError(f"step: expected one of {', '.join(STEPS)}, got {self.step!r}")

    @classmethod
    def published(cls) -> IcpSettings:
        """Return the loose stopping that margins of the printed size come from.

        The text does not say when its fits stop. These are the defaults that the point cloud registration
        of the time's MATLAB toolbox had, as far as we remember them (20 iterations, 0.01 mm, 0.009 rad);
        they are neither printed in the text nor looked up.
        """
        return cls(max_iterations=20, translation_tolerance=0.01, rotation_tolerance=0.009)
