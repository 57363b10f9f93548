"""What section 5.3 says of figure 7, and the goals set for the fusion, held against virtual runs."""

from __future__ import annotations

import pandas as pd

from study.guidance.filter_comparison import FIRST_ORDER, FUSED, RAW
from study.tables import Claim, with_unit

#: Goals of the project for the fused signal: lag, and RMS error as a share of the held optical signal's.
MOST_LAG_MS = 15.0
MOST_OF_RAW = 1.0 / 3.0


def fusion_claims(runs: pd.DataFrame) -> list[Claim]:
    """Goals, and the text's sentences on figure 7.

    Parameters
    ----------
    runs : DataFrame
        Of `study.guidance.filter_comparison.over_runs`.
    """
    by = runs.pivot_table(index="run", columns="signal")
    lag, error, noise = by["lag_ms"], by["rms_error_mm"], by["noise_at_rest_mm"]
    share = error[FUSED] / error[RAW]
    many = f"of {len(by)} runs"

    def both(values: pd.DataFrame, unit: str, digits: int = 2) -> str:
        return ", ".join(
            f"{name} {with_unit(values[name].mean(), unit, digits)}" for name in (RAW, FIRST_ORDER, FUSED)
        )

    return [
        Claim(
            f"goal: the fused signal lags at most {MOST_LAG_MS:g} ms",
            lag[FUSED].abs().max() <= MOST_LAG_MS,
            f"most {many}: {with_unit(lag[FUSED].abs().max(), 'ms', 2)}",
            "measured",
        ),
        Claim(
            "goal: it has at most a third of the held optical signal's RMS error",
            share.max() <= MOST_OF_RAW,
            f"most {many}: {with_unit(share.max(), '', 2)}",
            "measured",
        ),
        Claim(
            "the low-pass adds lag, the fusion takes lag away",
            ((lag[FIRST_ORDER] > lag[RAW]) & (lag[FUSED] < lag[RAW])).all(),
            both(lag, "ms"),
            "measured",
        ),
        Claim(
            "the fusion is quieter at rest than the tracker",
            (noise[FUSED] < noise[RAW]).all(),
            both(noise, "mm"),
            "measured",
        ),
        Claim(
            "the fusion is as quiet at rest as the low-pass (the text: similarly smooth)",
            noise[FUSED].mean() <= noise[FIRST_ORDER].mean(),
            both(noise, "mm"),
            "measured",
        ),
    ]


def dependence_claims(
    runs: pd.DataFrame, noise: pd.DataFrame, delays: pd.DataFrame, waiting: pd.DataFrame
) -> list[Claim]:
    """What becomes of the goals when the filter is told something else, or something wrong.

    Parameters
    ----------
    runs, noise, delays, waiting : DataFrame
        Of `over_runs`, `over_noise`, `over_delays` and `over_phases`.
    """
    means = runs.groupby("signal")[["rms_error_mm", "noise_at_rest_mm"]].mean()
    quiet = noise[noise["noise_at_rest_mm"] <= means.loc[FIRST_ORDER, "noise_at_rest_mm"]]
    found = quiet["rms_error_mm"].min() / means.loc[RAW, "rms_error_mm"] if len(quiet) else float("inf")
    told = noise.loc[(noise["nis_moving"] - 3.0).abs().idxmin()]
    unknown = delays[delays["true_delay_ms"] > delays["believed_delay_ms"]]
    gone = (unknown["lag_ms"] - (unknown["true_delay_ms"] - unknown["believed_delay_ms"])).abs()
    worst = waiting.loc[waiting["lag_ms"].abs().idxmax()]
    return [
        Claim(
            "told less process noise, the fusion is as quiet as the low-pass and meets the goal for errors",
            found <= MOST_OF_RAW,
            f"of those as quiet, the best has {with_unit(found, '', 2)} of the held signal's error",
            "measured",
        ),
        Claim(
            "innovations are consistent while moving with less noise of the model than of the tracker",
            told["process_position_mm"] < noise.attrs["position_mm"],
            f"NIS {with_unit(told['nis_moving'], '', 2)}, nearest 3, at {told['process_position_mm']:g} mm "
            f"a step, encoders {told['velocity_mm_s']:g} mm/s; tracker {noise.attrs['position_mm']:.2g} mm",
            "measured",
        ),
        Claim(
            "a delay that the filter does not know of becomes lag, millisecond for millisecond",
            gone.max() <= 5.0,
            f"the lag is within {with_unit(gone.max(), 'ms', 2)} of what it is not told",
            "measured",
        ),
        Claim(
            "both goals are met however the tracker's frames fall between the filter's steps",
            (waiting["lag_ms"].abs() <= MOST_LAG_MS).all()
            and (waiting["error_over_raw_ratio"] <= MOST_OF_RAW).all(),
            f"frames that wait {worst['waiting_ms']:g} ms: lag {with_unit(worst['lag_ms'], 'ms', 3)}, "
            f"{with_unit(worst['error_over_raw_ratio'], '', 2)} of the error",
            "measured",
        ),
    ]
