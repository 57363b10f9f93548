"""Fitting the one feed constant the text does not print to its zigzag planner (table A.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq

from study.errors import InputError
from study.robots.feed import FeedSettings
from study.robots.milling import predict_milling

if TYPE_CHECKING:
    from study.planners import Plan


def fit_feed_constant(
    plans: Sequence[Plan], printed_mean_speed: float = 3.7, feed: FeedSettings | None = None, **options
) -> float:
    """The removal rate at which the mean of the plans' average speeds is the printed one.

    Parameters
    ----------
    plans : sequence of Plan
        Zigzag plans: table A.1 is what the constant is fitted to.
    printed_mean_speed : float
        mm/s (table A.1: mean of the average milling speeds).
    feed : FeedSettings, optional
        For its speed limits.
    **options
        Passed to `predict_milling` (rounding, robot).

    Returns
    -------
    float
        mm^3/s.

    Raises
    ------
    InputError
        If there is no plan, or no removal rate brings the plans to this speed.
    """
    if not plans:
        raise InputError("plans: expected at least one plan, got none")
    feed = FeedSettings() if feed is None else feed
    millings = [predict_milling(plan, feed=feed, **options) for plan in plans]

    def excess(log_rate: float) -> float:
        trial = replace(feed, removal_rate=float(np.exp(log_rate)))
        return float(np.mean([m.with_feed(trial).mean_speed_mm_per_s for m in millings])) - printed_mean_speed

    low, high = np.log(1e-6), np.log(1e6)
    slowest, fastest = excess(low) + printed_mean_speed, excess(high) + printed_mean_speed
    if not slowest < printed_mean_speed < fastest:
        raise InputError(
            f"printed_mean_speed: these plans can average {slowest:.4g} to {fastest:.4g} mm/s, "
            f"got {printed_mean_speed!r}"
        )
    return float(np.exp(brentq(excess, low, high, xtol=1e-10)))
