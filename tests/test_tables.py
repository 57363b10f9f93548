import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from scipy import stats

from study import tables
from study.errors import InputError

NUMBERS = st.lists(st.floats(-1e3, 1e3), min_size=2, max_size=12)


def test_t_interval_is_scipys():
    values = [3.1, 2.7, 4.0, 3.3, 2.9]
    interval = tables.t_interval(values, 0.9)
    low, high = stats.t.interval(0.9, 4, np.mean(values), stats.sem(values))
    assert (interval.low, interval.high) == pytest.approx((low, high))
    assert np.mean(values) in interval
    assert high + 0.01 not in interval


@settings(max_examples=30)
@given(NUMBERS, st.floats(-100, 100))
def test_t_interval_moves_with_the_values(values, shift):
    here, there = tables.t_interval(values), tables.t_interval(np.add(values, shift))
    assert there.mean == pytest.approx(here.mean + shift, abs=1e-9)
    assert there.half_width == pytest.approx(here.half_width, rel=1e-6, abs=1e-9)


def test_t_interval_covers_as_often_as_it_says():
    rng = np.random.default_rng(5)
    covered = sum(2.0 in tables.t_interval(rng.normal(2, 3, 6)) for _ in range(2000))
    assert stats.binomtest(covered, 2000, 0.95).pvalue > 1e-3


def test_equal_values_have_no_width():
    assert tables.t_interval([0.1] * 36).half_width == 0


@pytest.mark.parametrize("values", [[], [1.0], [1.0, np.nan], [[1.0, 2.0]]])
def test_t_interval_refuses(values):
    with pytest.raises(InputError):
        tables.t_interval(values)


def test_t_interval_refuses_a_percentage():
    with pytest.raises(InputError, match="95"):
        tables.t_interval([1, 2], 95)


def test_paired_comparison():
    a, b = [1.0, 2.0, 4.0, 4.0], [2.0, 4.0, 4.0, 3.5]
    found = tables.paired_comparison(a, b)
    assert (found.wins, found.ties, found.losses) == (2, 1, 1)
    assert found.difference.mean == pytest.approx(np.mean(np.subtract(a, b)))
    # the p value is below 0.05 exactly if the interval leaves zero out
    assert (found.p_value < 0.05) == (0 not in found.difference)


@settings(max_examples=30)
@given(st.lists(st.tuples(st.integers(-50, 50), st.integers(-50, 50)), min_size=2, max_size=12))
def test_swapping_the_columns_swaps_the_result(rows):
    a, b = np.array(rows, float).T
    one, other = tables.paired_comparison(a, b), tables.paired_comparison(b, a)
    assert (one.wins, one.ties, one.losses) == (other.losses, other.ties, other.wins)
    assert one.difference.mean == pytest.approx(-other.difference.mean)
    assert one.p_value == pytest.approx(other.p_value)


def test_paired_comparison_without_spread():
    assert tables.paired_comparison([1, 2], [1, 2]).p_value == 1
    assert tables.paired_comparison([1, 2], [2, 3]).p_value == 0


def test_paired_comparison_refuses_what_is_no_pair():
    with pytest.raises(InputError, match="2 and 3"):
        tables.paired_comparison([1, 2], [1, 2, 3])
    with pytest.raises(InputError, match="indexed"):
        tables.paired_comparison(pd.Series([1, 2], ["a", "b"]), pd.Series([1, 2], ["b", "a"]))


def test_symmetric_percent_difference():
    assert tables.symmetric_percent_difference(110, 90) == pytest.approx(20)
    assert tables.symmetric_percent_difference([1, 3], [3, 1]) == pytest.approx([100, 100])
    with pytest.raises(InputError):
        tables.symmetric_percent_difference(0, 1)


def test_printed_beside_measured_of_cases():
    printed = {"path_length_mm": 66.0, "contact_ratio": 0.0, "milling_time_s": 10.0}
    measured = pd.DataFrame({"path_length_mm": [600.0, 720.0], "contact_ratio": [0.1, 0.3]})
    rows = tables.printed_beside_measured(printed, measured, {"path_length_mm": 660.0})
    assert rows.index.tolist() == list(printed)
    path = rows.loc["path_length_mm"]
    assert (path["unit"], path["printed"], path["corrected"], path["measured"]) == ("mm", 66, 660, 660)
    assert path["measured_over_corrected"] == 1
    assert path["measured_plus_minus"] == pytest.approx(tables.t_interval([600, 720]).half_width)
    assert rows.loc["contact_ratio", "corrected"] == 0
    assert np.isnan(rows.loc["contact_ratio", "measured_over_corrected"])
    assert rows.loc["milling_time_s", ["measured", "measured_plus_minus"]].isna().all()


def test_printed_beside_measured_of_numbers():
    rows = tables.printed_beside_measured(pd.Series({"time_s": 4.0}), {"time_s": 5.0, "other": 1.0})
    assert rows.loc["time_s", "measured_over_corrected"] == 1.25
    assert "measured_plus_minus" not in rows
    with pytest.raises(InputError, match=r"time_s.*other"):
        tables.printed_beside_measured({"time_s": 4.0}, {"other": 1.0})


def test_claims():
    claims = [
        tables.Claim("shorter", np.bool_(True), "5 %", "printed"),
        tables.Claim("faster", False, "-1 %", "measured"),
    ]
    rows = tables.claims_table(claims)
    assert rows.columns.tolist() == ["claim", "holds", "evidence", "where"]
    assert rows["holds"].tolist() == ["yes", "no"]
    with pytest.raises(InputError):
        tables.Claim("shorter", "yes", "", "printed")
    with pytest.raises(InputError):
        tables.Claim("shorter", True, "", "elsewhere")


def test_words_and_units():
    assert tables.heading("milling_path_length_mm") == "milling path length (mm)"
    assert tables.heading("path_length_over_volume_mm_per_cm3") == "path length over volume (mm/cm³)"
    assert tables.heading("modified_final_over_initial_ratio") == "modified final over initial ratio"
    assert tables.heading("specimen") == "specimen"
    assert tables.unit_of("average_milling_speed_mm_per_s") == "mm/s"
    assert tables.with_unit(12345.6, "s") == "12346 s"
    assert tables.with_unit(0.012345, "mm") == "0.0123 mm"
    assert tables.with_unit(7) == "7"
    assert tables.with_interval(tables.Interval(655.97, 77.7, 36), "mm") == "656 ± 78 mm"
    assert tables.with_interval(tables.Interval(4.5556, 0.0827, 36), "mm/s") == "4.556 ± 0.083 mm/s"
    assert tables.with_interval(tables.Interval(0.1, 0.0, 36)) == "0.1 ± 0"


def test_save_table(tmp_path):
    rows = pd.DataFrame({"name": ["a", "b"], "value": [1 / 3, 2.0]})
    path = tmp_path / "new" / "rows.csv"
    tables.save_table(rows, path)
    assert path.read_bytes() == b"name,value\na,0.33333333\nb,2\n"
    assert [file.name for file in path.parent.iterdir()] == ["rows.csv"]


def test_save_figure(tmp_path):
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0, 1])
    for name in ("one.png", "other.png"):
        tables.save_figure(figure, tmp_path / name, dpi=50)
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "other.png").read_bytes()
    assert sorted(file.name for file in tmp_path.iterdir()) == ["one.png", "other.png"]
