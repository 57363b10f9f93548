"""Repeated growths by each stopping rule, and what is counted of them."""

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from study.errors import InputError
from study.experiments.margin_confidence import RULES, expected_share, rules_table, run_rules
from study.margins import RiskEstimate

FEW = {"runs": 2, "registrations": 600, "judged_on": 3000}


@pytest.fixture(scope="module")
def rows():
    return run_rules("TB14", ("chorda_tympani",), **FEW)


def test_every_rule_is_run_and_judged_on_the_same_registrations(rows):
    assert len(rows) == 2 * len(RULES)
    assert rows["rule"].tolist() == [rule for rule in RULES for _ in range(2)]
    assert (rows["stopped_at_risk"] <= rows["tolerance"]).all()
    assert ((rows["true_low"] <= rows["true_risk"]) & (rows["true_risk"] <= rows["true_high"])).all()
    # the same volume of exact rules is the same margin, and the same judges give the same risk
    exact = rows[rows["rule"] != "published"].groupby("volume_mm3")["true_risk"]
    assert (exact.max() == exact.min()).all()
    by_run = rows.set_index(["rule", "run"])["volume_mm3"]
    plain, sure = by_run["exact, plain quantile"], by_run["exact, 95 % confidence"]
    assert (sure >= plain).all()  # of the same registrations
    assert (rows.loc[rows["rule"] == "published", "looks"] > 1).all()
    assert (rows["looks_near_tolerance"] <= rows["looks"]).all()


def test_a_rule_has_the_same_runs_whichever_others_are_asked_for(rows):
    rule = "exact, plain quantile"
    alone = run_rules("TB14", ("chorda_tympani",), (rule,), **FEW)
    same = rows[rows["rule"] == rule].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone.drop(columns="growth_s"), same.drop(columns="growth_s"))


def test_the_slow_rule_may_have_fewer_runs(rows):
    fewer = run_rules("TB14", ("chorda_tympani",), **{**FEW, "published_runs": 1})
    assert fewer.groupby("rule").size().to_dict() == {rule: 1 if rule == "published" else 2 for rule in RULES}
    same = rows.drop(index=1).reset_index(drop=True)  # the published rule's second run
    pd.testing.assert_frame_equal(fewer.drop(columns="growth_s"), same.drop(columns="growth_s"))


def test_shares_are_counted_with_their_intervals():
    true = np.array([0.0008, 0.0009, 0.0011, 0.0015])
    rows = pd.DataFrame(
        {
            "structure": "facial_nerve",
            "rule": "published",
            "tolerance": 0.001,
            "registrations": 25_000,
            "true_risk": true,
            "true_low": true - 0.0002,
            "true_high": true + 0.0002,
            "true_over_tolerance": true / 0.001,
            "stopped_at_risk": 0.001,
            "volume_mm3": [1.0, 2.0, 3.0, 10.0],
            "looks": [100, 110, 120, 130],
            "looks_near_tolerance": 20,
            "growth_s": 1.0,
        }
    )
    row = rules_table(rows).loc[("facial_nerve", "published")]
    assert (row["runs"], row["above"], row["surely_above"]) == (4, 2, 1)
    low, high = RiskEstimate(2, 4).interval
    assert (row["share_low_pct"], row["share_high_pct"]) == pytest.approx((100 * low, 100 * high))
    assert row["median_true_over_tolerance"] == pytest.approx(1.0)
    assert row["true_over_stopped"] == pytest.approx(1.075)
    assert (row["median_volume_mm3"], row["median_looks"]) == (2.5, 115)
    assert np.isnan(row["expected_pct"])


@pytest.mark.parametrize("tolerance", [0.001, 0.01, 0.05])
def test_theory_agrees_with_drawn_order_statistics(tolerance):
    """The true risk of a margin that grows without steps is one minus a uniform order statistic."""
    n = 25_000
    rng = np.random.default_rng(1)
    for rule, allowed in (
        ("exact, plain quantile", int(n * tolerance)),
        ("exact, 95 % confidence", None),
    ):
        expected = expected_share(rule, n, tolerance)
        if allowed is None:
            hits = np.arange(int(n * tolerance))
            sure = (
                stats.binom.cdf(hits, n, tolerance) <= 0.05
            )  # as many or fewer hits though at the tolerance
            allowed = int(hits[sure].max())
            assert expected <= 0.05
        drawn = rng.binomial(n, tolerance, 20_000)
        # above the tolerance: no more than m registrations need more than the margin that is just at it
        assert expected == pytest.approx(np.mean(drawn <= allowed), abs=0.011)
    assert np.isnan(expected_share("published", n, tolerance))


def test_unknown_rules_structures_and_no_run_are_refused():
    for given in ({"rules": ["lucky"]}, {"structures": ["dura"]}, {"runs": 0}):
        with pytest.raises(InputError, match="rules, structures, runs"):
            run_rules("TB14", **given)
