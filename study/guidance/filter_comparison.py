"""Figure 7 in numbers: one motion as the tracker has it, low-passed and fused; lag, error, noise at rest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.optimize import minimize_scalar

from study.errors import InputError
from study.guidance.filters import low_pass
from study.guidance.fusion import FusionSettings, PoseFusion, lags_of
from study.guidance.reversals import Motion, ReversalRecord, ReversalSettings, record_reversals

RAW, FIRST_ORDER, SECOND_ORDER, FUSED = (
    "optical, held",
    "3 Hz low-pass",
    "3 Hz low-pass, 2nd order",
    "fused",
)


@dataclass(frozen=True, eq=False)
class FilterComparison:
    """One record and what became of it.

    Attributes
    ----------
    record : ReversalRecord
    fusion : FusionSettings
    signals : dict of str to (n,) array
        mm at the record's steps: held optical, low-passed (first and second order), fused.
    """

    record: ReversalRecord
    fusion: FusionSettings
    signals: dict[str, np.ndarray]

    def table(self) -> pd.DataFrame:
        """A row a signal: `signal_quality` of each."""
        rows = {name: signal_quality(values, self.record) for name, values in self.signals.items()}
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("signal").reset_index()


def compare_filters(record: ReversalRecord, fusion: FusionSettings | None = None) -> FilterComparison:
    """Filter a record in the ways of figure 7.

    Parameters
    ----------
    record : ReversalRecord
    fusion : FusionSettings, optional
        Without it the printed filter, told the tracker's true delay and the noise read at rest.

    Raises
    ------
    InputError
        If the filter's step is not the record's.
    """
    settings = told_settings(record) if fusion is None else fusion
    raw, sample_s = record.raw_mm, record.settings.sample_s
    signals = {
        RAW: raw,
        FIRST_ORDER: low_pass(raw, sample_s),
        SECOND_ORDER: low_pass(raw, sample_s, order=2),
        FUSED: fused_mm(record, settings)[0],
    }
    return FilterComparison(record, settings, signals)


def told_settings(record: ReversalRecord) -> FusionSettings:
    """The printed filter, told the tracker's true delay and its noise as read at rest."""
    settings = record.settings
    lags = lags_of(settings.tracker.delay_s, settings.sample_s)
    return FusionSettings(sample_s=settings.sample_s, lags=lags).with_noise(record.noise)


def fused_mm(record: ReversalRecord, settings: FusionSettings) -> tuple[np.ndarray, np.ndarray]:
    """Fuse a record.

    Parameters
    ----------
    record : ReversalRecord
    settings : FusionSettings

    Returns
    -------
    (n,) array
        Fused position along the motion, mm.
    (m,) array
        Normalised innovation squared of the position, 3 degrees of freedom, at each of m fresh samples.

    Raises
    ------
    InputError
        If the filter's step is not the record's.
    """
    if settings.sample_s != record.settings.sample_s:
        raise InputError(
            f"sample_s: expected the record's {record.settings.sample_s:g} s, got {settings.sample_s:g} s"
        )
    poses, nis = PoseFusion(settings, record.tip[0]).run(record.velocity, record.tip, record.fresh)
    return poses[:, 0, 3], nis[:, 0]


def fused_quality(record: ReversalRecord, settings: FusionSettings) -> dict[str, float]:
    """`signal_quality` of the fused position, and how its innovations agree with the noise it was told.

    ``nis_at_rest`` and ``nis_moving`` are means of the normalised innovation squared; of a filter that is
    told the truth they are 3. Below, it expects more noise than there is; above, less.
    """
    values, nis = fused_mm(record, settings)
    return signal_quality(values, record) | {
        "nis_at_rest": float(nis[record.at_rest[record.fresh]].mean()),
        "nis_moving": float(nis[record.moving[record.fresh]].mean()),
    }


def signal_quality(values: np.ndarray, record: ReversalRecord) -> dict[str, float]:
    """Lag and error while the arm moves, noise while it rests.

    Parameters
    ----------
    values : (n,) array
        mm at the record's steps.
    record : ReversalRecord

    Returns
    -------
    dict
        ``lag_ms``: the delay of the true motion that comes nearest to the signal, `lag_of`.
        ``rms_error_mm`` and ``largest_error_mm``: against the truth of the same moment.
        ``noise_at_rest_mm``: standard deviation.
    """
    error = (values - record.truth_mm)[record.moving]
    return {
        "lag_ms": 1e3 * lag_of(record.time_s[record.moving], values[record.moving], record.motion),
        "rms_error_mm": float(np.sqrt(np.mean(error**2))),
        "largest_error_mm": float(np.abs(error).max()),
        "noise_at_rest_mm": float(values[record.at_rest].std(ddof=1)),
    }


def lag_of(time_s: np.ndarray, values: np.ndarray, motion: Motion) -> float:
    """Delay in s by which the true motion fits a signal best, by least squares; negative if it runs ahead.

    Parameters
    ----------
    time_s, values : (n,) array
        The signal, mm.
    motion : Motion
    """

    def misfit(lag: float) -> float:
        return float(np.sum((values - motion.position(time_s - lag)) ** 2))

    # A coarse look first: on a motion that repeats itself there are many minima.
    coarse = np.arange(-0.1, 0.5, 0.01)
    near = coarse[np.argmin([misfit(lag) for lag in coarse])]
    return float(minimize_scalar(misfit, bounds=(near - 0.01, near + 0.01), method="bounded").x)


def over_runs(runs: int, settings: ReversalSettings | None = None, rng: int = 0) -> pd.DataFrame:
    """The comparison again and again with other noise: a row a run and signal.

    Raises
    ------
    InputError
        If there is no run.
    """
    if runs < 1:
        raise InputError(f"runs: expected 1 or more, got {runs!r}")
    seeds = np.random.SeedSequence(rng).spawn(runs)
    tables = [compare_filters(record_reversals(settings, seed)).table() for seed in seeds]
    return pd.concat(tables, keys=range(runs), names=["run", None]).reset_index(level="run")


def over_signals(runs: pd.DataFrame) -> pd.DataFrame:
    """A row a signal: means over runs, and between how far they lie, ``..._sd``."""
    grouped = runs.drop(columns="run").groupby("signal", sort=False)
    spread = grouped.std(ddof=1).add_suffix("_sd")
    both = grouped.mean().join(spread)
    return both[[name for column in grouped.mean() for name in (column, f"{column}_sd")]].reset_index()


def over_speeds(
    speeds_mm_s: Iterable[float], settings: ReversalSettings | None = None, rng: int = 0
) -> pd.DataFrame:
    """The comparison at several speeds; the stroke grows with the speed, so that strokes take as long."""
    settings = ReversalSettings() if settings is None else settings
    tables = []
    for speed in speeds_mm_s:
        share = speed / settings.speed_mm_s
        changed = replace(
            settings,
            speed_mm_s=speed,
            stroke_mm=settings.stroke_mm * share,
            acceleration_mm_s2=settings.acceleration_mm_s2 * share,
        )
        table = compare_filters(record_reversals(changed, rng)).table()
        tables.append(table.assign(speed_mm_s=speed))
    return pd.concat(tables, ignore_index=True)


def over_noise(
    record: ReversalRecord, process_mm: Iterable[float], velocity_mm_s: Iterable[float]
) -> pd.DataFrame:
    """The fused signal for other noise than the default: how far to trust the model, and the encoders.

    Parameters
    ----------
    record : ReversalRecord
    process_mm : iterable of float
        Process noise of the position a step; large values trust the tracker.
    velocity_mm_s : iterable of float
        Noise of the velocity from the encoders; large values leave them out.

    Returns
    -------
    DataFrame
        A row a pair: `fused_quality`; its ``attrs`` hold the tracker's own noise, ``position_mm``.
    """
    told = told_settings(record)
    velocities = list(velocity_mm_s)
    rows = []
    for process in process_mm:
        for velocity in velocities:
            settings = replace(told, process_position_mm=process, velocity_mm_s=velocity)
            quality = fused_quality(record, settings)
            rows.append({"process_position_mm": process, "velocity_mm_s": velocity, **quality})
    table = pd.DataFrame(rows)
    table.attrs["position_mm"] = told.position_mm[0]
    return table


def over_delays(
    delays_s: Iterable[float],
    believed_s: Iterable[float],
    settings: ReversalSettings | None = None,
    rng: int = 0,
) -> pd.DataFrame:
    """The fused signal when the tracker's delay is another than the filter believes."""
    settings = ReversalSettings() if settings is None else settings
    believed = list(believed_s)
    rows = []
    for delay in delays_s:
        record = record_reversals(replace(settings, tracker=replace(settings.tracker, delay_s=delay)), rng)
        for belief in believed:
            lags = lags_of(belief, settings.sample_s)
            fusion = FusionSettings(settings.sample_s, lags).with_noise(record.noise)
            rows.append(
                {"true_delay_ms": 1e3 * delay, "believed_delay_ms": 1e3 * belief}
                | _beside_raw(record, fusion)
            )
    return pd.DataFrame(rows)


def over_phases(
    phases_s: Iterable[float], settings: ReversalSettings | None = None, rng: int = 0
) -> pd.DataFrame:
    """The fused signal when frames arrive between two steps of the filter, and wait for the next one."""
    settings = ReversalSettings() if settings is None else settings
    rows = []
    for phase in phases_s:
        record = record_reversals(replace(settings, tracker_phase_s=phase), rng)
        # Rounded first: what arrives on the dot does not wait.
        waiting = -round(phase + settings.tracker.delay_s, 9) % settings.sample_s
        waiting = 0.0 if np.isclose(waiting, settings.sample_s) else waiting
        rows.append(
            {"phase_ms": 1e3 * phase, "waiting_ms": 1e3 * waiting}
            | _beside_raw(record, told_settings(record))
        )
    return pd.DataFrame(rows)


def _beside_raw(record: ReversalRecord, settings: FusionSettings) -> dict[str, float]:
    fused, raw = fused_quality(record, settings), signal_quality(record.raw_mm, record)
    return fused | {"error_over_raw_ratio": fused["rms_error_mm"] / raw["rms_error_mm"]}
