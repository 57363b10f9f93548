"""Running the planners over the catalogue, and taking rows up again."""

import os
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from study import published
from study.errors import FileFormatError, InputError, PlanningError, PlanViolation
from study.experiments import appendix
from study.planners import Plan
from study.prepare import tiny_volume
from study.tables import save_table
from study.threads import usual_workers

NAMES = [f"CH{k:02d}" for k in range(1, 20)] + [f"TB{k:02d}" for k in range(1, 18)]


@pytest.fixture
def tiny(monkeypatch):
    """A catalogue whose specimens are all one small block of bone, the last but one without a target."""

    def specimen(name):
        volume = tiny_volume()
        if name == "TB16":
            volume = volume.with_labels(np.minimum(volume.labels, 1))
        return SimpleNamespace(planning=volume)

    monkeypatch.setattr(appendix, "catalogue", lambda: NAMES)
    monkeypatch.setattr(appendix, "specimen", specimen)


@pytest.mark.parametrize(
    ("asked", "names"),
    [
        ("all", NAMES),
        ("TB01, CH02", ["CH02", "TB01"]),
        ("CH02 TB01", ["CH02", "TB01"]),
        ("2", ["CH01", "TB17"]),
        ("36", NAMES),
        ("1", ["CH01"]),
    ],
)
def test_specimens_are_chosen_by_name_or_number(tiny, asked, names):
    assert appendix.select_specimens(asked) == names


@pytest.mark.parametrize("asked", ["", "0", "37", "CH20", "CH01; CH02", "most"])
def test_what_is_no_choice_of_specimens_is_refused(tiny, asked):
    with pytest.raises(InputError, match="specimens"):
        appendix.select_specimens(asked)


@pytest.mark.parametrize("dof", [4, 5])
@pytest.mark.parametrize("strategy", ["3d", "zigzag"])
def test_rows_have_the_printed_columns_in_the_order_asked(tiny, strategy, dof):
    rows = appendix.run_appendix(["TB01", "CH01"], strategy, dof, workers=1)
    assert list(rows.index) == ["TB01", "CH01"]
    printed = list(published.table(appendix.PRINTED[strategy, dof]).columns)
    assert list(rows) == [*printed[1:], "verified", "strategy", "dof", "seed"]
    assert rows["verified"].all()
    if dof == 5:  # no robot in print, none here
        return
    assert (rows["milling_path_length_mm"] <= rows["predicted_path_length_mm"]).all()
    speed = rows["milling_path_length_mm"] / rows["predicted_milling_time_s"]
    np.testing.assert_allclose(rows["average_milling_speed_mm_per_s"], speed)


def test_a_plan_that_fails_its_replay_is_marked(tiny, monkeypatch):
    def fails(plan):
        raise PlanViolation("as if")

    monkeypatch.setattr(Plan, "verify", fails)
    assert not appendix.run_appendix(["CH01"], workers=1)["verified"].any()


def test_an_error_names_the_specimen(tiny):
    with pytest.raises(PlanningError) as caught:
        appendix.run_appendix(["CH01", "TB16"], workers=1)
    assert "specimen TB16, 3d" in caught.value.__notes__[0]
    with pytest.raises(InputError, match="at least one"):
        appendix.run_appendix([])
    with pytest.raises(InputError, match="strategy"):
        appendix.run_appendix(["CH01"], "spiral")


def test_rows_are_taken_up_again_only_if_they_are_the_ones_asked_for(tiny, tmp_path, monkeypatch):
    rows = appendix.run_appendix(["CH01", "CH02", "CH03"], workers=1)
    save_table(rows, tmp_path / appendix.appendix_file("3d"), index=True)
    runs = []

    def run(names, strategy, dof, workers, seed):
        runs.append((tuple(names), strategy, seed))
        return rows.loc[[]]

    monkeypatch.setattr(appendix, "run_appendix", run)
    kept = appendix.appendix_rows(["CH03", "CH01"], "3d", folder=tmp_path)
    pd.testing.assert_frame_equal(
        kept, rows.loc[["CH03", "CH01"]], check_exact=False, check_dtype=False, rtol=1e-6
    )
    assert runs == []
    appendix.appendix_rows(["CH01", "CH04"], "3d", folder=tmp_path)
    appendix.appendix_rows(["CH01"], "3d", folder=tmp_path, seed=1)
    appendix.appendix_rows(["CH01"], "zigzag", folder=tmp_path)
    assert runs == [(("CH01", "CH04"), "3d", 0), (("CH01",), "3d", 1), (("CH01",), "zigzag", 0)]
    (tmp_path / appendix.appendix_file("3d")).write_text("a,b\n1,2\n")
    with pytest.raises(FileFormatError, match="appendix_a_3d_4dof"):
        appendix.appendix_rows(["CH01"], "3d", folder=tmp_path)


def test_processes_give_the_order_asked_for():
    names = [f"{k:03d}" for k in range(7)]
    assert appendix.over_specimens(int, names, workers=1) == list(range(7))
    assert appendix.over_specimens(int, names, workers=2) == list(range(7))


def test_processes_are_as_many_as_the_environment_says(monkeypatch):
    monkeypatch.delenv("STUDY_WORKERS", raising=False)
    assert usual_workers() == min(2, os.cpu_count())
    monkeypatch.setenv("STUDY_WORKERS", "1")
    pids = appendix.over_specimens(_process, range(3))
    assert set(pids) == {os.getpid()}
    monkeypatch.setenv("STUDY_WORKERS", "some")
    with pytest.raises(InputError, match=r"STUDY_WORKERS.*at least 1, got 'some'"):
        usual_workers()


def _process(_):
    return os.getpid()
