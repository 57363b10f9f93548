"""A few printed numbers against many virtual experiments: bands, and how unusual the print is among them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.guidance import GuidedSystem, system

#: Of a prediction band.
LEVEL = 0.95
#: A few newtons: the text suspects a force on the tip in Vanderbilt's calibration and does not say how large.
SUSPECTED_FORCE_N = 3.0


@dataclass(frozen=True)
class Condition:
    """What is taken for the causes of a system.

    Attributes
    ----------
    name, title : str
        Short, and in words.
    system : GuidedSystem
    drawn : bool
        Whether each experiment draws what is not known, `GuidedSystem.drawn`.
    """

    name: str
    title: str
    system: GuidedSystem
    drawn: bool = False


def conditions(name: str, force_n: float = SUSPECTED_FORCE_N) -> tuple[Condition, ...]:
    """What a system is run with: stated causes, drawn ones, and the calibration that the text suspects.

    Parameters
    ----------
    name : str
        One of `study.guidance.SYSTEMS`.
    force_n : float
        On the tip while it is calibrated; the text suspects some in Vanderbilt only.
    """
    base = system(name)
    found = [
        Condition("stated", "causes as stated", base),
        Condition("drawn", "causes drawn from their ranges", base, drawn=True),
    ]
    if name == "vanderbilt":
        pressed = base.but(calibration_force_n=float(force_n))
        found.append(Condition("force", f"as stated, {force_n:g} N in calibration", pressed))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Printed numbers among simulated ones.

    Attributes
    ----------
    low, high : (m,) arrays
        Ends of the prediction bands.
    coverage : float
        Chance that one experiment more has a given number inside of its band.
    inside : (m,) array of bool
        Whether the printed numbers are.
    all_inside : float
        Share of simulated experiments with every number inside; numbers of one experiment go together.
    as_unusual : float
        Chance of at least as many numbers outside, if the print were one of the experiments.
    """

    low: np.ndarray
    high: np.ndarray
    coverage: float
    inside: np.ndarray
    all_inside: float
    as_unusual: float


def prediction_band(values: ArrayLike, level: float = LEVEL) -> tuple[np.ndarray, np.ndarray, float]:
    """Where one experiment more is expected, whatever the distribution is.

    The k-th value from below and from above, with k as large as the level allows: exact for experiments that
    are alike and independent. Fewer than 39 experiments cannot bound 95 %: then least and largest are taken.

    Parameters
    ----------
    values : (n, ...) array
        Of n experiments, two or more.
    level : float
        Between 0 and 1.

    Returns
    -------
    low, high : (...) arrays
    coverage : float
        ``(n + 1 - 2 k) / (n + 1)``.

    Raises
    ------
    InputError
        If there are fewer than two experiments, a value is not finite, or the level is out of range.
    """
    values = np.asarray(values, dtype=float)
    if values.ndim < 1 or len(values) < 2 or not np.isfinite(values).all():
        raise InputError(f"values: expected finite numbers of two experiments or more, got {values.shape}")
    if not 0 < level < 1:
        raise InputError(f"level: expected a number between 0 and 1, got {level!r}")
    n, k = len(values), _rank(len(values), level)
    ordered = np.sort(values, axis=0)
    return ordered[k - 1], ordered[n - k], (n + 1 - 2 * k) / (n + 1)


def compare(printed: ArrayLike, simulated: ArrayLike, level: float = LEVEL) -> Comparison:
    """Lay printed numbers into the bands of simulated ones.

    That the print has numbers outside says little by itself: of a right model's, about 5 in 100 are. So
    the print is counted as one of the experiments, and all of them are judged alike.

    Parameters
    ----------
    printed : (m,) array
    simulated : (n, m) array
    level : float

    Raises
    ------
    InputError
        If the shapes do not fit or a number is not finite.
    """
    printed, simulated = np.asarray(printed, dtype=float), np.asarray(simulated, dtype=float)
    if printed.ndim != 1 or simulated.shape[1:] != printed.shape or not np.isfinite(printed).all():
        raise InputError(
            f"expected printed (m,) and simulated (n, m), got {printed.shape} and {simulated.shape}"
        )
    low, high, coverage = prediction_band(simulated, level)
    inside = (printed >= low) & (printed <= high)
    n, k = len(simulated), _rank(len(simulated), level)
    everyone = np.vstack([simulated, printed])
    place = np.argsort(np.argsort(everyone, axis=0, kind="stable"), axis=0)  # 0 to n
    outside = ((place < k) | (place > n - k)).sum(axis=1)
    return Comparison(
        low,
        high,
        coverage,
        inside,
        float((outside[:-1] == 0).mean()),
        float((outside >= outside[-1]).mean()),
    )


def _rank(n: int, level: float) -> int:
    return max(1, int((1.0 - level) / 2.0 * (n + 1) + 1e-9))
