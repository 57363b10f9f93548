"""The four named kidneys, and the one parameter by which a notebook chooses a kidney."""

from __future__ import annotations

import os
from functools import cache, lru_cache
from pathlib import Path

import pandas as pd

from study.errors import FileFormatError, InputError
from study.paths import PROJECT, data_path
from study.specimens.kidney import kidney
from study.specimens.kidney_cases import KidneyCase, read_kidney_case
from study.specimens.kidney_parameters import KidneyParameters

_TUMOUR = ["tumour_diameter", "tumour_depth", "tumour_height", "tumour_angle_deg"]
_COLUMNS = ["name", "side", "seed", *_TUMOUR]


@cache
def _entries() -> dict[str, tuple[int, KidneyParameters]]:
    path = data_path("kidneys.csv")
    table = pd.read_csv(path)
    if list(table.columns) != _COLUMNS or table.empty or table["name"].duplicated().any():
        raise FileFormatError(f"{path}: expected columns {_COLUMNS} and one line a name, got {list(table)}")
    return {
        row["name"]: (
            int(row["seed"]),
            KidneyParameters.drawn(
                int(row["seed"]), row["side"], **{key: float(row[key]) for key in _TUMOUR}
            ),
        )
        for row in table.to_dict("records")
    }


def kidney_catalogue() -> list[str]:
    """Names of the procedural kidneys, the most exophytic tumour first: K1 to K4."""
    return list(_entries())


@lru_cache(maxsize=4)
def kidney_case(name: str) -> KidneyCase:
    """A procedural kidney with one small renal mass, the same bytes every time.

    Sizes and places are ours: they spread over small renal masses (Siebold, 4.1: at most 4 cm in the
    largest section) from exophytic to endophytic. Nothing is fitted to the printed tables. Seeds on
    which a converged registration that starts 5 mm and 5 degrees off often ends in the sinus or a lobe
    farther were passed over, as it hardly ever does so on the real cases.

    Parameters
    ----------
    name : str
        One of `kidney_catalogue`.

    Raises
    ------
    InputError
        If there is no kidney of that name.
    """
    entries = _entries()
    if name not in entries:
        raise InputError(f"name: expected one of {', '.join(entries)}, got {name!r}")
    seed, parameters = entries[name]
    return KidneyCase(name, parameters.side, kidney(parameters, seed), swab_seed=seed)


def load_kidney(what: str | os.PathLike[str]) -> KidneyCase:
    """Load the kidney that a notebook is pointed at.

    Parameters
    ----------
    what : str or path-like
        A name of `kidney_catalogue`, or a folder or an image file for `read_kidney_case`. A relative
        path counts from the working directory, else from the root of the checkout.

    Raises
    ------
    InputError
        If it is none of these.
    FileNotFoundError, FileFormatError, GeometryError, LabelError
        See `read_kidney_case`.
    """
    text = os.fspath(what)
    if text in kidney_catalogue():
        return kidney_case(text)
    path = next((p for p in (Path(text), PROJECT / text) if text and p.exists()), None)
    if path is None:
        names = kidney_catalogue()
        raise InputError(
            f"expected a kidney ({names[0]} to {names[-1]}), a folder or a file; {text!r} is none of them"
        )
    return read_kidney_case(path)
