"""Where the checkout's folders are, whatever the working directory is."""

from __future__ import annotations

import os
from pathlib import Path

from study.errors import InputError

PROJECT = Path(__file__).resolve().parents[1]
"""Root of the checkout: the folder that holds ``study/``, ``data/``, ``notebooks/`` and ``figures/``."""


def data_path(*parts: str) -> Path:
    """Return the path of a file or folder under ``data/``.

    Parameters
    ----------
    *parts : str
        Path components below ``data/``, such as ``"published", "table_A_1.csv"``.

    Returns
    -------
    pathlib.Path
        Absolute path of an existing file or folder.

    Raises
    ------
    InputError
        If there is no such file; the package reads its data from the checkout, so it has to be
        installed in place (``pip install -e .``).
    """
    path = PROJECT.joinpath("data", *parts)
    if not path.exists():
        raise InputError(
            f"expected {path.relative_to(PROJECT)} in the checkout {PROJECT}, which has no such file "
            "(the package is meant to be installed in place with `pip install -e .`)"
        )
    return path


def output_folder(output_dir: str | os.PathLike[str] = "") -> Path:
    """Return the folder that a notebook writes to, and make it if it is missing.

    Parameters
    ----------
    output_dir : path-like
        ``""`` stands for ``figures/``; a relative path counts from the root of the checkout.

    Returns
    -------
    pathlib.Path
        Absolute path of an existing folder.
    """
    folder = PROJECT / (os.fspath(output_dir) or "figures")
    folder.mkdir(parents=True, exist_ok=True)
    return folder
