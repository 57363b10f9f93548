"""One system in many variants, drilled with the same seeds so that they are compared on the same luck.

Where a variant draws more or fewer numbers (more touches, another speed) its luck is only partly the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from scipy import stats

from study.audit.baron import radial_quantile
from study.errors import GuidanceError, InputError
from study.guidance import (
    GuidedSystem,
    LoopSettings,
    Phantom,
    absolute_experiment,
    aluminium_block,
    drill_holes,
    set_up,
)
from study.guidance.repeated import repeated

#: Parts of the experiments that are left out in turn for standard errors.
_GROUPS = 20

#: Experiments below which a radius means nothing.
_LEAST = 3


@dataclass(frozen=True)
class Variant:
    """A change of a system or of what it drills.

    Attributes
    ----------
    name : str
    changes : dict
        Causes and their values.
    phantom : Phantom, optional
        Instead of the usual block.
    """

    name: str
    changes: dict[str, float] = field(default_factory=dict)
    phantom: Phantom | None = None


@dataclass(frozen=True, eq=False)
class Runs:
    """Errors of each variant.

    Attributes
    ----------
    variants : tuple of Variant
    values : (n, v, ...) array
        NaN where a variant's robot stopped by itself.
    """

    variants: tuple[Variant, ...]
    values: np.ndarray

    def of(self, index: int) -> np.ndarray:
        """(k, ...) errors of a variant in the experiments that ended well."""
        values = self.values[:, index]
        return values[~np.isnan(values).reshape(len(values), -1).any(axis=1)]

    def aborted(self, index: int) -> int:
        """Experiments of a variant that were given up."""
        return len(self.values) - len(self.of(index))


def lateral_runs(
    system: GuidedSystem,
    variants: Sequence[Variant],
    experiments: int,
    seed: int = 0,
    drawn: bool = False,
    holes: int = 2,
) -> Runs:
    """Errors of a few holes of each aluminium block in x and y at the target: values (n, v, holes, 2), mm.

    Which holes is drawn anew for each experiment. Changes of a variant hold even where causes are drawn.
    """
    work = partial(_lateral, variants=tuple(variants), holes=holes)
    return Runs(tuple(variants), repeated(work, system, experiments, seed, drawn=drawn).values)


def absolute_runs(system: GuidedSystem, variants: Sequence[Variant], experiments: int, seed: int = 0) -> Runs:
    """Distances of each acrylic block: values (n, v, 2, 6), of targets and of axes, mm."""
    work = partial(_absolute, variants=tuple(variants))
    return Runs(tuple(variants), repeated(work, system, experiments, seed).values)


def _lateral(
    system: GuidedSystem,
    rng: np.random.Generator,
    settings: LoopSettings | None,
    variants: tuple[Variant, ...],
    holes: int,
) -> np.ndarray:
    entropy = int(rng.integers(2**62))
    block = aluminium_block()
    chosen = np.random.default_rng([entropy, 1]).choice(len(block.entries), holes, replace=False)
    found = np.full((len(variants), holes, 2), np.nan)
    for k, variant in enumerate(variants):
        own = np.random.default_rng(entropy)
        try:
            ready = set_up(system.but(**variant.changes), variant.phantom or block, own)
            drilled = drill_holes(ready, own, settings, holes=chosen)
        except GuidanceError:
            continue  # stays NaN, which `Runs` counts
        found[k] = [hole.error_at(hole.length)[:2] for hole in drilled]
    return found


def _absolute(
    system: GuidedSystem,
    rng: np.random.Generator,
    settings: LoopSettings | None,
    variants: tuple[Variant, ...],
) -> np.ndarray:
    entropy = int(rng.integers(2**62))
    found = np.full((len(variants), 2, 6), np.nan)
    for k, variant in enumerate(variants):
        try:
            result = absolute_experiment(system.but(**variant.changes), entropy, settings, variant.phantom)
        except GuidanceError:
            continue
        found[k] = result.target_distance, result.axis_distance
    return found


def radius_999(errors: np.ndarray) -> float:
    """Radius that holds 99.9 % of lateral errors, mm: of a planar normal with their mean and covariance.

    Holes of all experiments are pooled, so that what an experiment's holes share counts as scatter, as it
    does for a patient who is drilled once. With causes at fixed values the pool is close to normal.

    Parameters
    ----------
    errors : (n, holes, 2) array
        Of three experiments or more, mm.
    """
    errors = np.asarray(errors, dtype=float)
    if errors.ndim != 3 or errors.shape[2] != 2 or len(errors) < _LEAST:
        raise InputError(f"errors: expected (3 or more, holes, 2), got {errors.shape}")
    pool = errors.reshape(-1, 2)
    return radial_quantile(pool.mean(axis=0), np.cov(pool.T))


def rms(errors: np.ndarray) -> float:
    """Root mean square of the errors' lengths, mm."""
    return float(np.sqrt((errors**2).sum(axis=-1).mean()))


def jackknife(statistic, *samples: np.ndarray, confidence: float = 0.95) -> tuple[float, float]:
    """A statistic of experiments and the half width of its interval, leaving out groups of experiments.

    Parameters
    ----------
    statistic : callable
        Of the samples.
    *samples : (n, ...) arrays
        Experiments along the first axis, those of one row left out together. Fewer than four tell no
        interval, fewer than three nothing: not a number then.
    """
    n = len(samples[0])
    if n < _LEAST + 1:
        return float(statistic(*samples)) if n == _LEAST else np.nan, np.nan
    groups = min(_GROUPS, n)
    part = np.arange(n) % groups
    left = np.array([statistic(*(s[part != g] for s in samples)) for g in range(groups)])
    error = np.sqrt((groups - 1) / groups * ((left - left.mean()) ** 2).sum())
    return float(statistic(*samples)), float(stats.t.ppf(0.5 + confidence / 2, groups - 1) * error)


def upper_bound(events: int, n: int, confidence: float = 0.95) -> float:
    """One-sided Clopper-Pearson upper bound of a probability."""
    return 1.0 if events >= n else float(stats.beta.ppf(confidence, events + 1, n - events))
