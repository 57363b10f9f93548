"""Rows, tables, claims and words of Tables 4.2 and B.1 to B.9: plain parts against references."""

import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from real_data import real
from scipy.spatial.transform import Rotation

from study import published
from study.errors import InputError
from study.experiments.kidney_claims import QUANTITIES, own_claims, printed_rows, table_claims
from study.experiments.kidney_draws import RememberedRegistrations, scatter_at
from study.experiments.kidney_margins import (
    RUNS,
    STOPS,
    TABLES,
    VARIANTS,
    registration_of,
    run_kidney_margins,
    select_kidneys,
)
from study.experiments.kidney_tables import as_printed, beyond_print, printed_beside_ours, starts_and_scatter
from study.experiments.kidney_words import conclusion, exponents_of, laws
from study.margins import GrowthSettings, grow_margin
from study.plots.kidney_tables import (
    against_errors,
    exponent_intervals,
    kidney_risk_curves,
    kidney_volumes,
    scatter_against_start,
)
from study.registration import SurfaceFits, sampled_moments
from study.specimens import kidney_case, kidney_catalogue

REGISTRATIONS, FRESH, RANKING = 60, 40, 30
TITLES = {name: run.title for name, run in RUNS.items()}


def motions(n, rng, size=1.0):
    """(n, 4, 4) rigid transforms."""
    rng = np.random.default_rng(rng)
    out = np.tile(np.eye(4), (n, 1, 1))
    out[:, :3, :3] = Rotation.from_rotvec(0.05 * size * rng.standard_normal((n, 3))).as_matrix()
    out[:, :3, 3] = size * rng.standard_normal((n, 3)) + [0.3, 0, 0]
    return out


class FakeRegistration:
    """Draws motions as a surface registration draws fits, and counts how often it is asked."""

    def __init__(self):
        self.asked = []

    def register(self, n, rng):
        self.asked.append(n)
        first, second = rng.spawn(2)  # a model may draw from children of its generator
        transforms = motions(n, first) @ motions(n, second)
        return SurfaceFits(transforms, np.ones(n, bool), np.full(n, 7), rng.random(n), None)

    def sample(self, n, rng):
        return np.linalg.inv(self.register(n, np.random.default_rng(rng)).transforms)


@pytest.fixture(scope="module")
def found():
    return run_kidney_margins(
        ["K2"],
        (5.0,),
        (5.0,),
        registrations=REGISTRATIONS,
        validation_registrations=FRESH,
        ranking_registrations=RANKING,
        confidence=None,
    )


def rows_of(volume, scatter=lambda run, t, p, r: 1.0, runs=RUNS, tumours=(1, 2)):
    """Rows as `run_kidney_margins` makes them, from laws ``volume(run, variant, tumour, position, tilt)``."""
    rows = []
    for run in runs:
        for tumour in tumours:
            for position, tilt in TABLES:
                for variant in VARIANTS:
                    spread = scatter(run, tumour, position, tilt)
                    rows.append(
                        {
                            "tumour": tumour, "kidney": f"K{tumour}", "table": TABLES[position, tilt],
                            "pos_std_mm": position, "rot_std_deg": tilt, "run": run, "variant": variant,
                            "stop": RUNS[run].stop,
                            "margin_volume_mm3": volume(run, variant, tumour, position, tilt),
                            "final_damage_probability": 0.008, "mahalanobis_mean": 3.0,
                            "mahalanobis_std": 0.5 if variant == "SV" else 1.0, "time_min": 0.1,
                            "validated_risk": 0.009, "validated_low": 0.007, "validated_high": 0.011,
                            "healthy_kidney_mm3": 10.0, "tumour_mm3": 100.0, "scatter_mm": spread,
                            "bias_mm": 0.1 * spread, "iterations_mean": 20.0,
                            "converged_pct": 100.0 if run == "converged" else 5.0,
                        }
                    )  # fmt: skip
    return pd.DataFrame(rows)


def proportional(run, variant, tumour, position, tilt):
    return 1000 * tumour * position * (1 if variant == "SV" else 2)


# Registrations, drawn once


def test_remembered_registrations_are_those_of_the_model_and_made_once():
    plain, fake = FakeRegistration(), FakeRegistration()
    kept = RememberedRegistrations(fake)
    for _ in range(2):
        ours, theirs = (np.random.default_rng([3, 4]).spawn(2) for _ in range(2))
        for n in (5, 5, 8):  # the second draw of five is another one
            for a, b in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(kept.sample(n, a), plain.sample(n, b))
        for a, b in zip(ours, theirs, strict=True):  # also what is drawn from the generators afterwards
            assert a.random() == b.random()
            assert a.spawn(1)[0].random() == b.spawn(1)[0].random()
    assert fake.asked == [5, 5, 5, 5, 8, 8] and kept.seconds > 0
    assert [len(fits) for fits in kept.fits] == fake.asked
    first = kept.moments()
    assert kept.moments() is first and fake.asked == [5, 5, 5, 5, 8, 8]
    reference = sampled_moments(np.linalg.inv(kept.fits[0].transforms))
    np.testing.assert_allclose(first.covariance, reference.covariance)


def test_scatter_and_bias_are_those_of_the_moved_points():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(40, 3)) * [10, 5, 2] + [200, -300, 150]
    transforms = motions(60, 1, size=0.2)
    moved = np.einsum("nab,mb->nma", transforms[:, :3, :3], points) + transforms[:, None, :3, 3] - points
    mean = moved.mean(axis=0)
    scatter = scatter_at(transforms, points)
    assert scatter.bias_mm == pytest.approx(np.sqrt((mean**2).sum(axis=1).mean()), rel=1e-9)
    assert scatter.scatter_mm == pytest.approx(np.sqrt(((moved - mean) ** 2).sum(axis=2).mean()), rel=1e-9)
    assert scatter.tre_mm == pytest.approx(np.sqrt((moved**2).sum(axis=2).mean()), rel=1e-9)


# Kidneys and rows


def test_kidneys_are_names_numbers_or_folders(tmp_path):
    names = kidney_catalogue()
    assert select_kidneys("all") == names and select_kidneys("2") == names[:2]
    assert select_kidneys(f"{names[2]}, {names[0]}") == [names[0], names[2]]
    for name in ("b", "a"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "segmentation.nii.gz").write_bytes(b"")
    assert select_kidneys(str(tmp_path)) == [str(tmp_path / "a"), str(tmp_path / "b")]
    assert select_kidneys(str(tmp_path / "b")) == [str(tmp_path / "b")]
    (tmp_path / "none").mkdir()
    for wrong, message in (("0", "1 to 4"), ("K9", "K9"), ("", "'all'"), (tmp_path / "none", "no labels")):
        with pytest.raises(InputError, match=message):
            select_kidneys(str(wrong))


def test_real_folder_holds_the_real_kidneys():
    names = [Path(name).name for name in select_kidneys(str(real("kidney")))]
    assert names == sorted(names) and {"case_00063", "case_00101"} <= set(names)


def test_rows_are_what_growing_a_margin_says(found):
    """The model itself, without remembering, gives the same margins."""
    rows = found.rows.set_index(["run", "variant"])
    assert len(rows) == len(RUNS) * len(VARIANTS) and rows.index.is_unique
    case = kidney_case("K2")
    seed = [0, zlib.crc32(b"K2")]
    for run, ranking in (("published", REGISTRATIONS), ("loose", RANKING)):
        settings = GrowthSettings.for_removal(
            RUNS[run].method, registrations=REGISTRATIONS, violation_registrations=ranking,
            validation_registrations=FRESH, confidence=None,
        )  # fmt: skip
        model = registration_of(case, 5.0, 5.0, "loose")
        growing = model.sample(REGISTRATIONS, np.random.default_rng(seed).spawn(1)[0])
        model = SimpleNamespace(sample=model.sample, moments=lambda drawn=growing: sampled_moments(drawn))
        margin = grow_margin(case.anatomy, "tumour", model, settings=settings, rng=seed, purpose="remove")
        row = rows.loc[run, "SV"]
        assert row["margin_volume_mm3"] == margin.volume_mm3
        assert row["final_damage_probability"] == margin.damage_risk <= 0.01
        assert row["validated_risk"] == margin.validation.risk
        assert row["mahalanobis_mean"] == pytest.approx(margin.shell_distances.mean())
        healthy = np.count_nonzero(margin.mask & margin.volume.mask("kidney"))
        assert row["healthy_kidney_mm3"] == pytest.approx(healthy * case.anatomy.voxel_volume)
        pd.testing.assert_frame_equal(found.curves["K2", run, 5.0, 5.0, "SV"], margin.curve())


def test_rows_say_how_the_fits_ended(found):
    rows = found.rows.set_index(["run", "variant"])
    case = kidney_case("K2")
    model = registration_of(case, 5.0, 5.0, "loose")
    growing, _ = np.random.default_rng([0, zlib.crc32(b"K2")]).spawn(2)
    fits = model.register(REGISTRATIONS, growing)
    row = rows.loc["loose", "CT"]
    assert row["iterations_mean"] == pytest.approx(fits.iterations.mean())
    assert row["converged_pct"] == pytest.approx(100 * fits.converged.mean())
    tumour = case.anatomy.points(np.argwhere(case.anatomy.mask("tumour")))
    scatter = scatter_at(np.linalg.inv(fits.transforms), tumour)
    assert row["scatter_mm"] == pytest.approx(scatter.scatter_mm)
    shared = ["converged_pct", "iterations_mean", "scatter_mm", "bias_mm", "registration_s"]
    assert rows.loc["loose", shared].drop_duplicates().shape[0] == 1
    assert rows.loc[("converged", "SV"), "iterations_mean"] > rows.loc[("loose", "SV"), "iterations_mean"]
    assert rows.loc[("converged", "SV"), "scatter_mm"] < rows.loc[("loose", "SV"), "scatter_mm"]


def test_a_row_is_the_same_whatever_else_is_asked_for(found):
    alone = run_kidney_margins(
        ["K2"], (5.0,), (5.0,), ("loose",), REGISTRATIONS, FRESH, RANKING, confidence=None
    ).rows
    same = found.rows[found.rows["run"] == "loose"].reset_index(drop=True)
    pd.testing.assert_frame_equal(
        *(r.drop(columns=["registration_s", "growth_s", "time_min"]) for r in (alone, same))
    )


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"kidneys": []}, "at least one of each"),
        ({"runs": ("loose", "lose")}, "lose"),
        ({"position_stds": ()}, "at least one of each"),
        ({"rotation_stds": (-5.0,)}, "at least 0 degrees"),
    ],
)
def test_what_cannot_be_run_is_refused(changed, message):
    with pytest.raises(InputError, match=message):
        run_kidney_margins(**{"kidneys": ["K2"], "registrations": 10} | changed)


# Tables


def test_table_4_2_is_b_1_and_starts_are_those_of_the_text():
    assert printed_rows("4.2").drop(columns="table").equals(printed_rows("B.1").drop(columns="table"))
    text = [published.parameter(f"tested_{name}_stds").value for name in ("position", "rotation")]
    assert list(TABLES) == [(p, r) for p in text[0] for r in text[1]]
    for (position, tilt), name in TABLES.items():
        table = printed_rows(name)
        assert (table["pos_std_mm"] == position).all() and (table["rot_std_deg"] == tilt).all()


def test_printed_and_ours_stand_side_by_side():
    rows = rows_of(proportional, tumours=(1, 2, 3, 4, 5))
    table = printed_beside_ours(rows, "B.4", list(RUNS))
    assert len(table) == 5 * 2 * len(QUANTITIES)
    entry = table.set_index(["tumour", "variant", "quantity"]).loc[(3, "CT", "margin_volume_mm3")]
    assert (entry["printed"], entry["loose"]) == (85_000, 1000 * 3 * 3.33 * 2)
    assert table.loc[table["tumour"] == 5, "printed"].isna().all()
    shown = as_printed(table)
    assert shown.loc[("margin volume (mm³)", "printed"), "tumour 3 CT"] == "85000"
    assert shown.loc[("margin volume (mm³)", "printed"), "tumour 5 CT"] == "–"
    none = as_printed(printed_beside_ours(rows[rows["table"] != "B.4"], "B.4", list(RUNS)))
    assert len(none) == len(QUANTITIES) and none.shape[1] == 8
    text = beyond_print(rows)
    assert len(text) == len(rows) and text.iloc[0, 5] == "0.0090 (0.0070 to 0.0110)"
    assert starts_and_scatter(rows).shape == (9, 4)


# Claims


def verdicts(claims):
    return {claim.text.split(" (")[0].split(" ", 3)[-1]: claim.holds for claim in claims}


def holds(claims):
    return [claim.holds for claim in claims]


def test_claims_about_print_are_those_of_the_audit():
    claims = table_claims(printed_rows(), "printed")
    assert holds(claims) == [True, True, True, False, False]  # C4.2, C4.3, C4.5, C4.5, I23
    assert "in 36 of 36; 0.30 to 0.72 times, median 0.54" in claims[0].evidence
    assert "22 of 24 series of position, 9 of 24 series of rotation" in claims[3].evidence
    assert "above in 10 of 72" in claims[4].evidence
    assert holds(table_claims(printed_rows("4.2"), "printed")) == [True, True, False]


def test_every_claim_about_print_can_fail():
    rows = printed_rows()
    before = holds(table_claims(rows, "printed"))
    for changed, expected in (
        ({"margin_volume_mm3": 1e6}, 0),
        ({"mahalanobis_std": 9.0}, 1),
    ):
        worse = rows.copy()
        worse.loc[0, list(changed)] = list(changed.values())
        after = holds(table_claims(worse, "printed"))
        assert before[expected] and not after[expected]
    tilted = rows.assign(margin_volume_mm3=rows["margin_volume_mm3"] * rows["rot_std_deg"] ** 2)
    assert not table_claims(tilted, "printed")[2].holds
    rising = rows.assign(
        margin_volume_mm3=rows["pos_std_mm"] * rows["rot_std_deg"], final_damage_probability=0.01
    )
    assert holds(table_claims(rising, "printed"))[3:] == [True, True]
    with pytest.raises(InputError, match="at least one margin"):
        table_claims(rows.iloc[:0], "printed")


def test_empty_margins_are_no_comparison():
    rows = rows_of(lambda *_: 0.0, runs=("converged",))
    claims = table_claims(rows, "measured", "ours")
    assert [claim.text for claim in claims] == ["No final damage probability is above 0.01 (ours)"]


def test_own_claims_are_decided_by_the_rows():
    rows = rows_of(proportional, runs=("converged",))
    assert holds(own_claims(rows, "ours")) == [True] * 4
    worse = rows.copy()
    worse.loc[0, "validated_low"] = 0.0101
    worse.loc[1, "margin_volume_mm3"] = 0.0
    worse.loc[2, "converged_pct"] = 98.0
    worse.loc[4, "scatter_mm"] = 1.11
    assert holds(own_claims(worse, "ours")) == [False] * 4


# Words


def test_words_follow_from_the_numbers():
    small = {"published": 2.0, "loose": 2.0, "converged": 0.1}
    tiny = rows_of(
        lambda run, *start: 0.0 if run == "converged" else proportional(run, *start),
        lambda run, t, p, r: small[run] * (1 if run == "converged" else p),
    )
    text = conclusion(tiny, printed_rows(), TITLES)
    assert "0.77 ± 0.16" in text and "-0.03 ± 0.22" in text
    assert "that of the rotation error cannot be told from none in either shape" in text
    assert "36 of 36 margins are empty" in text and "36 of 36 converged margins are empty" in text
    assert "cannot be seen to know how wrong they started" in text
    assert "pay for is the stopping rule, and next to nothing else" in text
    rest = rows_of(proportional, lambda run, t, p, r: p * (0.5 if run == "converged" else 1))
    text = conclusion(rest, printed_rows(), TITLES)
    assert "0.50 times as much" in text and "50 % is the stopping rule" in text
    assert "still know how wrong they started (position)" in text
    same = rows_of(proportional, lambda run, t, p, r: 1.0)
    text = conclusion(same, printed_rows(), TITLES)
    assert "the stopping rule makes little difference" in text
    assert "SV 0.77, below both (1.00 converged, 1.00 loose)" in text
    assert "CT 1.07, above both (1.00 converged, 1.00 loose)" in text
    one = same[(same["table"] == "B.1") & (same["run"] == "loose")]
    text = conclusion(one, printed_rows(), TITLES)
    assert "errors of the start do not vary" in text and "Only one stopping rule" in text


def test_exponents_of_scatter_stand_once_for_runs_on_the_same_registrations():
    rows = rows_of(proportional, lambda run, t, p, r: p if run == "converged" else p**2)
    table = exponents_of({name: rows[rows["run"] == name] for name in RUNS} | {"print": printed_rows()})
    scatter = table[table["quantity"] == "scatter_mm"].set_index(["whose", "error"])["exponent"]
    assert set(scatter.index.get_level_values(0)) == {"loose stop", "converged"}
    assert scatter["loose stop", "pos_std_mm"] == pytest.approx(2)
    assert scatter["converged", "pos_std_mm"] == pytest.approx(1)
    assert len(table) == 2 * (4 * 2 + 2)


# Pictures


def test_pictures_show_every_margin(found):
    rows = rows_of(lambda run, *start: 0.0 if run == "converged" else proportional(run, *start))
    beside = printed_beside_ours(rows, "4.2", list(RUNS))
    figure = kidney_volumes(beside, {"printed": "printed", **TITLES})
    marks = [line for line in figure.axes[0].lines if line.get_marker() in ("o", "<")]
    assert len(marks) == 4 * 2 + 2 * 3 * 2
    assert sum(line.get_marker() == "<" for line in marks) == 4  # empty, at the edge
    sources = {"print": printed_rows(), **{name: rows[rows["run"] == name] for name in RUNS}}
    fitted = {(name, v): law for name, part in sources.items() for v, law in laws(part).items()}
    assert {name for name, _ in fitted} == {"print", "published", "loose"}
    figure = against_errors(sources, fitted, "margin_volume_mm3", "mm³")
    assert len(figure.axes) == 8
    table = exponents_of(sources)
    figure = exponent_intervals(table)
    notes = [text.get_text() for text in figure.axes[0].texts]
    assert notes == ["18 of 18 are zero"] * 2
    assert len(figure.axes[0].get_yticks()) == len(table) / 2
    figure = scatter_against_start(rows, STOPS)
    assert len(figure.axes[0].lines) == 2 * 2
    figure = kidney_risk_curves(found.curves, found.rows, 0.01, TITLES)
    assert len(figure.axes) == 1 and figure.axes[0].get_title(loc="left") == "K2"
