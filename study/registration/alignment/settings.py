"""How densely the search for an alignment is sown."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real

from study.errors import InputError


@dataclass(frozen=True)
class AlignmentSettings:
    """How densely the search for an alignment is sown.

    Lengths are shares of the swab's size, the root mean square distance of its points from their mean: a
    fit finds back from about a constant share of it. Measured on kidneys, at least 96 of 100 fits from 0.45
    of the size and 20 degrees away end at the truth. The defaults leave no pose further than the site's
    spacing and half an angle step, and most poses have several hypotheses as near as that.

    Parameters
    ----------
    site_spacing : float
        No vertex is further from the nearest place that the swab's mean is tried at, share of the size.
    angle_step_deg : float
        Between turns of the swab about the surface's normal, degrees; a full turn is cut into an even
        number of steps of at most this.
    coarse_points : int
        Points of the swab in the first, cheapest round; twice as many in each later one.
    finalists : int
        Poses that are fitted with the whole swab.
    distinct : float
        Poses further apart than this (root mean square over the swab, share of the size) are different
        answers; nearer ones count as one.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    site_spacing: float = 0.4
    angle_step_deg: float = 30.0
    coarse_points: int = 40
    finalists: int = 12
    distinct: float = 0.3

    def __post_init__(self) -> None:
        for name, low, high in (
            ("site_spacing", 0.05, 2.0),
            ("angle_step_deg", 1.0, 180.0),
            ("distinct", 0.01, 2.0),
        ):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Real) or not low <= value <= high:
                raise InputError(f"{name}: expected a number from {low} to {high}, got {value!r}")
        for name, least in (("coarse_points", 10), ("finalists", 2)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
                raise InputError(f"{name}: expected a whole number of at least {least}, got {value!r}")
