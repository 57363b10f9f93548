"""The numbers that Siebold (2021) and Baron (2010) print, with what is known to be wrong in them.

Nothing is corrected silently: `table` gives what is printed, `corrected` gives the same rows in true
units where the true unit is certain, and `faults` says what to beware of. ``notebooks/published_audit.ipynb``
recomputes every fault from the tables.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import pandas as pd

from study.errors import InputError
from study.paths import data_path

_FILES = {
    "2.2": "table_2_2.csv",
    "2.3": "table_2_3.csv",
    "3.2": "table_3_2.csv",
    "3.2 time": "table_3_2_time.csv",
    "4.2": "table_4_2.csv",
    **{f"A.{k}": f"table_A_{k}.csv" for k in range(1, 5)},
    **{f"B.{k}": f"table_B_{k}.csv" for k in range(1, 10)},
    "Baron 1": "baron_table_1.csv",
    "Baron absolute accuracy": "baron_absolute_accuracy.csv",
}
_SUMMARIES = {"2.3": "table_2_3_summary.csv", **{f"A.{k}": f"table_A_{k}_summary.csv" for k in range(1, 5)}}

# (unit as printed, true unit): factor that brings the printed number to the unit in the column's name
_FACTORS = {("mm", "cm"): 10.0, ("mm/cm^3", "cm/cm^3"): 10.0}
# (unit as printed, true unit): the number stands, the column's name has to change
_RENAMED = {("cm^3", "mm^3"): ("_cm3", "_mm3")}

#: Rows of tables A.3 and A.4 whose names are not the bones of tables A.1 and A.2 (finding E4).
OTHER_BONES = ("CH17", "CH18", "CH19")


@dataclass(frozen=True)
class Fault:
    """Something known to be wrong, or not to fit, in a printed table.

    Attributes
    ----------
    id : str
        Number in the audit: ``E`` an error, ``I`` an inconsistency.
    statement : str
        What is wrong, in a sentence.
    tables : tuple of str
        The tables it concerns.
    """

    id: str
    statement: str
    tables: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.id}: {self.statement}"


@dataclass(frozen=True)
class Parameter:
    """A setting or claim printed in the text of a work.

    Attributes
    ----------
    name, document, section : str
        What it is and where it stands.
    value : object
        Number, text, list or mapping; None where the text names the quantity and gives no value.
    unit : str
        Unit as printed, empty for plain numbers.
    note : str
        What a reader has to know, or empty.
    """

    name: str
    document: str
    section: str
    value: Any = field(hash=False)
    unit: str = ""
    note: str = ""


def tables() -> list[str]:
    """Return the names that `table` knows, in printed order."""
    return list(_FILES)


def table(name: str, as_printed: bool = False) -> pd.DataFrame:
    """Return one printed table.

    Parameters
    ----------
    name : str
        Number of the table, such as ``"A.2"``; `tables` lists them. ``"3.2 time"`` is the last row of
        Table 3.2, ``"Baron 1"`` the table of Baron (2010) and ``"Baron absolute accuracy"`` its section 6.4.
    as_printed : bool
        Keep every entry as the printed text (``"0.40"``, ``"1.0e-2"``, empty where nothing is printed),
        for those who need the number of digits.

    Returns
    -------
    pandas.DataFrame
        One row per printed row, a fresh copy. Units are those of the printed heading, right or wrong.

    Raises
    ------
    InputError
        If there is no such table.
    """
    return _read(_file_of(name, _FILES, "table"), as_printed).copy()


def summary(name: str, as_printed: bool = False) -> pd.DataFrame:
    """Return the printed mean and plus-minus rows of a table.

    Parameters
    ----------
    name : str
        ``"2.3"`` or ``"A.1"`` to ``"A.4"``. Table 2.2 consists of such rows only: read it with `table`.
    as_printed : bool
        Keep the printed text of every entry.

    Returns
    -------
    pandas.DataFrame
        Index ``"mean"`` and ``"plus_minus"``; for 2.3 the index is (``milled_with``, ``statistic``).

    Raises
    ------
    InputError
        If that table has no such rows.
    """
    rows = _read(_file_of(name, _SUMMARIES, "table with mean and plus-minus rows"), as_printed)
    index = [column for column in ("milled_with", "statistic") if column in rows]
    return rows.set_index(index if len(index) > 1 else index[0])


def corrected(name: str) -> pd.DataFrame:
    """Return a printed table in true units, as far as these are certain.

    Path lengths and ratios of Tables 2.2 and A.1 to A.4 are multiplied by 10 (printed mm are cm, finding
    E2). Margin volumes of Tables 4.2 and B.1 to B.9 keep their numbers and become ``margin_volume_mm3``
    (printed cm^3 are mm^3, E5). Everything else is untouched; in particular the plus-minus rows of
    Table 2.2 change unit but stay the wrong intervals they are (E1).

    Parameters
    ----------
    name : str
        As for `table`.

    Returns
    -------
    pandas.DataFrame
        The rows of `table`, corrected.

    Raises
    ------
    InputError
        If there is no such table.
    """
    rows = table(name)
    for entry in codebook(name).itertuples():
        change = (entry.printed_unit, entry.true_unit)
        if change in _FACTORS:
            rows[entry.column] = rows[entry.column] * _FACTORS[change]
        elif change in _RENAMED:
            rows = rows.rename(columns={entry.column: entry.column.replace(*_RENAMED[change])})
    return rows


def appendix_b() -> pd.DataFrame:
    """Return Tables B.1 to B.9 below each other (72 rows), with the table's name in column ``table``."""
    names = [name for name in _FILES if name.startswith("B.")]
    return pd.concat([table(name).assign(table=name) for name in names], ignore_index=True)


def codebook(name: str | None = None) -> pd.DataFrame:
    """Return what the columns mean: ``file, column, meaning, printed_unit, true_unit, note``.

    Parameters
    ----------
    name : str, optional
        A table's name; without it the whole codebook.

    Raises
    ------
    InputError
        If there is no such table.
    """
    book = _read("codebook.csv", True)
    if name is None:
        return book.copy()
    return book[book["file"] == _file_of(name, _FILES, "table")].reset_index(drop=True)


def faults(name: str | None = None) -> list[Fault]:
    """Return what is known to be wrong in a table.

    Parameters
    ----------
    name : str, optional
        A table's name; without it every error and inconsistency, those of the text included.

    Returns
    -------
    list of Fault
        Errors first, then inconsistencies; empty if none is known.

    Raises
    ------
    InputError
        If there is no such table.
    """
    if name is not None:
        _file_of(name, _FILES, "table")
    found = []
    for row in findings().itertuples():
        concerned = tuple(row.tables.split(";")) if row.tables else ()
        if row.kind in ("error", "inconsistency") and (name is None or name in concerned):
            found.append(Fault(row.id, row.statement, concerned))
    return found


def findings() -> pd.DataFrame:
    """Return every finding about the printed numbers: ``id, kind, document, tables, statement``."""
    return _read("findings.csv", True).copy()


def parameter(name: str, document: str = "siebold_2021", section: str | None = None) -> Parameter:
    """Return a setting or a claim of the text.

    Parameters
    ----------
    name : str
        Such as ``"fle_rms"``; `parameters` lists them.
    document : str
        ``"siebold_2021"`` or ``"baron_2010"``.
    section : str, optional
        Needed where a document gives the name twice (``"n_r"`` in 3.3.1 and 4.3.1).

    Returns
    -------
    Parameter
        Its `value` is None where the text gives none.

    Raises
    ------
    InputError
        If the document has no such name, or more than one and no section is given.
    """
    everything = _parameters()
    documents = sorted({entry.document for entry in everything})
    if document not in documents:
        raise InputError(f"expected a document among {', '.join(documents)}, got {document!r}")
    of_document = [entry for entry in everything if entry.document == document]
    found = [entry for entry in of_document if entry.name == name and section in (None, entry.section)]
    if not found:
        where = document if section is None else f"{document}, section {section}"
        names = sorted({entry.name for entry in of_document if section in (None, entry.section)})
        raise InputError(f"no parameter {name!r} in {where}; there are: {', '.join(names) or 'none'}")
    if len(found) > 1:
        sections = ", ".join(entry.section for entry in found)
        raise InputError(f"{document} gives {name!r} in sections {sections}: say which with section=")
    return found[0]


def parameters() -> pd.DataFrame:
    """Return all settings and claims: ``name, document, section, value, unit, note``."""
    return pd.DataFrame([vars(entry) for entry in _parameters()])


def _file_of(name: str, files: dict[str, str], what: str) -> str:
    if name not in files:
        raise InputError(f"no {what} {name!r}; there are: {', '.join(files)}")
    return files[name]


@cache
def _read(file: str, as_printed: bool) -> pd.DataFrame:
    path = data_path("published", file)
    return pd.read_csv(path, dtype=str, keep_default_na=False) if as_printed else pd.read_csv(path)


@cache
def _parameters() -> tuple[Parameter, ...]:
    with open(data_path("published", "parameters.json"), encoding="utf-8") as stream:
        return tuple(Parameter(**entry) for entry in json.load(stream))
