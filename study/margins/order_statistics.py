"""How many simulated registrations may do damage so that the true risk is acceptable (Wilks 1941)."""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from study.errors import InputError
from study.margins.settings import checked_share


def least_registrations(acceptable_risk: float, confidence: float) -> int:
    """Fewest registrations from which a risk can be called acceptable at all: when none does damage.

    Raises
    ------
    InputError
        If the risk or the confidence is not between 0 and 1.
    """
    checked_share("acceptable_risk", acceptable_risk)
    checked_share("confidence", confidence)
    return math.ceil(math.log1p(-confidence) / math.log1p(-acceptable_risk))


def allowed_hits(registrations: int, acceptable_risk: float, confidence: float | None) -> int:
    """How many of the registrations that a margin is chosen on may still do damage.

    When m of N registrations need a larger margin than the chosen one, which is what the next one needs, the
    true risk has the distribution Beta(m + 1, N - m), whatever the structure and the error. Where several
    registrations need the very same margin it is smaller still.

    Parameters
    ----------
    registrations : int
        N.
    acceptable_risk : float
    confidence : float or None
        Probability of ``true risk <= acceptable_risk``; None for the plain quantile, ``m <= N * risk``.

    Returns
    -------
    int
        The largest such m.

    Raises
    ------
    InputError
        If N is too small for the confidence; the message names the least N. If a share is not between 0 and
        1.
    """
    checked_share("acceptable_risk", acceptable_risk)
    if registrations < 1:
        raise InputError(f"registrations: expected at least 1, got {registrations}")
    if confidence is None:
        return min(math.floor(registrations * acceptable_risk * (1 + 1e-12)), registrations - 1)
    least = least_registrations(acceptable_risk, confidence)
    if registrations < least:
        raise InputError(
            f"registrations: expected at least {least} for an acceptable risk of {acceptable_risk} with "
            f"confidence {confidence}, got {registrations}"
        )
    hits = np.arange(math.floor(registrations * acceptable_risk) + 2)
    hits = hits[hits < registrations]
    sure = stats.beta.cdf(acceptable_risk, hits + 1, registrations - hits) >= confidence
    return int(hits[sure].max(initial=0))


def smallest_margin(needs: np.ndarray, allowed: int) -> int:
    """Voxels of the smallest margin that is too small for at most so many registrations.

    Parameters
    ----------
    needs : (n,) int array
        Voxels that each registration needs.
    allowed : int
        Below n.
    """
    place = len(needs) - 1 - allowed
    return int(np.partition(needs, place)[place])
