"""Every stage's notebook runs from start to end and makes what ``dvc.yaml`` says it makes."""

import shlex
from pathlib import Path

import pytest
import yaml
from nbclient import NotebookClient
from papermill.iorw import load_notebook_node
from papermill.parameterize import parameterize_notebook

from study.batch import (
    checked_parameters,
    declared_parameters,
    private_connection,
    profile_parameters,
)
from study.paths import PROJECT

STAGES = yaml.safe_load((PROJECT / "dvc.yaml").read_text(encoding="utf-8"))["stages"]


def command_of(stage):
    """Notebook and ``-p`` parameters of a stage's command."""
    words = shlex.split(stage["cmd"])[3:]
    flags = [k for k, word in enumerate(words) if word == "-p"]
    return words[0], {words[k + 1]: words[k + 2] for k in flags}


@pytest.mark.notebook
@pytest.mark.parametrize("name", [name for name in STAGES if name != "prepare"])
def test_notebook_makes_the_outputs_of_its_stage(name, tmp_path):
    notebook, parameters = command_of(STAGES[name])
    path = PROJECT / notebook
    node = load_notebook_node(str(path))
    given = {**profile_parameters(path.stem, "test"), **parameters, "output_dir": str(tmp_path)}
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
    expected = {Path(file).name for out in STAGES[name]["outs"] for file in out}
    assert expected <= {file.name for file in tmp_path.iterdir() if file.stat().st_size > 0}
