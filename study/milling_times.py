"""Milling time against target volume: the fitted lines of Siebold's figures 2.20 and 2.21."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike
from scipy import stats

from study.errors import InputError
from study.tables import Interval

#: Colour and name of each strategy wherever both are drawn.
COLOURS = {"zigzag": "#c05a1c", "3d": "#1c6fb0"}
NAMES = {"zigzag": "zigzag", "3d": "3-D"}


@dataclass(frozen=True)
class FittedLine:
    """A least-squares line through milling times over volumes.

    Attributes
    ----------
    slope : Interval
        s/cm^3, with its t interval of n - 2 degrees of freedom.
    intercept_s : float
        Seconds at no volume.
    scatter_s : float
        Residual standard deviation, s.
    """

    slope: Interval
    intercept_s: float
    scatter_s: float

    def __call__(self, volumes_cm3: ArrayLike) -> np.ndarray:
        """Seconds on the line at (k,) volumes in cm^3."""
        return self.intercept_s + self.slope.mean * np.asarray(volumes_cm3, dtype=float)


def fitted_line(volumes_cm3: ArrayLike, times_s: ArrayLike, confidence: float = 0.95) -> FittedLine:
    """Fit milling times by a line over target volumes.

    Parameters
    ----------
    volumes_cm3, times_s : (n,) array_like
        At least three pairs.
    confidence : float
        Of the slope's interval.

    Returns
    -------
    FittedLine

    Raises
    ------
    InputError
        If the lengths differ, there are fewer than three pairs, or all volumes are the same.
    """
    x, y = np.asarray(volumes_cm3, dtype=float), np.asarray(times_s, dtype=float)
    if x.ndim != 1 or x.shape != y.shape or x.size < 3 or not np.isfinite([x, y]).all():
        raise InputError(
            f"a line needs three finite pairs or more, got volumes {x.shape} and times {y.shape}"
        )
    if np.ptp(x) == 0:
        raise InputError(f"a line needs different volumes, got {x[0]:g} cm^3 {x.size} times")
    fit = stats.linregress(x, y)
    half_width = float(stats.t.ppf((1 + confidence) / 2, x.size - 2) * fit.stderr)
    residuals = y - fit.intercept - fit.slope * x
    scatter = float(np.sqrt((residuals**2).sum() / (x.size - 2)))
    return FittedLine(
        Interval(float(fit.slope), half_width, x.size, confidence), float(fit.intercept), scatter
    )


def draw_milling_times(
    axes: Axes, series: Mapping[str, tuple[ArrayLike, ArrayLike]]
) -> dict[str, FittedLine]:
    """Draw milling time over volume, one strategy a colour, with fitted lines.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
        Drawn into.
    series : mapping of strategy to (volumes, times)
        Keys ``"zigzag"`` or ``"3d"``; cm^3 and s.

    Returns
    -------
    dict of str to FittedLine
        The line of each strategy.
    """
    lines = {}
    for strategy, (volumes, times) in series.items():
        lines[strategy] = line = fitted_line(volumes, times)
        ends = np.array([np.min(volumes), np.max(volumes)])
        label = f"{NAMES[strategy]}: {line.slope.mean:.0f} ± {line.slope.half_width:.0f} s/cm³"
        axes.plot(ends, line(ends), color=COLOURS[strategy], linewidth=1.5, label=label)
        axes.scatter(volumes, times, s=18, color=COLOURS[strategy], linewidths=0, alpha=0.8)
    axes.set_xlabel("modified initial target (cm³)")
    axes.set_ylabel("milling time (s)")
    axes.legend(frameon=False, loc="upper left")
    axes.spines[["top", "right"]].set_visible(False)
    return lines
