"""The pipeline, the manifest and the notebooks say the same, and the batch runner says no when it should."""

import ast
import multiprocessing
import os
import shlex
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import nbformat
import parallel
import pytest
import yaml
from IPython.core.inputtransformer2 import TransformerManager
from numba.core.caching import IndexDataCacheFile

from study import prepare
from study.batch import (
    checked_parameters,
    combinations,
    command_line,
    declared_parameters,
    main,
    run_notebook,
)
from study.errors import FileFormatError, InputError, StudyError
from study.manifest import read_manifest
from study.paths import PROJECT
from study.profiles import chosen_profile, profile_parameters

NOTEBOOKS = sorted((PROJECT / "notebooks").glob("*.ipynb"))
STAGES = yaml.safe_load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]
PROFILES = yaml.safe_load((PROJECT / "params.yaml").read_text(encoding="utf-8"))
MANIFEST = read_manifest()
NOTEBOOK_STAGES = {name: stage for name, stage in STAGES.items() if name != "prepare"}
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
each_stage = pytest.mark.parametrize("name", NOTEBOOK_STAGES)


def outputs(stage):
    """Names of a stage's outputs below figures/, and the settings of each."""
    return {Path(path).name: options for out in stage["outs"] for path, options in out.items()}


def command_of(stage):
    """The arguments of a stage's command, as the batch runner reads them."""
    words = shlex.split(stage["cmd"])
    assert words[:3] == ["python", "-m", "study.batch"]
    return command_line().parse_args(words[3:])


def notebook_of(stage):
    return command_of(stage).notebook


# The manifest


@pytest.mark.parametrize("row", list(MANIFEST.itertuples()), ids=lambda row: row.item)
def test_item_is_regenerated_if_the_manifest_says_so(row):
    made = {name: notebook_of(stage) for stage in NOTEBOOK_STAGES.values() for name in outputs(stage)}
    if row.status == "here":
        assert row.outputs, f"{row.item} is here but names no output"
        assert (PROJECT / "notebooks" / row.notebook).is_file()
        for name in row.outputs:
            assert made.get(name) == f"notebooks/{row.notebook}", f"no stage of {row.notebook} makes {name}"
    else:
        assert row.outputs == [] and row.notebook == ""


@pytest.mark.skipif(not NOTEBOOKS, reason="no notebook yet")
def test_manifest_lists_every_table_and_figure_of_chapter_2_and_every_printed_table():
    expected = {f"Table 2.{k}" for k in range(1, 4)} | {f"Figure 2.{k}" for k in range(1, 22)}
    expected |= {f"Table A.{k}" for k in range(1, 5)} | {f"Table B.{k}" for k in range(1, 10)}
    expected |= {"Table 3.2", "Table 4.2", "Baron 1", "Baron absolute accuracy"}
    expected |= {f"Baron figure {number}" for number in (7, 9, 10, 12)}
    assert expected <= set(MANIFEST["item"])


def test_every_notebook_and_output_is_in_the_manifest():
    listed = {name for names in MANIFEST["outputs"] for name in names}
    made = {name for stage in NOTEBOOK_STAGES.values() for name in outputs(stage)}
    assert made == listed
    assert {path.name for path in NOTEBOOKS} == set(MANIFEST["notebook"]) - {""}


# The notebooks as committed


@each_notebook
def test_notebook_is_committed_without_outputs(path):
    node = nbformat.read(path, as_version=nbformat.NO_CONVERT)
    nbformat.validate(node)
    assert (node.nbformat, node.nbformat_minor) == (4, 5)
    assert node.metadata.kernelspec.name == "python3"
    ids = [cell.id for cell in node.cells]
    assert len(set(ids)) == len(ids)
    for cell in node.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None


@each_notebook
def test_notebook_starts_with_its_parameters_and_can_write_elsewhere(path):
    node = nbformat.read(path, as_version=4)
    first = next(cell for cell in node.cells if cell.cell_type == "code")
    assert "parameters" in first.metadata.get("tags", [])
    assert declared_parameters(node)["output_dir"] == ""


@each_notebook
def test_notebook_holds_no_algorithm(path):
    """A function or a loop of more than a few lines belongs to the package, where it is tested."""
    node = nbformat.read(path, as_version=4)
    for cell in node.cells:
        if cell.cell_type == "code":
            for item in ast.walk(ast.parse(TransformerManager().transform_cell(cell.source))):
                assert not isinstance(item, ast.ClassDef | ast.While), cell.source
                if isinstance(item, ast.FunctionDef | ast.For):
                    assert item.end_lineno - item.lineno < 12, cell.source


# The pipeline


def test_the_first_stage_names_the_profile_and_always_runs():
    assert STAGES["prepare"]["always_changed"]
    assert set(outputs(STAGES["prepare"])) == {"profile.txt", "kernels.txt"}


@each_stage
def test_stage_depends_on_all_it_reads_and_keeps_nothing_in_a_cache(name):
    stage = NOTEBOOK_STAGES[name]
    stem = Path(notebook_of(stage)).stem
    assert {notebook_of(stage), "study", "data", "figures/profile.txt", "figures/kernels.txt"} <= set(
        stage["deps"]
    )
    assert set(stage["params"]) == {f"quick.{stem}", f"full.{stem}"}
    given = command_of(stage)
    copies = [given.output.format(**values) for values in combinations(given.each)]
    assert len(set(copies)) == len(copies)
    assert all(copy.startswith(f"figures/executed/{name}") for copy in copies)
    assert given.each or copies == [f"figures/executed/{name}.ipynb"]
    for output, options in outputs(stage).items():
        assert options["cache"] is False
        assert Path(output).suffix in {".csv", ".json", ".png", ".gif", ".vtp", ".nrrd"}


def test_dvc_understands_the_pipeline_without_git():
    command = [sys.executable, "-m", "dvc", "stage", "list", "--name-only"]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) == set(STAGES)
    assert "no_scm = true" in (PROJECT / ".dvc" / "config").read_text(encoding="utf-8")


def test_stages_that_read_each_others_tables_are_tested_by_one_worker_in_their_order():
    groups = {name: parallel.group(f"tests/test_notebooks.py::test_runs[{name}]") for name in NOTEBOOK_STAGES}
    seen = {}
    for name, stage in NOTEBOOK_STAGES.items():
        for path in stage["deps"]:
            maker = seen.get(Path(path).name)
            assert maker is None or groups[maker] == groups[name]
            assert maker or not path.endswith((".csv", ".json", ".png", ".vtp", ".nrrd"))
        seen |= dict.fromkeys(outputs(stage), name)
    assert groups["appendix_a"] == groups["table_2_2"] != groups["published_audit"]
    assert len(set(groups.values())) > 1


def test_no_two_stages_share_an_output():
    names = [name for stage in STAGES.values() for name in outputs(stage)]
    assert len(names) == len(set(names))


@each_notebook
@pytest.mark.parametrize("profile", ["quick", "full", "test"])
def test_profile_gives_only_parameters_that_the_notebook_has(path, profile):
    assert path.stem in PROFILES[profile], f"{profile} says nothing about {path.stem}, not even {{}}"
    declared = declared_parameters(nbformat.read(path, as_version=4), path.name)
    checked_parameters(declared, profile_parameters(path.stem, profile), path.name)


@pytest.mark.parametrize("profile", PROFILES)
def test_notebooks_that_share_rows_take_the_same_specimens(profile):
    """Otherwise one stage would replace the rows that another one made."""
    notebooks = {
        Path(notebook_of(stage)).stem
        for stage in NOTEBOOK_STAGES.values()
        if any(Path(path).name.startswith("appendix_a_") for path in [*stage["deps"], *outputs(stage)])
    }
    asked = {
        profile_parameters(name, profile).get("specimens", default)
        for name in notebooks
        for key, default in declared_parameters(
            nbformat.read(PROJECT / "notebooks" / f"{name}.ipynb", as_version=4)
        ).items()
        if key == "specimens"
    }
    assert len(asked) <= 1


def test_profile_without_its_notebook_is_an_error():
    for profile, notebooks in PROFILES.items():
        assert set(notebooks) <= {path.stem for path in NOTEBOOKS}, profile


def test_profile_comes_from_the_environment(monkeypatch):
    monkeypatch.delenv("STUDY_PROFILE", raising=False)
    assert chosen_profile() == "quick"
    monkeypatch.setenv("STUDY_PROFILE", "full")
    assert chosen_profile() == "full"
    monkeypatch.setenv("STUDY_PROFILE", "fast")
    with pytest.raises(InputError, match=r"fast.*quick, full, test"):
        chosen_profile()


def kernels_called_from_python():
    """Full names of the kernels that plain Python modules import or name after their module."""
    found = set()
    for file in sorted((PROJECT / "study").rglob("*.py")):
        if file.stem.startswith("_kernels"):
            continue
        tree = ast.parse(file.read_text(encoding="utf-8"))
        modules = {}
        for item in ast.walk(tree):
            if isinstance(item, ast.ImportFrom) and item.module:
                for name in item.names:
                    if item.module.rpartition(".")[2].startswith("_kernels"):
                        found.add(f"{item.module}.{name.name}")
                    elif name.name.startswith("_kernels"):
                        modules[name.asname or name.name] = f"{item.module}.{name.name}"
        for item in ast.walk(tree):
            if (
                isinstance(item, ast.Attribute)
                and isinstance(item.value, ast.Name)
                and item.value.id in modules
            ):
                found.add(f"{modules[item.value.id]}.{item.attr}")
    return found


def test_preparing_compiles_every_kernel():
    """A kernel that `warm` leaves out would be compiled by several workers at once."""
    code = """
import importlib, sys
from study.prepare import warm

warm()
for name in sys.argv[1:]:
    module, _, kernel = name.rpartition(".")
    dispatcher = getattr(importlib.import_module(module), kernel)
    if hasattr(dispatcher, "signatures") and not dispatcher.signatures:
        print(name)
"""
    names = sorted(kernels_called_from_python())
    assert names
    done = subprocess.run([sys.executable, "-c", code, *names], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_two_processes_compile_together_what_one_would(monkeypatch):
    class Process:
        exitcode = 0
        join = start = lambda self: None

        def __init__(self, target, args):
            target(*args)

    done = []
    once = ("warm_checks", "warm_margins", "warm_surface", "warm_guidance", "warm_fixtures")
    for name in ("warm_planning", *once):
        monkeypatch.setattr(
            prepare,
            name,
            lambda name=name, **chosen: done.extend(product([name], chosen.get("degrees", [0]))),
        )
    monkeypatch.setattr(multiprocessing.get_context("spawn"), "Process", Process)
    monkeypatch.setattr(IndexDataCacheFile, "save", IndexDataCacheFile.save)  # put back at the end
    prepare.warm_side_by_side()
    planning = {("warm_planning", dof) for dof in prepare.DEGREES_OF_FREEDOM}
    assert len(done) == len(planning) + len(once)
    assert set(done) == planning | {(name, 0) for name in once}
    Process.exitcode = 3
    with pytest.raises(StudyError, match="ended with 3"):
        prepare.warm_side_by_side()


def test_numbas_lists_of_what_is_compiled_are_written_by_one_at_a_time(monkeypatch):
    saving, most = [], []

    def save(self, key, data):
        saving.append(key)
        time.sleep(0.01)
        most.append(len(saving))
        saving.remove(key)

    def in_threads():
        most.clear()
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda key: IndexDataCacheFile.save(None, key, b""), range(8)))
        return max(most)

    monkeypatch.setattr(IndexDataCacheFile, "save", save)
    assert in_threads() > 1
    prepare.take_turns(threading.Lock())
    assert in_threads() == 1


# The batch runner


def write_notebook(path, *sources, tags=("parameters",)):
    cells = [nbformat.v4.new_code_cell(source) for source in sources]
    cells[0].metadata["tags"] = list(tags)
    nbformat.write(nbformat.v4.new_notebook(cells=cells), path)
    return path


@pytest.mark.notebook
def test_batch_runs_in_the_project_whatever_the_working_directory(tmp_path, monkeypatch):
    write_notebook(
        tmp_path / "where.ipynb",
        'output_dir = ""\nscale = 1.0',
        "import os, pathlib\nwhere = pathlib.Path(output_dir, 'where.txt')\n"
        "_ = where.write_text('\\n'.join([os.getcwd(), repr(scale), os.environ['STUDY_BATCH']]))",
    )
    monkeypatch.chdir(tmp_path)
    arguments = [
        "where.ipynb",
        "-p",
        "output_dir",
        str(tmp_path),
        "-p",
        "scale",
        "3",
        "--output",
        "done.ipynb",
    ]
    assert main(arguments) == 0
    assert (tmp_path / "where.txt").read_text().split("\n") == [str(PROJECT), "3.0", "1"]
    done = nbformat.read(tmp_path / "done.ipynb", as_version=4)
    assert all(cell.execution_count for cell in done.cells if cell.cell_type == "code")


@pytest.mark.notebook
def test_batch_runs_each_combination_and_says_when_one_of_them_fails(tmp_path, capfd):
    notebook = write_notebook(
        tmp_path / "n.ipynb",
        "x = 0\ny = 'a'\nz = 1.0",
        "import os; os.environ['STUDY_WORKERS'], x, y, z",
        "assert (x, y) != (2, 'c')",
    )
    arguments = [str(notebook), "--each", "x", "1", "2", "--each", "y", "b", "c", "-p", "z", "5"]
    assert main([*arguments, "--output", str(tmp_path / "{x}{y}.ipynb")]) == 1
    assert "AssertionError" in capfd.readouterr().err
    for x, y in ((1, "b"), (1, "c"), (2, "b"), (2, "c")):
        done = nbformat.read(tmp_path / f"{x}{y}.ipynb", as_version=4)
        said = [
            out.data["text/plain"] for cell in done.cells for out in cell.get("outputs", []) if "data" in out
        ]
        assert said == [str(("1", x, y, 5.0))]
    with pytest.raises(SystemExit):
        main([*arguments, "--output", str(tmp_path / "{x}.ipynb")])
    assert "expected {y} in --output" in capfd.readouterr().err


@pytest.mark.notebook
def test_batch_fails_with_the_traceback_of_the_cell(tmp_path, capsys):
    notebook = write_notebook(tmp_path / "fails.ipynb", "x = 1", "raise ArithmeticError(f'x is {x}')")
    assert main([str(notebook), "-p", "x", "7", "--output", str(tmp_path / "done.ipynb")]) == 1
    assert "ArithmeticError: x is 7" in capsys.readouterr().err


def test_batch_refuses_a_parameter_that_the_notebook_does_not_declare(tmp_path, capsys):
    notebook = write_notebook(tmp_path / "n.ipynb", "strategy = '3d'", "1 / 0")
    output = tmp_path / "done.ipynb"
    with pytest.raises(InputError, match=r"n\.ipynb has no parameter 'stratgy'; it has: strategy"):
        run_notebook(notebook, {"stratgy": "zigzag"}, output=output)
    assert main([str(notebook), "-p", "stratgy", "zigzag", "--output", str(output)]) == 2
    assert "stratgy" in capsys.readouterr().err
    assert not output.exists()


def test_batch_refuses_what_is_no_notebook(tmp_path):
    with pytest.raises(InputError, match=r"found no file missing\.ipynb"):
        run_notebook("missing.ipynb")
    (tmp_path / "broken.ipynb").write_text("{")
    with pytest.raises(FileFormatError, match=r"broken\.ipynb: expected a Jupyter notebook"):
        run_notebook(tmp_path / "broken.ipynb")
    with pytest.raises(FileFormatError, match="one code cell tagged 'parameters', found 0"):
        run_notebook(write_notebook(tmp_path / "n.ipynb", "x = 1", tags=()))
    with pytest.raises(FileFormatError, match=r"expected `name = literal`.*x = f\(\)"):
        run_notebook(write_notebook(tmp_path / "n.ipynb", "x = f()"))


@pytest.mark.parametrize(
    ("default", "given", "taken"),
    [
        (4, "5", 5),
        (1.0, "2", 2.0),
        (1.0, "1e-3", 1e-3),
        ("", "3", "3"),
        (False, "True", True),
        (["CH01"], "['TB02', 'TB03']", ["TB02", "TB03"]),
    ],
)
def test_values_of_the_command_line_get_the_kind_of_the_default(default, given, taken):
    value = checked_parameters({"x": default}, {"x": given})["x"]
    assert value == taken and type(value) is type(taken)


@pytest.mark.parametrize(
    ("default", "given"), [(4, "five"), (4, 4.5), (4, True), (1.0, "a b"), (True, 1), ("a", 3)]
)
def test_values_of_another_kind_are_refused(default, given):
    with pytest.raises(InputError, match=f"expected x to be {type(default).__name__}"):
        checked_parameters({"x": default}, {"x": given})


def test_unknown_profile_is_refused():
    with pytest.raises(InputError, match="no profile 'fast'; it has: quick, full, test"):
        profile_parameters("table_2_2", "fast")


@pytest.mark.notebook
@pytest.mark.skipif(os.name == "nt", reason="only TCP there")
def test_two_runs_at_the_same_time_do_not_take_each_others_kernel(tmp_path):
    notebook = write_notebook(
        tmp_path / "n.ipynb", "x = 0", "import pathlib; _ = pathlib.Path(str(x)).exists()"
    )
    command = [sys.executable, "-m", "study.batch", str(notebook)]
    runs = [
        subprocess.Popen([*command, "-p", "x", str(k), "--output", str(tmp_path / f"{k}.ipynb")])
        for k in range(2)
    ]
    assert [run.wait(timeout=120) for run in runs] == [0, 0]
