"""Exponents of margins and scatter: against references, and on the printed tables as the audit has them."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize, stats

from study.errors import InputError
from study.experiments.kidney_claims import printed_rows
from study.experiments.kidney_scaling import ERRORS, exponents_table, fit_power_law, never_falls


def grid(law, tumours=(1, 2, 3), positions=(5.0, 3.33, 2.5), rotations=(5.0, 3.33, 2.5)):
    """Rows of all combinations; `law(tumour, position, rotation)` is the volume."""
    found = [(t, p, r, law(t, p, r)) for t in tumours for p in positions for r in rotations]
    return pd.DataFrame(found, columns=["tumour", *ERRORS, "volume"])


def noisy(seed, **of_grid):
    rng = np.random.default_rng(seed)
    return grid(lambda t, p, r: 100 * t * p**0.8 * r**0.1 * np.exp(0.2 * rng.standard_normal()), **of_grid)


@settings(max_examples=25)
@given(st.floats(-2, 2), st.floats(-2, 2), st.lists(st.floats(0.1, 1e5), min_size=3, max_size=3))
def test_a_power_law_is_found_whatever_the_tumours_levels(a, b, levels):
    law = fit_power_law(grid(lambda t, p, r: levels[t - 1] * p**a * r**b), "volume")
    assert law.exponents["pos_std_mm"].mean == pytest.approx(a, abs=1e-9)
    assert law.exponents["rot_std_deg"].mean == pytest.approx(b, abs=1e-9)
    assert law.difference.mean == pytest.approx(a - b, abs=1e-9)
    assert list(law.levels.values()) == pytest.approx(levels, rel=1e-7)
    assert law.exponents["pos_std_mm"].half_width == pytest.approx(0, abs=1e-6)


def test_fit_and_interval_are_those_of_a_plain_minimisation():
    """Reference: a general minimiser for the exponents, its curvature's inverse for the variances."""
    rows = noisy(3)

    def loss(x):
        log = x[0] * np.log(rows["pos_std_mm"]) + x[1] * np.log(rows["rot_std_deg"])
        return np.sum((np.log(rows["volume"]) - log - x[1 + rows["tumour"].to_numpy()]) ** 2)

    least = optimize.minimize(loss, np.zeros(5), method="BFGS", options={"gtol": 1e-10})
    law = fit_power_law(rows, "volume")
    freedom = len(rows) - 5
    # the loss is quadratic: half its second differences are exact
    step = np.eye(5) * 1e-2
    curvature = np.array(
        [
            [loss(least.x + a + b) - loss(least.x + a) - loss(least.x + b) + least.fun for b in step]
            for a in step
        ]
    )
    covariance = np.linalg.inv(curvature / (2 * 1e-4)) * least.fun / freedom
    t = stats.t.ppf(0.975, freedom)
    for k, name in enumerate(ERRORS):
        assert law.exponents[name].mean == pytest.approx(least.x[k], abs=1e-5)
        assert law.exponents[name].half_width == pytest.approx(t * np.sqrt(covariance[k, k]), rel=1e-4)
    variance = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
    assert law.difference.half_width == pytest.approx(t * np.sqrt(variance), rel=1e-4)
    assert list(law.levels.values()) == pytest.approx(np.exp(least.x[2:]), rel=1e-4)


def test_intervals_hold_the_truth_as_often_as_they_say():
    """200 noisy grids: of 95 % intervals between 90 and 99.6 % hold it, three binomial SDs either way."""
    held = [0.8 in fit_power_law(noisy(seed), "volume").exponents["pos_std_mm"] for seed in range(200)]
    assert 0.904 < np.mean(held) < 0.996


def test_tumours_with_an_empty_margin_are_left_out_whole():
    """Leaving out zeros alone would bias: they are where the errors are small."""
    rows = grid(lambda t, p, r: p**2.0)
    rows.loc[(rows["tumour"] == 2) & (rows["pos_std_mm"] == 2.5), "volume"] = 0.0
    rows.loc[(rows["tumour"] == 2) & (rows["pos_std_mm"] == 3.33), "volume"] = 300.0
    law = fit_power_law(rows, "volume")
    assert law.left_out == (2,) and law.rows == 18
    assert law.exponents["pos_std_mm"].mean == pytest.approx(2.0)
    table = exponents_table(rows.assign(variant="SV"), ["volume"])
    assert table["tumours"].tolist() == [2, 2] and table["note"].str.contains("tumour 2").all()
    rows.loc[rows["rot_std_deg"] == 5.0, "volume"] = 0.0
    with pytest.raises(InputError, match=r"without a zero.*\[1, 2, 3\]"):
        fit_power_law(rows, "volume")
    table = exponents_table(rows.assign(variant="SV"), ["volume"])
    assert table["exponent"].isna().all() and table["tumours"].eq(0).all()
    assert table["note"].str.fullmatch("11 of 27 are zero").all()


def test_what_does_not_vary_has_no_exponent():
    rows = noisy(0, rotations=(5.0,))
    law = fit_power_law(rows, "volume")
    assert list(law.exponents) == ["pos_std_mm"] and law.difference is None
    table = exponents_table(rows.assign(variant="SV"), ["volume"]).set_index("error")
    assert np.isfinite(table.loc["pos_std_mm", "exponent"]) and np.isnan(table.loc["rot_std_deg", "exponent"])
    single = rows[rows["pos_std_mm"] == 5.0].assign(variant="SV")
    assert exponents_table(single, ["volume"])["note"].tolist() == ["the errors do not vary"] * 2
    tied = rows.assign(rot_std_deg=rows["pos_std_mm"])
    with pytest.raises(InputError, match="vary together"):
        fit_power_law(tied, "volume")
    with pytest.raises(InputError, match="positive errors"):
        fit_power_law(rows.assign(pos_std_mm=0.0), "volume")


def test_two_rows_give_an_exponent_without_an_interval():
    rows = grid(lambda t, p, r: p, tumours=(1,), positions=(5.0, 2.5), rotations=(5.0,))
    exponent = fit_power_law(rows, "volume").exponents["pos_std_mm"]
    assert exponent.mean == pytest.approx(1) and np.isnan(exponent.half_width)


def test_series_that_never_fall_are_counted():
    rows = grid(lambda t, p, r: p * (r if t == 1 else 1 / r))
    assert never_falls(rows, "volume", "pos_std_mm") == (9, 9)
    assert never_falls(rows, "volume", "rot_std_deg") == (3, 9)


@pytest.mark.parametrize(
    ("variant", "error", "exponent", "half_width", "monotone"),
    [
        ("SV", "pos_std_mm", 0.77, 0.16, 12),
        ("SV", "rot_std_deg", 0.07, 0.16, 6),
        ("CT", "pos_std_mm", 1.07, 0.22, 10),
        ("CT", "rot_std_deg", -0.03, 0.22, 3),
    ],
)
def test_printed_tables_give_the_exponents_of_the_audit(variant, error, exponent, half_width, monotone):
    """Stated with two decimals, so half a unit of the second is all there is to tolerate."""
    table = exponents_table(printed_rows()).set_index(["variant", "error"])
    row = table.loc[variant, error]
    assert row["exponent"] == pytest.approx(exponent, abs=0.005)
    assert row["half_width_95"] == pytest.approx(half_width, abs=0.005)
    assert (row["monotone"], row["of"], row["tumours"], row["note"]) == (monotone, 12, 4, "")


def test_printed_position_matters_more_than_rotation_in_both_shapes():
    for _, rows in printed_rows().groupby("variant"):
        assert fit_power_law(rows, "margin_volume_mm3").difference.low > 0
