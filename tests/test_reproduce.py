"""Stages run side by side: none before those that it waits for, and dvc agrees that all is up to date."""

import subprocess
import sys
import threading
import time

import pytest

from study import reproduce
from study.errors import InputError
from study.paths import PROJECT
from study.reproduce import read_stages, run_in_order, run_stage
from study.threads import in_threads

CHAIN = {"first": set(), "a": {"first"}, "b": {"first"}, "after a": {"a"}, "c": {"first"}, "last": {"b", "c"}}


@pytest.mark.parametrize("workers", [1, 2, 3])
def test_stage_waits_for_those_whose_outputs_it_reads_and_uses_all_workers(workers):
    running, most, ended, guard = set(), [], [], threading.Lock()

    def run(name):
        with guard:
            assert CHAIN[name] <= set(ended)
            running.add(name)
            most.append(len(running))
        time.sleep(0.03)
        with guard:
            running.remove(name)
            ended.append(name)
        return 0

    assert run_in_order(CHAIN, run, workers) == []
    assert sorted(ended) == sorted(CHAIN)
    assert max(most) == workers


def test_after_a_failure_no_stage_begins():
    begun = []

    def run(name):
        begun.append(name)
        return int(name == "a")

    assert run_in_order(CHAIN, run, 1) == ["a"]
    assert begun == ["first", "a"]


def test_stages_that_wait_for_each_other_are_an_error():
    with pytest.raises(InputError, match="x, y cannot"):
        run_in_order({"first": set(), "x": {"y"}, "y": {"x"}}, lambda name: 0, 2)


def test_stages_and_their_order_are_those_of_the_pipeline():
    stages = read_stages()
    assert stages["prepare"] == set()
    assert all("prepare" in waits for name, waits in stages.items() if name != "prepare")
    assert "appendix_a" in stages["table_2_2"]
    assert "appendix_a" not in stages["published_audit"]


PIPELINE = """
stages:
  left:
    cmd: PYTHON wait.py left right
    deps: [wait.py]
    outs: [{left.csv: {cache: false}}]
  right:
    cmd: PYTHON wait.py right left
    deps: [wait.py]
    outs: [{right.csv: {cache: false}}]
  both:
    cmd: cat left.csv right.csv > both.csv && echo $STUDY_WORKERS >> both.csv
    deps: [left.csv, right.csv]
    outs: [{both.csv: {cache: false}}]
"""
#: Each of two stages goes on when the other one has begun, and so needs it beside itself.
WAIT = """
import pathlib, sys, time

me, other = sys.argv[1:]
pathlib.Path(me + ".begun").touch()
end = time.monotonic() + 60
while not pathlib.Path(other + ".begun").exists():
    assert time.monotonic() < end, "the other stage never began"
    time.sleep(0.05)
pathlib.Path(me + ".csv").write_text(me + "\\n")
"""


def test_dvc_lets_stages_run_side_by_side_and_finds_them_up_to_date(tmp_path):
    (tmp_path / ".dvc").mkdir()
    (tmp_path / ".dvc" / "config").write_text((PROJECT / ".dvc" / "config").read_text())
    (tmp_path / "dvc.yaml").write_text(PIPELINE.replace("PYTHON", sys.executable))
    (tmp_path / "wait.py").write_text(WAIT)
    stages = read_stages(tmp_path / "dvc.yaml")
    assert run_in_order(stages, lambda name: run_stage(name, 1, tmp_path), 2) == []
    assert (tmp_path / "both.csv").read_text().split() == ["left", "right", "1"]
    done = subprocess.run(
        [sys.executable, "-m", "dvc", "status", "--quiet"], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    (tmp_path / "left.csv").unlink()
    (tmp_path / "right.begun").unlink()
    (tmp_path / "wait.py").write_text("raise SystemExit(3)")
    assert run_in_order(stages, lambda name: run_stage(name, 1, tmp_path), 1) == ["left"]


@pytest.mark.parametrize(("profile", "expected"), [("quick", (3, 1)), ("full", (1, 0)), ("test", (3, 1))])
def test_full_profile_leaves_all_cores_to_one_stage(monkeypatch, profile, expected):
    monkeypatch.setenv("STUDY_PROFILE", profile)
    monkeypatch.setenv("STUDY_WORKERS", "3")
    seen = []
    monkeypatch.setattr(reproduce, "run_stage", lambda name, cores: seen.append(cores) or 0)
    monkeypatch.setattr(
        reproduce, "run_in_order", lambda stages, run, together: [] if run("x") else seen.append(together)
    )
    assert reproduce.main() == 0
    assert (seen[1], seen[0]) == expected


def test_unknown_profile_is_refused_before_anything_runs(monkeypatch, capsys):
    monkeypatch.setenv("STUDY_PROFILE", "fast")
    monkeypatch.setattr(reproduce, "run_stage", None)
    assert reproduce.main() == 2
    assert "STUDY_PROFILE=fast" in capsys.readouterr().err


def test_threads_are_as_many_as_asked(monkeypatch):
    def threads():
        names = []

        def part(piece):
            time.sleep(0.02)
            names.append(threading.current_thread().name)

        in_threads(part, 4, least=1)
        return len(names)

    monkeypatch.setenv("STUDY_WORKERS", "1")
    assert threads() == 1
    monkeypatch.setenv("STUDY_WORKERS", "3")
    assert threads() == 3
