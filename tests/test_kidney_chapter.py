"""Chapter 4 on one kidney: the way of the fits, the margins, and words that follow from their numbers."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from small_kidney import loose, small_kidney, tumour_points

from study.errors import InputError
from study.experiments.kidney_chapter import (
    grow_all,
    grow_for_purposes,
    grow_for_tracings,
    grow_inside,
    growth_words,
    purposes_table,
    purposes_words,
    removal_table,
    thickest,
    tracing_table,
    tracing_words,
)
from study.experiments.kidney_draws import RememberedRegistrations
from study.experiments.kidney_stopping import (
    denser_rows,
    denser_words,
    fits_on_the_way,
    stopping_table,
    stopping_words,
)
from study.margins import SafetyMargin
from study.registration import IcpSettings, RobotError, SurfaceRegistration, register_surface

SEED = 3


@pytest.fixture(scope="module")
def fits():
    return fits_on_the_way(loose(), 40, SEED, stops=(1, 3, 10))


# The way of the fits


def test_stops_lie_on_one_way(fits):
    """Going on from a stop leads where a fit in one go leads."""
    model = loose()
    starts = model.starts(40, SEED)
    np.testing.assert_array_equal(fits.transforms[0], starts)
    assert fits.stops == (0, 1, 3, 10, 500)
    for k, stop in enumerate(fits.stops[1:], start=1):
        whole = register_surface(model.tree, model.patch, starts, IcpSettings(max_iterations=stop))
        np.testing.assert_allclose(fits.transforms[k], whole.transforms, atol=1e-7)
        np.testing.assert_array_equal(fits.converged[k], whole.converged)
        np.testing.assert_allclose(fits.residual[k], whole.rms, atol=1e-7)
        assert (fits.iterations[k] <= stop).all()
    assert fits.converged[-1].all()


def test_error_is_the_root_mean_square_over_points(fits):
    points = tumour_points()
    errors = fits.errors_at(points)
    for k, n in ((0, 0), (2, 7), (4, 39)):
        one = fits.transforms[k, n]
        away = np.linalg.norm(points @ one[:3, :3].T + one[:3, 3] - points, axis=1)
        assert errors[k, n] == pytest.approx(np.sqrt((away**2).mean()))


def test_shown_is_where_a_point_goes(fits):
    point = np.array([10.0, -3.0, 8.0])
    shown = fits.shown(point, (1, 10))
    assert list(shown) == ["after 1", "after 10", "converged"]
    one = fits.transforms[3, 5]
    np.testing.assert_allclose(shown["after 10"][5], one[:3, :3] @ point + one[:3, 3] - point)


def test_table_adds_up(fits):
    table = stopping_table(fits, tumour_points(), listed=(0, 3))
    assert list(table.index) == ["not begun", "after 3", "converged"]
    np.testing.assert_allclose(table["tre_mm"], np.hypot(table["bias_mm"], table["scatter_mm"]))
    assert (table["median_mm"] <= table["worst_1_in_100_mm"]).all()
    assert table.loc["converged", "converged_pct"] == 100
    assert table.loc["not begun", "iterations"] == 0


@pytest.mark.parametrize("stops", [(5, 5), (0, 5), (20, 10), (5, 500)])
def test_stops_have_to_grow(stops):
    with pytest.raises(InputError, match="stops: expected growing numbers from 1 to 499"):
        fits_on_the_way(loose(), 3, 0, stops=stops)


def test_denser_surface_is_the_same_surface():
    case = small_kidney()
    rows = denser_rows(case.surface, case.swab, tumour_points(), 10, SEED, times=1, position_std=1.0)
    assert list(rows.index) == ["vertices as they are", "4 times the vertices"]
    assert rows["spacing_mm"].iloc[1] < 0.7 * rows["spacing_mm"].iloc[0]
    assert rows["residual_mm"].iloc[1] < rows["residual_mm"].iloc[0]


# Words


def stops_of(**changes):
    table = pd.DataFrame(
        {
            "tre_mm": [8.0, 3.0, 0.5],
            "bias_mm": 0.1,
            "scatter_mm": [8.0, 3.0, 0.5],
            "median_mm": [7.0, 2.5, 0.4],
            "worst_1_in_100_mm": [15.0, 8.0, 0.9],
            "converged_pct": [0.0, 2.0, 100.0],
            "iterations": [0.0, 20.0, 60.0],
            "residual_mm": [np.nan, 0.9, 0.7],
            "checked_pct": [100.0, 90.0, 97.0],
            "checked_worst_mm": [15.0, 5.0, 0.9],
        },
        index=["not begun", "after 20", "converged"],
    )
    for column, value in changes.items():
        table.loc["converged", column] = value
    return table


def test_words_on_stops_follow_from_the_numbers():
    text = stopping_words(stops_of())
    assert "depends on when the fit is stopped" in text and "factor of up to 6.0" in text
    assert "Not all fits end at the same place" not in text
    text = stopping_words(stops_of(tre_mm=2.9))
    assert "depends on when" not in text and "the stop hardly matters" in text
    text = stopping_words(stops_of(worst_1_in_100_mm=6.0))
    assert "comes to rest 6.0 mm from it" in text and "give themselves away" in text
    text = stopping_words(stops_of(worst_1_in_100_mm=6.0, checked_worst_mm=5.9))
    assert "does not give them away" in text


def test_words_on_vertices_follow_from_the_numbers():
    rows = pd.DataFrame(
        {"spacing_mm": [0.8, 0.4], "median_mm": [0.6, 0.2], "worst_1_in_100_mm": [0.9, 0.5]}, index=["a", "b"]
    )
    assert "So 67% at least" in denser_words(rows) and "The worst come down" in denser_words(rows)
    assert "were not asked for" in denser_words(rows.iloc[:1])
    rows["median_mm"] = [0.3, 0.3]
    rows["worst_1_in_100_mm"] = [5.0, 5.0]
    text = denser_words(rows)
    assert "is not what a typical" in text and "The worst stay" in text
    rows["worst_1_in_100_mm"] = [0.9, 0.8]  # about a vertex: no other minimum
    assert "The worst" not in denser_words(rows)


def margins_table(low, last=500.0):
    rows = {}
    for fit, exact in (("early", 2000.0), ("converged", last)):
        for growth, size in (("published growth", 900.0), ("exact, sv", exact), ("exact, ct", 2 * exact)):
            rows[fit, growth] = {
                "margin_mm3": size,
                "risk_at_stop": 0.009,
                "validated_risk": 0.02 if growth[0] == "p" else 0.006,
                "validated_low": low if growth[0] == "p" else 0.004,
                "validated_high": 0.03,
            }
    table = pd.DataFrame.from_dict(rows, orient="index")
    names = {"exact, sv": "exact, spatially varying", "exact, ct": "exact, constant thickness"}
    index = [(fit, names.get(growth, growth)) for fit, growth in rows]
    table.index = pd.MultiIndex.from_tuples(index, names=["fit", "growth"])
    return table


def test_words_on_growth_follow_from_the_numbers():
    text = growth_words(margins_table(low=0.015), 0.01, 700)
    assert text.count("beyond chance") == 2 and "700 registrations" in text
    assert "0.50 times what constant thickness takes" in text and "no margin at all" not in text
    text = growth_words(margins_table(low=0.008, last=0.0), 0.01, 700)
    assert "beyond chance" not in text and "may be chance" in text and "no margin at all" in text


# Margins of one kidney


@pytest.fixture(scope="module")
def grown():
    model = RememberedRegistrations(loose())
    return grow_all(small_kidney(), model, 0.02, 200, SEED)


def test_all_growths_share_their_registrations_and_the_table_says_what_they_found(grown):
    case = small_kidney()
    table = removal_table({"loose": grown}, case)
    assert list(table.index.get_level_values("growth")) == list(grown)
    for name, margin in grown.items():
        row = table.loc["loose", name]
        assert row["margin_mm3"] == margin.volume_mm3 > 0
        assert row["risk_at_stop"] == margin.damage_risk <= 0.02
        assert row["validated_low"] <= row["validated_risk"] <= row["validated_high"]
        assert 0 < row["healthy_kidney_mm3"] < row["margin_mm3"]
        away = margin.volume.points(np.argwhere(margin.mask))[:, None] - tumour_points()[None]
        assert row["thickest_mm"] == pytest.approx(np.linalg.norm(away, axis=2).min(axis=1).max())
    assert thickest(replace(grown["published growth"], mask=np.zeros_like(margin.mask))) == 0


def test_purposes_ask_for_about_the_same_tissue_or_for_the_inside():
    case = small_kidney()
    model = RobotError(case.tumour_centre, 0.4, 0.01)
    margins = grow_for_purposes(case, model, 0.05, 200, SEED)
    table = purposes_table({"tool": margins})
    rows = table.droplevel("error")
    whole = case.anatomy.volume_mm3("tumour")
    assert rows.loc["remove", "inside_mm3"] == pytest.approx(whole + rows.loc["remove", "margin_mm3"])
    inside = rows.loc["stay_inside"]
    assert inside["inside_mm3"] + inside["margin_mm3"] == pytest.approx(whole)
    assert 0.5 < rows.loc["protect", "margin_mm3"] / rows.loc["remove", "margin_mm3"] < 2
    said = purposes_words(table, 0.05)
    assert f"{inside['inside_mm3']:.0f} mm³" in said and "nothing would be left" not in said


def test_a_larger_risk_is_tried_where_nothing_would_be_inside():
    case = small_kidney()
    model = RobotError(case.tumour_centre, 1.8, 0.0)
    margin = grow_inside(case, model, 0.02, 200, SEED)
    assert isinstance(margin, SafetyMargin) and margin.inside.any()
    assert margin.acceptable_risk > 0.02
    said = purposes_words(purposes_table({"tool": {"stay_inside": margin}}), 0.02)
    assert "in all but 0.02 of them nothing would be left" in said


def test_union_holds_every_tracing_and_is_no_riskier():
    case = small_kidney()
    model = SurfaceRegistration(case.surface, case.swab, 1.0, 2.0, digitiser_std=1.0)
    settings = {"acceptable_risk": 0.03, "registrations": 150, "seed": SEED}
    traced = grow_for_tracings(case, model, 2, **settings)
    drawn = grow_all(case, RememberedRegistrations(model), 0.03, 150, SEED)["exact, spatially varying"]
    table = tracing_table(traced, drawn, 150, SEED)
    single = table.iloc[:2]
    assert table.index[2] == "union of the 2"
    assert table["margin_mm3"].iloc[2] >= single["margin_mm3"].max() > 0
    assert table["risk"].iloc[2] <= single["risk"].min()
    assert table["risk"].iloc[3] == drawn.validation.risk  # judged on what it was validated on
    assert f"{table['risk'].iloc[3]:.3g}" in tracing_words(table, 0.03)
