"""Claims of 2.5.1 and slopes of figures 2.20 and 2.21, checked on the printed tables."""

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from study import published
from study.errors import InputError
from study.experiments.appendix_claims import (
    bone_counted_cm3,
    comparison_claims,
    paired_with_printed,
    rounding_percent,
    shorter_percent,
    strategy_claims,
)
from study.experiments.milling_times import draw_milling_times, fitted_line


@pytest.fixture(scope="module")
def printed():
    return [published.corrected(name).set_index("specimen") for name in ("A.1", "A.2")]


def test_percentages_of_the_text_follow_from_the_printed_rows(printed):
    zigzag, three_d = printed
    assert shorter_percent(zigzag, three_d, "predicted_path_length_mm") == pytest.approx(9.1, abs=0.05)
    assert shorter_percent(zigzag, three_d, "predicted_milling_time_s") == pytest.approx(30.7, abs=0.05)
    assert rounding_percent(three_d) == pytest.approx(8.5, abs=0.05)
    assert rounding_percent(zigzag) == pytest.approx(0.4, abs=0.05)


def test_printed_rows_decide_the_claims(printed):
    claims = comparison_claims(*printed, where="printed")
    verdicts = {claim.text.split(" (")[0]: claim.holds for claim in claims}
    assert not verdicts.pop("Contact columns of both planners add up to the same bone within a tenth")
    # Four bones tie in the two digits that are printed.
    assert not verdicts.pop("The 3-D planner leaves less of the unmodified target in every bone")
    assert all(verdicts.values())
    assert len(verdicts) == 9
    assert bone_counted_cm3(printed[0]).mean() / bone_counted_cm3(printed[1]).mean() > 1.9
    # Exchanged, what compares the planners turns round.
    turned = comparison_claims(printed[1], printed[0], where="printed")
    assert not any(claim.holds for claim in turned)


def test_claims_need_the_same_bones(printed):
    with pytest.raises(InputError, match="same specimens"):
        comparison_claims(printed[0], printed[1].iloc[::-1], where="printed")


def test_a_line_is_found_with_its_interval():
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(300):
        volumes = rng.uniform(1, 5, 12)
        line = fitted_line(volumes, 50 + 400 * volumes + rng.normal(0, 80, 12))
        inside += 400 in line.slope
    assert 0.91 < inside / 300 < 0.985  # 95 % with three standard errors of 300 trials
    exact = fitted_line([1, 2, 4], [150, 250, 450])
    assert exact.slope.mean == pytest.approx(100)
    assert exact(3.0) == pytest.approx(350)
    assert exact.scatter_s == pytest.approx(0, abs=1e-9)


def test_slopes_of_the_milled_bones_are_the_printed_ones(printed):
    volumes = printed[0]["modified_initial_target_cm3"]
    true = published.table("2.3").set_index("specimen")
    for milled_with, slope in (("zigzag", 577), ("3d", 405)):
        rows = true[true["milled_with"] == milled_with]
        line = fitted_line(volumes[rows.index], rows["true_milling_time_s"])
        assert line.slope.mean == pytest.approx(slope, abs=1)


@pytest.mark.parametrize(
    ("volumes", "times"),
    [([1, 2], [1, 2]), ([1, 1, 1], [1, 2, 3]), ([1, 2, 3], [1, 2]), ([1, 2, np.nan],) * 2],
)
def test_no_line_without_three_different_pairs(volumes, times):
    with pytest.raises(InputError, match="line needs"):
        fitted_line(volumes, times)


def test_the_drawing_shows_every_bone(printed):
    _, axes = plt.subplots()
    series = {
        name: (rows["modified_initial_target_cm3"], rows["predicted_milling_time_s"])
        for name, rows in zip(("zigzag", "3d"), printed, strict=True)
    }
    lines = draw_milling_times(axes, series)
    assert [len(dots.get_offsets()) for dots in axes.collections] == [36, 36]
    assert lines["zigzag"].slope.mean == pytest.approx(531.0, abs=0.5)
    assert lines["3d"].slope.mean == pytest.approx(336.1, abs=0.5)
    plt.close("all")


def test_rows_are_compared_with_the_printed_ones_of_the_same_name(printed):
    ours = printed[1].head(5).copy()
    ours["predicted_milling_time_s"] += 10
    table = paired_with_printed(pd.concat([ours.rename(index={"CH01": "other"})]), printed[1])
    assert (table["n"] == 4).all()
    assert table.loc["predicted_milling_time_s", "difference"] == pytest.approx(10)
    assert table.loc["milling_path_length_mm", "difference"] == 0
    assert paired_with_printed(ours.head(1), printed[1]).empty


def test_one_planner_alone_is_judged_too(printed):
    ours = printed[1].assign(verified=True)
    assert all(claim.holds for claim in strategy_claims(ours, printed[1]))
    worse = ours.assign(verified=ours.index != "CH02", average_milling_speed_mm_per_s=0.4)
    worse["modified_final_over_initial_ratio"] += 0.1
    worse["milling_path_length_mm"] = worse["predicted_path_length_mm"]
    assert not any(claim.holds for claim in strategy_claims(worse, printed[1]))
