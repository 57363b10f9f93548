"""Findings about Baron (2010): Table 1 and section 6.4 (E6, I19-I22, C5.1-C5.4)."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import optimize, special, stats

from study import published
from study.audit.findings import Check, Finding

LEVEL = 0.999
_DOCUMENT = "baron_2010"


def rows() -> pd.DataFrame:
    """Return Table 1 with readable row names as index."""
    table = published.table("Baron 1")
    table.index = table["system"] + " " + table["side"]
    return table.drop(columns=["system", "side"])


def recomputed_radii() -> pd.DataFrame:
    """Return Table 1 with the factor it used and the regions it should have given, mm.

    Columns: ``factor`` (printed half axis over standard deviation), its bounds before rounding,
    ``mean_length``, ``printed_sum``, ``sum`` (mean plus printed half axis), ``correct_major``
    (two-dimensional quantile), ``correct_sum``, ``prediction_major`` and ``prediction_sum`` (Hotelling's
    region for one more of 24 holes), ``radius_low`` and ``radius_high`` (99.9 % quantile of the length of a
    normal deviation with the printed moments, both signs of the correlation).
    """
    table = rows()
    major, region = table["std_major_axis_mm"], table["confidence_999_major_axis_mm"]
    found = pd.DataFrame(index=table.index)
    found["factor"] = region / major
    found["factor_low"] = (region - 0.0005) / (major + 0.0005)
    found["factor_high"] = (region + 0.0005) / (major - 0.0005)
    found["mean_length"] = np.hypot(table["mean_x_mm"], table["mean_y_mm"])
    found["printed_sum"] = table["mean_plus_confidence_max_mm"]
    found["sum"] = found["mean_length"] + region
    found["correct_major"] = planar_quantile() * major
    found["correct_sum"] = found["mean_length"] + found["correct_major"]
    found["prediction_major"] = prediction_quantile(_holes()) * major
    found["prediction_sum"] = found["mean_length"] + found["prediction_major"]
    radii = []
    for row in table.itertuples():
        mean = np.array([row.mean_x_mm, row.mean_y_mm])
        covariance = np.diag([row.std_x_mm**2, row.std_y_mm**2])
        # the printed axes fix the determinant, so the size of the covariance but not its sign
        rest = covariance[0, 0] * covariance[1, 1] - (row.std_major_axis_mm * row.std_minor_axis_mm) ** 2
        of_both = []
        for sign in (1, -1):
            covariance[0, 1] = covariance[1, 0] = sign * np.sqrt(max(rest, 0.0))
            of_both.append(radial_quantile(mean, covariance))
        radii.append(sorted(of_both))
    found[["radius_low", "radius_high"]] = radii
    return found.rename_axis("experiment")


def planar_quantile(level: float = LEVEL) -> float:
    """Return the half axis, in standard deviations, of the ellipse that holds `level` of a planar normal."""
    return float(np.sqrt(stats.chi2.ppf(level, 2)))


def prediction_quantile(n: int, level: float = LEVEL) -> float:
    """Return the half axis, in sample standard deviations, of Hotelling's region for one observation more."""
    f = stats.f.ppf(level, 2, n - 2)
    return float(np.sqrt(2 * (n - 1) * (n + 1) / (n * (n - 2)) * f))


def radial_quantile(mean: np.ndarray, covariance: np.ndarray, level: float = LEVEL) -> float:
    """Return the radius about the origin that holds `level` of a normal in the plane.

    Parameters
    ----------
    mean : (2,) array
        Mean, mm.
    covariance : (2, 2) array
        Positive definite, mm^2.
    level : float
        Between 0 and 1.

    Returns
    -------
    float
        Radius in mm; the disc is integrated in strips.
    """
    variances, axes = np.linalg.eigh(covariance)
    (m, k), (s, t) = axes.T @ mean, np.sqrt(variances)
    strips = 2000
    # x = r sin(angle) makes the integrand smooth and periodic, so the midpoint rule converges fast
    angle = ((np.arange(strips) + 0.5) / strips - 0.5) * np.pi

    def inside(radius: float) -> float:
        x, height = radius * np.sin(angle), radius * np.cos(angle)
        across = special.ndtr((height - k) / t) - special.ndtr((-height - k) / t)
        density = np.exp(-(((x - m) / s) ** 2) / 2) / (s * np.sqrt(2 * np.pi))
        return float(np.sum(density * across * height) * np.pi / strips)

    reach, spread = float(np.linalg.norm(mean)), float(np.sqrt(variances.max()))
    return float(optimize.brentq(lambda r: inside(r) - level, 0.0, reach + 8 * spread, xtol=1e-9))


def region_uses_one_dimension() -> Finding:
    """E6: the factor of the printed region, and what two dimensions need."""
    table = recomputed_radii()
    z = float(stats.norm.ppf(1 - (1 - LEVEL) / 2))
    consistent = ((table["factor_low"] <= z) & (table["factor_high"] >= z)).sum()
    stated = {
        "hannover top": ("3.289", "0.502", "0.185", "0.687", "0.803"),
        "hannover bottom": ("3.297", "0.513", "0.169", "0.681", "0.800"),
        "vanderbilt top": ("3.268", "0.305", "0.572", "0.877", "0.947"),
        "vanderbilt bottom": ("3.290", "0.461", "0.485", "0.946", "1.052"),
    }
    columns = ("factor", "correct_major", "mean_length", "correct_sum", "prediction_sum")
    words = (
        "factor",
        "right half axis (mm)",
        "length of the mean (mm)",
        "right sum (mm)",
        "prediction sum (mm)",
    )
    checks = [
        Check("quantile of one dimension", "3.2905", z),
        Check("quantile of two dimensions", "3.7169", planar_quantile()),
        Check("quantile of a prediction, n = 24", "4.576", prediction_quantile(_holes())),
        Check("factors that rounding lets be 3.2905", "4", int(consistent)),
        Check("share in the printed ellipse (%)", "99.55", 100 * stats.chi2.cdf(z**2, 2)),
    ]
    for name, texts in stated.items():
        for column, word, text in zip(columns, words, texts, strict=True):
            checks.append(Check(f"{name}: {word}", text, float(table.loc[name, column])))
    return Finding("E6", tuple(checks), table.reset_index())


def latencies() -> Finding:
    """I19: two delays for one tracker."""
    rate, lag = (published.parameter(k, _DOCUMENT).value for k in ("tracker_rate", "tracker_lag"))
    sample, cycles = (
        published.parameter(k, _DOCUMENT).value for k in ("kalman_sample_time", "kalman_latency_cycles")
    )
    checks = (
        Check("two tracker cycles (ms)", "80", 1000 * lag / rate),
        Check("two filter samples (ms)", "40", 1000 * cycles * sample),
    )
    return Finding("I19", checks)


def filter_weights() -> Finding:
    """I20: what the weights of eq. 7 and of the orientation filter do with the newest sample."""
    static, moving = (
        published.parameter(k, _DOCUMENT).value for k in ("lowpass_alpha_static", "lowpass_alpha_moving")
    )
    orientation = published.parameter("slerp_alpha_values", _DOCUMENT).value
    # eq. 7 weights the past with alpha, spherical interpolation the newest sample
    position_new = {"static": 1 - static, "moving": 1 - moving}
    orientation_new = {"static": orientation[0], "moving": orientation[1]}
    checks = (
        Check("position, weight of a new sample at rest", "0.1", position_new["static"]),
        Check(
            "orientation, weight of a new sample at rest if the order is kept",
            "0.9",
            orientation_new["static"],
        ),
        Check(
            "in that order both filter harder at rest",
            "no",
            all(w["static"] < w["moving"] for w in (position_new, orientation_new)),
        ),
    )
    remark = (
        "Consistent only with 0.05 at rest and 0.9 in motion for orientation. "
        "The direction of the weights is read in the text."
    )
    return Finding("I20", checks, remark=remark)


def confidence_levels() -> Finding:
    """I21: two confidence levels."""
    checks = (
        Check("results (%)", "99.9", published.parameter("confidence_level", _DOCUMENT).value),
        Check("discussion (%)", "99", published.parameter("planning_confidence_level", _DOCUMENT).value),
    )
    return Finding("I21", checks, remark="Read in the text.")


def six_trajectories() -> Finding:
    """I22: what six trajectories can show."""
    table = published.table("Baron absolute accuracy").set_index("measure")
    n = int(table["n_trajectories"].iloc[0])
    mean, std = table["mean_mm"], table["std_mm"]
    square = mean**2 + (n - 1) / n * std**2
    target, lateral = table.index
    upper = mean[target] + stats.norm.ppf(LEVEL) * std[target]
    checks = (
        Check("trajectories", "6", n),
        Check("implied axial RMS (mm)", "0.25", float(np.sqrt(square[target] - square[lateral]))),
        Check("mean + 3.09 standard deviations (mm)", "1.39", float(upper)),
        Check("submillimetric in the mean", "yes", bool((mean < 1).all())),
        Check("submillimetric at 99.9 %", "no", bool(upper < 1)),
    )
    return Finding("I22", checks, table.reset_index())


def variances_add_up() -> Finding:
    """C5.1: traces of the covariance, and the printed sums."""
    table, radii = rows(), recomputed_radii()
    squares = {k: table[f"std_{k}_mm"] ** 2 for k in ("x", "y", "major_axis", "minor_axis")}
    gap = abs(squares["x"] + squares["y"] - squares["major_axis"] - squares["minor_axis"])
    slack = 2 * 0.0005 * sum(np.sqrt(s) for s in squares.values())
    checks = (
        Check("rows where the variances add up within rounding", "4", int((gap <= slack).sum())),
        # half axis and sum are both rounded to 0.001 mm
        Check(
            "rows where the sum is mean plus half axis",
            "4",
            int((abs(radii["sum"] - radii["printed_sum"]) <= 0.001).sum()),
        ),
    )
    return Finding("C5.1", checks)


def claims_with_right_quantile() -> Finding:
    """C5.2: submillimetric, and not better than 0.5 mm."""
    table = recomputed_radii()
    limit = published.parameter("claim_not_better_than", _DOCUMENT).value
    above = list(table.index[table["prediction_sum"] > 1])
    checks = (
        Check("sums below 1 mm with the right quantile", "4", int((table["correct_sum"] < 1).sum())),
        Check("sums above 0.5 mm with the right quantile", "4", int((table["correct_sum"] > limit).sum())),
        Check("prediction regions above 1 mm: only Vanderbilt bottom", "yes", above == ["vanderbilt bottom"]),
    )
    return Finding("C5.2", checks)


def sums_are_conservative() -> Finding:
    """C5.3: the printed sums against the true radial quantile."""
    table = recomputed_radii()
    stated = {
        "hannover top": ("0.53", "0.60"),
        "hannover bottom": ("0.55", "0.61"),
        "vanderbilt top": ("0.80", "0.82"),
        "vanderbilt bottom": ("0.84", "0.87"),
    }
    above = table["printed_sum"] > table["radius_high"]
    checks = [Check("printed sums above the radial quantile", "4", int(above.sum()))]
    for name, (low, high) in stated.items():
        checks.append(Check(f"{name}: radius, least (mm)", low, table.loc[name, "radius_low"]))
        checks.append(Check(f"{name}: radius, largest (mm)", high, table.loc[name, "radius_high"]))
    remark = (
        "Integrated here; the radii stated earlier came from a simulation, noisy in its third digit: "
        f"Hannover bottom is {table.loc['hannover bottom', 'radius_high']:.4f} mm."
    )
    return Finding("C5.3", tuple(checks), table.reset_index(), remark)


def systems_compared() -> Finding:
    """C5.4: which system has the smaller mean and which the smaller spread."""
    table = rows()
    length = np.hypot(table["mean_x_mm"], table["mean_y_mm"])
    smaller = (
        length["hannover top":"hannover bottom"].max() < length["vanderbilt top":"vanderbilt bottom"].min()
    )
    exceptions = [
        (side, column)
        for side in ("top", "bottom")
        for column in ("std_x_mm", "std_y_mm", "std_major_axis_mm", "std_minor_axis_mm")
        if table.loc[f"vanderbilt {side}", column] >= table.loc[f"hannover {side}", column]
    ]
    checks = (
        Check("Hannover means are smaller", "yes", bool(smaller)),
        Check("Vanderbilt spreads smaller but for x, bottom", "yes", exceptions == [("bottom", "std_x_mm")]),
    )
    return Finding("C5.4", checks)


def _holes() -> int:
    return int(published.parameter("n_holes", _DOCUMENT).value)
