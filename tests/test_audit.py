import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from study import audit, published
from study.audit import baron, chapter2, chapter2_claims, chapter3, chapter4, figures
from study.audit.findings import Check, Finding, printed_step, rounds_to, shown
from study.errors import InputError


@pytest.fixture(scope="module")
def findings():
    return {finding.id: finding for finding in audit.all_findings()}


def found(finding):
    return {check.what: check.found for check in finding.checks}


def test_every_known_finding_is_recomputed_once(findings):
    assert len(audit.FINDINGS) == len(findings)
    assert set(findings) == set(published.findings()["id"])


def test_what_does_not_recompute(findings):
    """All but five numbers agree; these five are differences a reader has to know of."""
    differing = {(k, check.what) for k, f in findings.items() for check in f.checks if not check.agrees}
    assert differing == {
        ("E1", "3-D time, correct +- (s)"),
        ("C2.7", "bones with less left, unmodified volume, 4 DOF"),
        ("C2.7", "bones with less left, unmodified volume, 5 DOF"),
        ("C2.8", "time, p of the paired t test"),
        ("C5.3", "hannover bottom: radius, largest (mm)"),
    }
    assert all(findings[k].remark for k, _ in differing)


def test_intervals(findings):
    """38 of 38 columns are a scaled mean, none is an interval (E1)."""
    numbers = found(findings["E1"])
    assert numbers["+- equal to mean x 1.96/6, within rounding of the rows"] == 38
    assert numbers["+- within 5 % of a t interval"] == 0
    table = audit.corrected_intervals()
    assert len(table) == 38
    assert (table["table"].value_counts()[["A.1", "A.2", "A.3", "A.4"]] == [11, 11, 8, 8]).all()


def test_a_real_interval_would_not_count_as_scaled_mean(monkeypatch):
    """Were the printed numbers right intervals, E1 would say so."""
    right = audit.corrected_intervals().set_index(["table", "column"])["t_half_width"]
    read = published.summary

    def with_right_intervals(name, as_printed=False):
        rows = read(name, as_printed=True)
        for column in rows:
            rows.loc["plus_minus", column] = f"{right[name, column]:.3g}"
        return rows if as_printed else rows.astype(float)

    monkeypatch.setattr(published, "summary", with_right_intervals)
    numbers = found(chapter2.intervals_are_scaled_means())
    assert numbers["+- equal to mean x 1.96/6, within rounding of the rows"] < 5
    assert numbers["+- within 5 % of a t interval"] == 37  # one column is constant


def test_lengths(findings):
    """The factor ten fits 72 rows, the factor one none (E2)."""
    numbers = found(findings["E2"])
    assert numbers["rows where rounding allows 10"] == 72
    assert numbers["rows where rounding allows 1"] == 0


def test_lengths_in_true_units_would_pass(monkeypatch):
    """Were the printed lengths millimetres, E2 would say so."""
    true = {name: published.corrected(name) for name in ("2.3", "A.1", "A.2")}
    monkeypatch.setattr(published, "table", true.get)
    numbers = found(chapter2.lengths_are_centimetres())
    assert numbers["rows where rounding allows 1"] == 72
    assert numbers["rows slower than the least feed"] == 0


def test_slopes_against_numpy():
    table = chapter2_claims.slopes().set_index(["milled_with", "over"])
    rows = published.table("A.2")
    slope = np.polyfit(rows["modified_initial_target_cm3"], rows["predicted_milling_time_s"], 1)[0]
    assert table.loc[("3d", "all 36 scans"), "slope_s_per_cm3"] == pytest.approx(slope)


@settings(max_examples=25)
@given(st.integers(1, 20), st.integers(2, 4))
def test_largest_deviation_against_brute_force(total, n):
    """Over all n integers in [0, 5] of one sum no sample deviates more."""
    top = 5
    total = min(total, n * top)
    samples = [s for s in itertools.product(range(top + 1), repeat=n) if sum(s) == total]
    brute = max(np.std(s, ddof=1) for s in samples)
    assert chapter3.largest_deviation(total / n, top, n) == pytest.approx(brute)


def test_volume_exponents_of_a_power_law(monkeypatch):
    table = published.appendix_b()
    noise = np.random.default_rng(0).normal(0, 0.01, len(table))
    law = table["tumour"] * table["pos_std_mm"] ** 1.5 * table["rot_std_deg"] ** 0.25 * np.exp(noise)
    monkeypatch.setattr(published, "appendix_b", lambda: table.assign(margin_volume_cm3=law))
    rows = chapter4.volume_exponents().set_index(["variant", "error"])
    for variant in ("SV", "CT"):
        assert rows.loc[(variant, "pos_std_mm"), "exponent"] == pytest.approx(1.5, abs=0.05)
        assert rows.loc[(variant, "rot_std_deg"), "exponent"] == pytest.approx(0.25, abs=0.05)


def test_quantiles_of_the_plane():
    rng = np.random.default_rng(3)
    sample = rng.normal(size=(1_000_000, 2))
    inside = np.mean(np.hypot(*sample.T) <= baron.planar_quantile(0.99))
    assert inside == pytest.approx(0.99, abs=5e-4)
    # many observations make the prediction region the region of the known covariance
    assert baron.prediction_quantile(10**6) == pytest.approx(baron.planar_quantile(), rel=1e-4)


def test_prediction_quantile_against_simulation():
    rng, n, level = np.random.default_rng(4), 8, 0.9
    draws = rng.normal(size=(40_000, n + 1, 2))
    sample, new = draws[:, :n], draws[:, n]
    mean = sample.mean(axis=1)
    centred = sample - mean[:, None]
    covariance = np.einsum("rni,rnj->rij", centred, centred) / (n - 1)
    gap = new - mean
    distance = np.einsum("ri,rij,rj->r", gap, np.linalg.inv(covariance), gap)
    inside = np.mean(distance <= baron.prediction_quantile(n, level) ** 2)
    assert inside == pytest.approx(level, abs=0.006)


@pytest.mark.parametrize("correlation", [-0.8, 0.0, 0.6])
def test_radial_quantile_against_simulation(correlation):
    mean, covariance = np.array([0.5, -0.2]), np.array([[0.04, 0.0], [0.0, 0.01]])
    covariance[0, 1] = covariance[1, 0] = correlation * 0.2 * 0.1
    sample = np.random.default_rng(6).multivariate_normal(mean, covariance, 1_000_000)
    radius = baron.radial_quantile(mean, covariance, 0.99)
    assert np.mean(np.hypot(*sample.T) <= radius) == pytest.approx(0.99, abs=5e-4)


def test_radial_quantile_without_mean_is_rayleigh():
    assert baron.radial_quantile(np.zeros(2), np.eye(2), 0.999) == pytest.approx(
        baron.planar_quantile(), abs=1e-6
    )


@pytest.mark.parametrize(
    ("value", "text", "expected"),
    [(3.149, "3.15", True), (3.156, "3.15", False), (5.88e-5, "5.9e-5", True), (577.52, "577.5", True),
     (-3.39, "-3.4", True), (0.5, "1", True), (11.0, "1e1", True), (36, "36", True), (35, "36", False)],
)  # fmt: skip
def test_rounding(value, text, expected):
    assert rounds_to(value, text) is expected


def test_checks():
    assert printed_step("1.3e-02") == pytest.approx(1e-3)
    assert not Check("fact", "no", True).agrees
    assert Finding("E1", (Check("a", "1", 1), Check("b", "2", 1))).confirmed == "partly"
    assert Finding("E1", (Check("a", "1", 2),)).confirmed == "no"
    assert shown(True) == "yes"
    assert shown(36.0) == "36"
    for stated, value in (("about 3", 3), ("yes", 1)):
        with pytest.raises(InputError):
            Check("what", stated, value)
    with pytest.raises(InputError, match="E6"):
        _ = Finding("E99", ()).statement


@pytest.mark.parametrize("name", figures.ALL)
def test_pictures_are_drawn(name, tmp_path):
    path = tmp_path / f"{name}.png"
    figures.ALL[name]().savefig(path, dpi=40)
    assert path.stat().st_size > 2000
