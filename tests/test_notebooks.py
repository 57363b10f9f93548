"""Every stage's notebook runs from start to end and makes what ``dvc.yaml`` says it makes."""

import shlex
import time
from pathlib import Path

import pytest
import yaml
from nbclient import NotebookClient
from papermill.iorw import load_notebook_node
from papermill.parameterize import parameterize_notebook

from study.batch import (
    checked_parameters,
    combinations,
    command_line,
    declared_parameters,
    private_connection,
)
from study.paths import PROJECT
from study.profiles import profile_parameters

STAGES = yaml.safe_load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]


def runs_of(stage):
    """Notebook of a stage's command, and the parameters of each of its runs."""
    given = command_line().parse_args(shlex.split(stage["cmd"])[3:])
    return given.notebook, [{**dict(given.parameters), **values} for values in combinations(given.each)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """One folder for all stages, in the order of the pipeline: a later one reads what an earlier one made."""
    return tmp_path_factory.mktemp("figures")


def run(path, parameters, folder):
    node = load_notebook_node(str(path))
    given = {**profile_parameters(path.stem, "test"), **parameters, "output_dir": str(folder)}
    values = checked_parameters(declared_parameters(node, path.name), given, path.name)
    node = parameterize_notebook(node, values, kernel_name="python3", language="python")
    with private_connection() as config:
        client = NotebookClient(
            node,
            kernel_name="python3",
            timeout=300,
            resources={"metadata": {"path": str(PROJECT)}},
            config=config,
        )
        client.execute()


@pytest.mark.notebook
@pytest.mark.parametrize("name", [name for name in STAGES if name != "prepare"])
def test_notebook_makes_the_outputs_of_its_stage(name, folder):
    notebook, runs = runs_of(STAGES[name])
    begun = time.time()
    for parameters in runs:
        run(PROJECT / notebook, parameters, folder)
    expected = {Path(file).name for out in STAGES[name]["outs"] for file in out}
    fresh = {
        file.name for file in folder.iterdir() if file.stat().st_mtime >= begun and file.stat().st_size > 0
    }
    assert expected <= fresh, "the stage promises more than its notebook writes"
    assert fresh <= expected, "the notebook writes what the stage does not say"
