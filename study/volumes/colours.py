"""Which colour means which label: colour tables, and sums of colours where labels overlap."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from study.errors import FileFormatError, InputError, LabelError
from study.volumes.file_checks import existing_file, parsing

_COLUMNS = ("name", "label", "r", "g", "b")


@dataclass(frozen=True)
class ColourTable:
    """The colour of every label of a colour-coded image.

    Parameters
    ----------
    names : tuple of str
    labels : tuple of int
        0 to 255, one for each name.
    colours : tuple of (int, int, int)
        Red, green, blue, 0 to 255, one for each name.

    Raises
    ------
    InputError
        If the three differ in length or are empty, a number is out of range, or a name, label or
        colour occurs twice.
    """

    names: tuple[str, ...]
    labels: tuple[int, ...]
    colours: tuple[tuple[int, int, int], ...]

    def __post_init__(self) -> None:
        colours = tuple(tuple(int(part) for part in colour) for colour in self.colours)
        labels = tuple(int(label) for label in self.labels)
        if not len(self.names) == len(labels) == len(colours) > 0:
            raise InputError(
                f"colour table: expected as many names as labels and colours, "
                f"got {len(self.names)}, {len(labels)} and {len(colours)}"
            )
        for name, label, colour in zip(self.names, labels, colours, strict=True):
            if len(colour) != 3 or not all(0 <= number <= 255 for number in (label, *colour)):
                raise InputError(f"colour table: expected numbers 0..255 for {name!r}, got {label}, {colour}")
        for what, column in (("name", self.names), ("label", labels), ("colour", colours)):
            if twice := sorted({entry for entry in column if column.count(entry) > 1}):
                raise InputError(f"colour table: expected every {what} once, got {twice} more than once")
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "colours", colours)

    def sums(self, rgba: Sequence[int]) -> list[tuple[str, ...]]:
        """Sets of two or three names whose RGBA colours add up to `rgba` modulo 256.

        The alpha of a label is 255, so that of a sum of n is 256 - n: the alpha says how many to try.
        A table of whole numbers may have been cut from fractions, whose sum was cut again: then each
        channel may exceed the sum of whole numbers by up to n - 1. Such sums count only when none is
        exact.
        """
        count = 256 - int(rgba[3])
        if count not in (2, 3):
            return []
        table = np.array(self.colours)
        members = np.array(list(combinations(range(len(self.names)), count)), dtype=int).reshape(-1, count)
        excess = (np.asarray(rgba[:3], dtype=int) - table[members].sum(axis=1)) % 256
        exact = (excess == 0).all(axis=1)
        fits = exact if exact.any() else (excess < count).all(axis=1)
        return [tuple(self.names[index] for index in group) for group in members[fits]]

    def winner(self, rgba: Sequence[int], priority: Sequence[str]) -> str | None:
        """The label that a sum of colours is given to: the member that comes first in `priority`.

        None if no set of two or three labels makes the sum, or several do and they disagree.
        """
        winners = {min(members, key=priority.index) for members in self.sums(rgba)}
        return winners.pop() if len(winners) == 1 else None

    def check_priority(self, priority: Sequence[str] | None) -> None:
        """Raise a `LabelError` unless `priority` ranks every name of the table once."""
        if priority is None or sorted(priority) != sorted(self.names):
            raise LabelError(
                f"priority: expected each of {sorted(self.names)} once, "
                f"got {None if priority is None else list(priority)}"
            )


def read_colour_table(path: str | os.PathLike[str]) -> ColourTable:
    """Read a colour table from a CSV file with the columns name, label, r, g, b.

    Parameters
    ----------
    path : path-like
        Further columns are ignored.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    FileFormatError
        If a column is missing, a number is none or out of range, or a row repeats a name, label or
        colour; the message names the file and the row.
    """
    path = existing_file(path)
    with parsing(path, "a CSV file"), path.open(newline="", encoding="utf-8-sig") as stream:
        reader = csv.DictReader(stream, skipinitialspace=True)
        header = [str(name).strip() for name in reader.fieldnames or ()]
        reader.fieldnames = header
        rows = list(reader)
    if missing := [name for name in _COLUMNS if name not in header]:
        raise FileFormatError(f"{path}: expected columns {', '.join(_COLUMNS)}, got no {', '.join(missing)}")
    names, labels, colours = [], [], []
    for number, row in enumerate(rows, start=2):
        try:
            label, *colour = (int(row[column]) for column in _COLUMNS[1:])
        except (TypeError, ValueError):
            raise FileFormatError(f"{path}: line {number}: expected whole numbers, got {row}") from None
        names.append(row["name"].strip())
        labels.append(label)
        colours.append(tuple(colour))
    try:
        return ColourTable(tuple(names), tuple(labels), tuple(colours))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from None


def colour_code(rgba: np.ndarray) -> np.ndarray:
    """One uint32 for each colour of an (..., 4) uint8 array."""
    parts = np.asarray(rgba).astype(np.uint32)
    return parts[..., 0] << 24 | parts[..., 1] << 16 | parts[..., 2] << 8 | parts[..., 3]


def colour_of_code(code: int) -> tuple[int, int, int, int]:
    """The RGBA of a `colour_code`."""
    return tuple(int(code) >> shift & 255 for shift in (24, 16, 8, 0))


def label_of_colours(
    codes: np.ndarray,
    counts: np.ndarray,
    table: ColourTable,
    *,
    priority: Sequence[str] | None,
    path: Path,
) -> np.ndarray:
    """Labels of colours.

    Parameters
    ----------
    codes, counts : (n,) arrays
        Distinct `colour_code` values and how many voxels have them.
    table : ColourTable
    priority : sequence of str, optional
        With it, sums of colours are decoded.
    path : pathlib.Path
        For the message.

    Returns
    -------
    (n,) uint8 array
        0 where alpha is 0.

    Raises
    ------
    FileFormatError
        If colours are left that mean nothing; the message lists them with their counts.
    """
    value_of = dict(zip(table.names, table.labels, strict=True))
    known = {(*colour, 255): label for colour, label in zip(table.colours, table.labels, strict=True)}
    labels = np.zeros(len(codes), np.uint8)
    unknown = []
    for place, (code, count) in enumerate(zip(codes, counts, strict=True)):
        rgba = colour_of_code(code)
        if rgba[3] == 0:
            continue
        if rgba in known:
            labels[place] = known[rgba]
        elif priority is not None and (name := table.winner(rgba, priority)) is not None:
            labels[place] = value_of[name]
        else:
            unknown.append((int(count), rgba))
    if unknown:
        unknown.sort(reverse=True)
        listed = "; ".join(f"{rgba}: {count}" for count, rgba in unknown[:20])
        more = f"; and {len(unknown) - 20} more" if len(unknown) > 20 else ""
        hint = "" if priority is not None else ' (sums of overlapping labels: overlaps="decode")'
        raise FileFormatError(
            f"{path}: expected the {len(known)} colours of the table, got {len(unknown)} others "
            f"(RGBA: voxels) {listed}{more}{hint}"
        )
    return labels
