"""4 against 5 degrees of freedom: what is counted, compared and claimed."""

import numpy as np
import pandas as pd
import pytest
from planning_cases import small_cone

from study import plots, published
from study.cases import Case, undercut
from study.errors import InputError
from study.experiments import freedom
from study.experiments.appendix import PRINTED
from study.experiments.freedom import PLANNERS, differences, freedom_plan, freedom_row, run_freedom, unreached
from study.experiments.freedom_claims import degree_claims, reach_claims, same_bones, window_claims
from study.robots import FiveAxis, predict_milling
from study.volumes import LabelVolume

INTO = np.array([1.0, 0, 0])
#: Small pockets: open, and with an overhang that a tilt about one axis cannot get under all round.
POCKETS = {
    "open": small_cone(),
    "undercut": undercut(small_cone(shape=(34, 40, 40), depth=7.2, top=5.6, opening=0.0), 2.0, 7.0, INTO),
}


@pytest.fixture(autouse=True)
def cases(monkeypatch):
    monkeypatch.setattr(freedom, "load_case", lambda name: Case(name, POCKETS[name], approach=INTO))


@pytest.fixture(scope="module")
def rows():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(freedom, "load_case", lambda name: Case(name, POCKETS[name], approach=INTO))
        return run_freedom(list(POCKETS), planners=list(PLANNERS), workers=1)


@pytest.mark.parametrize("planner", PLANNERS)
@pytest.mark.parametrize("strategy", ["3d", "zigzag"])
def test_given_up_and_left_are_both_unreached(strategy, planner):
    plan = freedom_plan("undercut", strategy, planner)
    assert (plan.dof, plan.settings.method) == PLANNERS[planner]
    given_up = plan.modified.target & ~plan.accessible
    assert not (given_up & plan.left).any()
    assert not (unreached(plan) & ~plan.modified.target).any()
    row = freedom_row(plan)
    whole = plan.modified.target.sum()
    assert row["unreached_pct"] == pytest.approx(100 * unreached(plan).sum() / whole)
    assert row["unreached_pct"] == pytest.approx(row["inaccessible_pct"] + row["left_pct"])
    assert row["modified_final_over_initial_ratio"] == plan.left.sum() / plan.accessible.sum()
    assert row["milling_time_s"] == predict_milling(plan, FiveAxis.for_plan(plan)).time_s
    assert row["largest_tilt_deg"] <= 45 + 1e-6
    assert row["verified"]


@pytest.mark.parametrize("strategy", ["3d", "zigzag"])
def test_the_fifth_degree_reaches_more_under_an_overhang_and_no_less_without(rows, strategy):
    four, five, window = (freedom.of_planner(rows, strategy, planner) for planner in PLANNERS)
    column = "unreached_pct"
    assert five.loc[("undercut", 0.0), column] < four.loc[("undercut", 0.0), column]
    assert (five[column] <= four[column]).all()
    assert (five["inaccessible_pct"] == window["inaccessible_pct"]).all()  # the same start
    assert (five["largest_turn_deg"] <= 5 + 1e-6).all()


def test_turns_are_counted_between_points_and_time_by_a_robot_of_five_axes():
    plan = freedom_plan("open", "3d", "4 DOF")
    turn = np.deg2rad(freedom_row(plan)["total_turn_deg"])
    tilts = FiveAxis.for_plan(plan).inverse(plan.points, plan.axes)[:, 3]
    assert turn == pytest.approx(np.abs(np.diff(tilts)).sum())
    assert freedom_row(plan)["milling_time_s"] == pytest.approx(predict_milling(plan).time_s)


def test_bones_holes_and_planners_make_a_row_each(rows):
    assert len(rows) == 2 * 2 * 3
    assert list(rows["specimen"].unique()) == list(POCKETS)
    holes = run_freedom(["open"], ["5 DOF"], ["3d"], holes_mm=[7.0, 8.0], rim_mm=1.0, workers=1)
    assert list(holes["hole_mm"]) == [7.0, 8.0]
    assert holes["modified_target_cm3"].is_monotonic_increasing
    with pytest.raises(InputError, match="planner"):
        run_freedom(["open"], ["6 DOF"], workers=1)
    with pytest.raises(InputError, match="at least one bone"):
        run_freedom([])


def test_an_error_says_which_plan_it_was():
    with pytest.raises(Exception) as caught:
        freedom_plan("open", "3d", "5 DOF", hole_mm=2.0, rim_mm=3.0)
    assert caught.value.__notes__ == ["open, 3d, 5 DOF, hole 2 mm"]


def frame(four, five, window=None):
    """Rows of `run_freedom` with made-up numbers left, one bone each."""
    table = []
    for planner, values in zip(PLANNERS, (four, five, window or []), strict=True):
        for k, value in enumerate(values):
            table.append(
                {"specimen": f"CH{k:02d}", "hole_mm": 0.0, "strategy": "3d", "planner": planner}
                | {"unreached_pct": value, "modified_final_over_initial_ratio": value / 100}
                | {"bone_left_mm3": 1.0, "verified": True}
            )
    return pd.DataFrame(table)


def test_differences_are_paired_by_bone():
    rows = frame([1.0, 2.0, 4.0], [0.0, 2.0, 5.0]).sample(frac=1, random_state=1)
    row = differences(rows).loc[("3d", "unreached_pct")]
    assert (row["n"], row["less"], row["equal"], row["more"]) == (3, 1, 1, 1)
    assert row["difference"] == 0
    assert row["plus_minus"] == pytest.approx(4.302653 * 1.0 / np.sqrt(3), rel=1e-6)
    one = differences(frame([1.0], [0.5])).loc[("3d", "unreached_pct")]
    assert one["difference"] == -0.5 and np.isnan(one["plus_minus"])


def test_one_bone_against_it_breaks_the_claim_about_every_bone():
    holds = {c.text: c.holds for c in reach_claims(frame([1.0, 2.0], [1.0, 0.0]))}
    assert all(holds.values()) and len(holds) == 4
    broken = {c.text: c.holds for c in reach_claims(frame([1.0, 2.0], [1.01, 0.0]))}
    assert [text for text in holds if not broken[text]] == [
        "3-D: 5 DOF leave no more of the whole modified target unreached than 4 on any bone",
        "3-D: 5 DOF leave no more of the accessible modified target, the printed measure, than 4 on any bone",
    ]
    rows = frame([1.0], [1.0])
    rows.loc[0, "verified"] = False
    assert not reach_claims(rows)[-1].holds


def test_the_window_is_held_against_both_planners():
    holds = [c.holds for c in window_claims(frame([1.0, 1.0], [0.0, 0.0], [0.5, 0.6]))]
    assert holds == [False, False, True, True]
    assert not any(c.holds for c in window_claims(frame([1.0], [1.0], [1.0])))


# The printed tables


@pytest.fixture(scope="module")
def printed():
    return {
        dof: {s: published.corrected(PRINTED[s, dof]).set_index("specimen") for s in ("zigzag", "3d")}
        for dof in (4, 5)
    }


def test_rows_that_are_other_bones_are_not_paired(printed):
    a, b = same_bones(printed[4]["3d"], printed[5]["3d"])
    assert len(a) == len(b) == 33 and not set(published.OTHER_BONES) & set(a.index)
    column = "modified_initial_target_cm3"
    assert (b[column] <= a[column]).all()
    # The last of them shows why: it would be a bone of almost three times the size.
    everything = printed[5]["3d"][column] / printed[4]["3d"][column]
    assert everything.idxmax() == "CH19" and everything.max() > 2.5
    with pytest.raises(InputError, match="same specimens"):
        same_bones(printed[4]["3d"], printed[5]["3d"].iloc[1:])


def test_printed_rows_decide_the_texts_claims_as_the_audit_does(printed):
    claims = degree_claims(printed[4], printed[5], "printed")
    evidence = {c.text: (c.holds, c.evidence) for c in claims}
    assert len(evidence) == len(claims)
    close = [value for text, value in evidence.items() if "differ by less" in text]
    assert close == [(True, "-0.6 % from 4 to 5 DOF"), (True, "-2.3 % from 4 to 5 DOF")]
    equal = [value for text, value in evidence.items() if "I5" in text]
    assert [holds for holds, _ in equal] == [False, False]
    assert all("18 bones; +1." in told for _, told in equal)
    (holds, told), *_ = [value for text, value in evidence.items() if "1.7e-2" in text]
    assert holds and told.startswith("less in 2, equal in 10, more in 21 of 33")
    (holds, told), *_ = [value for text, value in evidence.items() if "60592 s" in text]
    assert holds and "times" in told


def test_swapping_the_planners_turns_the_printed_claims_around(printed):
    forth = {c.text: c.holds for c in degree_claims(printed[4], printed[5], "printed")}
    back = {c.text: c.holds for c in degree_claims(printed[5], printed[4], "printed")}
    turned = [text for text in forth if "takes longer" in text or "no smaller" in text or "1.7e-2" in text]
    assert len(turned) == 5
    assert all(forth[text] != back[text] for text in turned)


# The overhang


def test_an_undercut_protects_the_rim_and_leaves_a_round_hole():
    volume = small_cone()
    other = undercut(volume, rim_mm=1.2, hole_mm=5.0)
    changed = volume.labels != other.labels
    assert (volume.labels[changed] == 2).all() and (other.labels[changed] == 1).all()
    target = np.argwhere(volume.mask("target"))
    depth = (target[:, 0] - target[:, 0].min()) * 0.4
    aside = np.linalg.norm((target - np.median(target, axis=0))[:, 1:] * 0.4, axis=1)
    np.testing.assert_array_equal(changed[tuple(target.T)], (depth < 1.2 - 1e-9) & (aside > 2.5))
    assert changed.any()
    # a volume in which everything else is protected without a label of that name
    nameless = LabelVolume(volume.labels, volume.affine, {"air": 0, "bone": 1, "target": 2})
    np.testing.assert_array_equal(undercut(nameless, 1.2, 5.0).mask("target"), other.mask("target"))
    for sizes in ({"rim_mm": 0.0}, {"hole_mm": -1.0}, {"hole_mm": np.nan}):
        with pytest.raises(InputError, match=next(iter(sizes))):
            undercut(volume, **sizes)


# Pictures


def test_pictures_name_their_units(rows):
    columns = {"unreached_pct": "Never reached", "milling_time_s": "Time"}
    for figure in (plots.bone_by_bone(rows, columns), plots.over_holes(rows, columns)):
        assert [ax.get_ylabel() for ax in figure.axes] == ["unreached (%)", "milling time (s)"]
        assert all(ax.get_xlabel().endswith(")") for ax in figure.axes)
        assert all(ax.get_ylim()[0] == 0 for ax in figure.axes)
        assert len(figure.legends[0].get_texts()) == 6


def test_pictures_of_plans(rows):
    plans = {dof: freedom_plan("undercut", "3d", dof) for dof in ("4 DOF", "5 DOF")}
    figure = plots.bone_left(plans)
    assert [ax.get_title(loc="left").split(":")[0] for ax in figure.axes] == list(plans)
    # the plane shows what only the second plan reaches
    shown = [ax.images[0].get_array() for ax in figure.axes]
    assert (shown[0] != shown[1]).any()
    figure = plots.shaft_directions(plans)
    four, five = (np.vstack([c.get_offsets() for c in ax.collections]) for ax in figure.axes)
    assert min(np.ptp(four, axis=0)) < 1e-6  # a line
    assert min(np.ptp(five, axis=0)) > 5
    for plan, there in zip(plans.values(), (four, five), strict=True):
        tilt = np.rad2deg(np.arccos(np.clip(-(plan.axes @ plan.approach), -1, 1)))
        assert np.linalg.norm(there, axis=1).max() == pytest.approx(tilt.max(), abs=1e-3)


def test_printed_and_our_paths_are_compared_bone_by_bone(printed):
    every = {(s, dof): printed[dof][s] for s in ("zigzag", "3d") for dof in (4, 5)}
    figure = plots.degree_ratios(every, every)
    assert [len(c.get_offsets()) for c in figure.axes[0].collections] == [36, 36]
    assert figure.axes[0].get_ylabel() == "path length, 5 DOF / 4 DOF"
