"""Run one notebook from start to end, without anybody watching.

``python -m study.batch notebooks/table_2_2.ipynb --profile full -p specimens "CH01 CH02"``

The notebook's parameters come from its own ``parameters`` cell, then from the profile in
``params.yaml``, then from ``-p``. A parameter that the notebook does not declare is an error: papermill
alone would warn and run the notebook with its default, which looks like success.

``--each strategy zigzag 3d --each dof 4 5`` runs it once for every combination, as many side by side as
`study.threads.usual_workers` says; then ``--output`` names the parameters:
``figures/executed/appendix_a_{strategy}_{dof}dof.ipynb``.
"""

from __future__ import annotations

import argparse
import ast
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from itertools import product
from pathlib import Path
from typing import Any

# nbformat imports jsonschema, and that, where it is installed, a package that spends more than a second on a
# grammar of web addresses, in which notebooks are not checked. It does without when the import fails.
sys.modules.setdefault("rfc3987_syntax", None)

import nbformat  # noqa: E402
import papermill  # noqa: E402
from papermill.exceptions import PapermillExecutionError  # noqa: E402
from traitlets.config import Config  # noqa: E402

from study.errors import FileFormatError, InputError, StudyError  # noqa: E402
from study.paths import PROJECT  # noqa: E402
from study.profiles import profile_parameters  # noqa: E402
from study.threads import WORKERS_VARIABLE, usual_workers  # noqa: E402

EXECUTED = PROJECT / "figures" / "executed"
"""Folder of the executed copies; they are for reading and no result depends on them."""

ENVIRONMENT = {
    "STUDY_BATCH": "1",  # study.rendering draws static pictures off screen
    "PYVISTA_OFF_SCREEN": "true",
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",  # a user's own choice may need a screen
    "TQDM_DISABLE": "1",
    "JUPYTER_PREFER_ENV_PATH": "1",  # the kernel of this environment, not one of the same name at home
}
"""What a batch run sets for its kernel."""


def declared_parameters(notebook: nbformat.NotebookNode, name: str = "notebook") -> dict[str, Any]:
    """Return the parameters that a notebook declares, with their defaults.

    Parameters
    ----------
    notebook : nbformat.NotebookNode
        A notebook with one code cell tagged ``parameters``, which holds plain assignments of literals.
    name : str
        What to call the notebook in an error message.

    Returns
    -------
    dict of str to object
        Default of every parameter, in the order of the cell.

    Raises
    ------
    FileFormatError
        If there is not exactly one such cell or if it holds anything but literals.
    """
    cells = [
        cell
        for cell in notebook.cells
        if cell.cell_type == "code" and "parameters" in cell.metadata.get("tags", [])
    ]
    if len(cells) != 1:
        raise FileFormatError(f"{name}: expected one code cell tagged 'parameters', found {len(cells)}")
    declared: dict[str, Any] = {}
    for statement in ast.parse(cells[0].source).body:
        try:
            (target,) = statement.targets  # type: ignore[attr-defined]
            declared[target.id] = ast.literal_eval(statement.value)  # type: ignore[attr-defined]
        except (AttributeError, ValueError):
            raise FileFormatError(
                f"{name}: expected `name = literal` in the parameters cell, found {ast.unparse(statement)!r}"
            ) from None
    return declared


def checked_parameters(
    declared: Mapping[str, Any], given: Mapping[str, Any], name: str = "notebook"
) -> dict[str, Any]:
    """Return the given parameters as the notebook expects them.

    Parameters
    ----------
    declared : mapping of str to object
        Parameters of the notebook with their defaults.
    given : mapping of str to object
        Values to run with. A whole number is taken where the default is a float, and a string is read
        as a literal where the default is not a string (values of the command line are strings).
    name : str
        What to call the notebook in an error message.

    Returns
    -------
    dict of str to object
        The given values, each of its default's type.

    Raises
    ------
    InputError
        If the notebook has no such parameter or the value is of another kind than its default.
    """
    checked: dict[str, Any] = {}
    for key, value in given.items():
        if key not in declared:
            raise InputError(f"{name} has no parameter {key!r}; it has: {', '.join(declared) or 'none'}")
        kind = type(declared[key])
        if isinstance(value, str) and kind is not str:
            with suppress(ValueError, SyntaxError):  # else it stays a string, which the next check refuses
                value = ast.literal_eval(value)
        if kind is float and type(value) is int:
            value = float(value)
        if kind in (list, tuple) and isinstance(value, list | tuple):
            value = kind(value)
        if type(value) is not kind:
            raise InputError(
                f"{name}: expected {key} to be {kind.__name__} (default {declared[key]!r}), "
                f"got {value!r} ({type(value).__name__})"
            )
        checked[key] = value
    return checked


@contextmanager
def batch_environment() -> Iterator[None]:
    """Set `ENVIRONMENT` for the kernels started in the block, and put back what was there before."""
    before = {key: os.environ.get(key) for key in ENVIRONMENT}
    os.environ.update(ENVIRONMENT)
    try:
        yield
    finally:
        for key, value in before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value


@contextmanager
def private_connection() -> Iterator[Config]:
    """Yield a kernel configuration whose sockets nobody else can take.

    A kernel on TCP is given ports that were free a moment ago; two kernels that start together can be
    given the same. Sockets in a folder of their own cannot collide. The names are short because such a
    path may have about 100 characters. Windows has only TCP.
    """
    with tempfile.TemporaryDirectory(prefix="study-") as folder:
        config = Config()
        if os.name != "nt":
            config.KernelManager.transport = "ipc"
            config.KernelManager.connection_file = str(Path(folder) / "k.json")
            config.KernelManager.ip = str(Path(folder) / "k")
        yield config


def run_notebook(
    notebook: str | os.PathLike[str],
    parameters: Mapping[str, Any] | None = None,
    profile: str | None = None,
    output: str | os.PathLike[str] | None = None,
) -> Path:
    """Execute a notebook with its working directory at the root of the checkout.

    Parameters
    ----------
    notebook : path-like
        The notebook; a relative path counts from the working directory, else from the root of the checkout.
    parameters : mapping of str to object, optional
        Values that go before those of the profile.
    profile : str, optional
        Profile of ``params.yaml``; without one the notebook's own defaults hold.
    output : path-like, optional
        Where the executed copy goes; by default ``figures/executed/<name>.ipynb``.

    Returns
    -------
    pathlib.Path
        The executed copy.

    Raises
    ------
    InputError
        If there is no such notebook, profile or parameter.
    FileFormatError
        If the file is no notebook or has no parameters cell.
    papermill.exceptions.PapermillExecutionError
        If a cell raises; the executed copy then ends with that cell.
    """
    path = Path(notebook).absolute()
    if not path.is_file():
        path = PROJECT / notebook
    if not path.is_file():
        raise InputError(f"expected a notebook, found no file {os.fspath(notebook)}")
    try:
        node = nbformat.read(path, as_version=4)
    except (ValueError, KeyError, AttributeError, nbformat.ValidationError) as error:
        raise FileFormatError(f"{path}: expected a Jupyter notebook: {error}") from error

    given = profile_parameters(path.stem, profile) if profile is not None else {}
    given = {**given, **(parameters or {})}
    values = checked_parameters(declared_parameters(node, path.name), given, path.name)

    target = Path(output).absolute() if output is not None else EXECUTED / path.name
    target.parent.mkdir(parents=True, exist_ok=True)
    with batch_environment(), private_connection() as config:
        papermill.execute_notebook(
            path,
            target,
            parameters=values,
            kernel_name="python3",
            language="python",
            progress_bar=False,
            request_save_on_cell_execute=False,  # at the end, or when a cell raises: each time takes a while
            autosave_cell_every=0,
            cwd=PROJECT,
            config=config,
        )
    return target


def combinations(each: Sequence[Sequence[str]]) -> list[dict[str, str]]:
    """Return what ``--each`` asks for.

    Parameters
    ----------
    each : sequence of sequence of str
        A parameter's name and its values, for every ``--each``.

    Returns
    -------
    list of dict of str to str
        Parameters of each run, the last ``--each`` changing fastest; one run without any for none.
    """
    names = [name for name, *_ in each]
    return [dict(zip(names, values, strict=True)) for values in product(*(values for _, *values in each))]


def _run_side_by_side(given: argparse.Namespace) -> int:
    """Run this module once for each combination, in processes of their own; return the worst code."""
    common = [sys.executable, "-m", "study.batch", given.notebook]
    for name, value in given.parameters:
        common += ["-p", name, value]
    if given.profile is not None:
        common += ["--profile", given.profile]
    if given.profile_file is not None:
        common += ["--profile-file", os.fspath(given.profile_file)]
    commands = []
    for values in combinations(given.each):
        command = [*common, "--output", given.output.format(**values)]
        for name, value in values.items():
            command += ["-p", name, value]
        commands.append(command)
    side_by_side = usual_workers()
    environment = {**os.environ, WORKERS_VARIABLE: "1"}  # they share the cores: none needs more
    pool = ThreadPoolExecutor(side_by_side)
    try:
        runs = [pool.submit(subprocess.run, command, env=environment) for command in commands]
        return max(abs(run.result().returncode) for run in runs)
    finally:
        pool.shutdown(cancel_futures=True)  # when interrupted, the rest need not begin


def command_line() -> argparse.ArgumentParser:
    """Return the parser of ``python -m study.batch``."""
    parser = argparse.ArgumentParser(prog="python -m study.batch", description=__doc__.split("\n")[0])
    parser.add_argument("notebook", help="path of the notebook")
    parser.add_argument(
        "-p",
        nargs=2,
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        dest="parameters",
        help="set one parameter; goes before the profile (repeatable)",
    )
    parser.add_argument(
        "--each",
        nargs="+",
        action="append",
        default=[],
        metavar=("NAME", "VALUE"),
        help="run once for each value of a parameter (repeatable: for every combination)",
    )
    chosen = parser.add_mutually_exclusive_group()
    chosen.add_argument("--profile", help="profile of params.yaml; default: the notebook's own defaults")
    chosen.add_argument("--profile-file", type=Path, help="file that holds the profile's name")
    parser.add_argument(
        "--output", help="executed copy, with {NAME} for --each; default: figures/executed/<name>.ipynb"
    )
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m study.batch``; return 0, 1 if a cell raised, 2 if the call was wrong."""
    parser = command_line()
    given = parser.parse_args(arguments)
    for name, *_ in given.each:
        if f"{{{name}}}" not in (given.output or ""):
            parser.error(f"--each {name}: expected {{{name}}} in --output, got {given.output}")
    try:
        if given.each:
            return _run_side_by_side(given)
        profile = given.profile
        if given.profile_file is not None:
            profile = given.profile_file.read_text(encoding="utf-8").strip()
        run_notebook(given.notebook, dict(given.parameters), profile, given.output)
    except PapermillExecutionError as error:
        print(f"{given.notebook}: {error}", file=sys.stderr)
        return 1
    except (StudyError, OSError) as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
