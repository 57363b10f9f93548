"""Fitting the one feed constant the text does not print to its zigzag planner (table A.1)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.optimize import brentq

from study.errors import InputError
from study.robots.feed import FeedSettings
from study.robots.milling import Motion


def fit_feed_constant(
    motions: Iterable[Motion], printed_mean_speed: float = 3.7, feed: FeedSettings | None = None
) -> float:
    """The removal rate at which the mean of the plans' average speeds is the printed one.

    Parameters
    ----------
    motions : iterable of Motion
        ``predict_milling(plan).motion`` of the zigzag plans: table A.1 is what the constant is
        fitted to, the 3-D planner's speed stays a prediction.
    printed_mean_speed : float
        mm/s (table A.1: mean of the average milling speeds).
    feed : FeedSettings, optional
        For its speed limits.

    Returns
    -------
    float
        mm^3/s.

    Raises
    ------
    InputError
        If there is no motion, or no removal rate brings the plans to this speed.
    """
    motions = list(motions)
    if not motions:
        raise InputError("motions: expected at least one milling, got none")
    feed = FeedSettings() if feed is None else feed

    def mean_speed(log_rate: float) -> float:
        trial = replace(feed, removal_rate=float(np.exp(log_rate)))
        return float(np.mean([motion.mean_speed(trial) for motion in motions]))

    low, high = np.log(1e-6), np.log(1e6)
    slowest, fastest = mean_speed(low), mean_speed(high)
    if not slowest < printed_mean_speed < fastest:
        raise InputError(
            f"printed_mean_speed: these plans can average {slowest:.4g} to {fastest:.4g} mm/s, "
            f"got {printed_mean_speed!r}"
        )
    return float(np.exp(brentq(lambda rate: mean_speed(rate) - printed_mean_speed, low, high, xtol=1e-10)))
