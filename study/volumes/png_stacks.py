"""Segmentations as a folder of colour-coded PNG slices."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from study.errors import FileFormatError, GeometryError, InputError, LabelError
from study.volumes.colours import ColourTable, colour_code, label_of_colours
from study.volumes.file_checks import parsing, present_labels
from study.volumes.label_volume import LabelVolume

_OURS = re.compile(r"slice_\d{4,}\.png")


def read_png_stack(
    folder: str | os.PathLike[str],
    colours: ColourTable,
    spacing: Sequence[float],
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    directions: np.ndarray | None = None,
    overlaps: str = "refuse",
    priority: Sequence[str] | None = None,
) -> LabelVolume:
    """Read a folder of colour-coded PNG slices.

    Slices are sorted by the number that follows the common beginning of their names (``plane000``,
    ``plane0010``, ``plane00100`` are 0, 10, 100). Index i is the row of a slice from its top, j the
    column from its left, k the slice.

    Parameters
    ----------
    folder : path-like
        Its ``*.png`` files, RGB or RGBA, all of one size; nothing else in it is read.
    colours : ColourTable
        Alpha 0 is the background, label 0, whatever its red, green and blue.
    spacing : (3,) floats
        mm along i, j, k.
    origin : (3,) floats
        mm of the centre of voxel (0, 0, 0) in LPS.
    directions : (3, 3) array, optional
        Unit vectors of i, j, k in LPS, one a column; the axes of the frame by default.
    overlaps : {"refuse", "decode"}
        Some exporters add up the RGBA of overlapping segments modulo 256. "decode" finds the two or
        three labels that make such a sum and takes the first of them in `priority`; what is not
        settled that way is an error.
    priority : sequence of str, optional
        All names of the table, the one that wins first; for "decode".

    Returns
    -------
    LabelVolume
        Names are those of the table; 0 is air unless the table names it.

    Raises
    ------
    FileNotFoundError
        If there is no such folder.
    FileFormatError
        If there are no slices, one is missing, not a PNG, or of another size or mode, or a colour is
        not in the table (the message lists the colours with their counts).
    GeometryError
        If spacing, origin or directions cannot be used.
    InputError, LabelError
        If `overlaps` is neither word, or `priority` does not rank all names.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder")
    if overlaps not in ("refuse", "decode"):
        raise InputError(f'overlaps: expected "refuse" or "decode", got {overlaps!r}')
    if overlaps == "decode":
        colours.check_priority(priority)
    affine = _affine(spacing, origin, directions)
    codes = np.stack([_slice_codes(path) for path in _same_size(sorted_slices(folder))], axis=-1)
    # Label images are long runs of one colour: sort the runs, not the voxels.
    flat = codes.ravel()
    starts = np.concatenate([[0], np.flatnonzero(flat[1:] != flat[:-1]) + 1])
    lengths = np.diff(starts, append=flat.size)
    found, which = np.unique(flat[starts], return_inverse=True)
    counts = np.bincount(which, weights=lengths).astype(int)
    meaning = label_of_colours(
        found, counts, colours, priority=priority if overlaps == "decode" else None, path=folder
    )
    labels = np.repeat(meaning[which], lengths).reshape(codes.shape)
    names = dict(zip(colours.names, colours.labels, strict=True))
    if 0 not in names.values():
        names = {("background" if "air" in names else "air"): 0, **names}
    return LabelVolume(labels, affine, names)


def write_png_stack(volume: LabelVolume, folder: str | os.PathLike[str], colours: ColourTable) -> None:
    """Write a volume as colour-coded RGBA slices ``slice_0000.png``, ...; the geometry is not stored.

    Rows are i from the top, columns j from the left, slices k; label 0 is transparent. A folder that
    holds nothing but such slices is replaced.

    Parameters
    ----------
    volume : LabelVolume
    folder : path-like
    colours : ColourTable

    Raises
    ------
    LabelError
        If a label that occurs has no colour, or has another name in the table than in the volume.
    InputError
        If the folder holds other files.
    """
    folder = Path(folder)
    palette = np.zeros((256, 4), np.uint8)
    rows = {
        label: (name, colour)
        for name, label, colour in zip(colours.names, colours.labels, colours.colours, strict=True)
    }
    for value in present_labels(volume.labels):
        if value == 0:
            continue
        own = [name for name, label in volume.names.items() if label == value]
        name, colour = rows.get(value, (None, None))
        if name is None or (own and name not in own):
            raise LabelError(
                f"colours: expected a colour for label {value}, {own or 'unnamed'}, got {name!r}"
            )
        palette[value] = (*colour, 255)
    if folder.exists() and (
        not folder.is_dir() or any(not _OURS.fullmatch(f.name) for f in folder.iterdir())
    ):
        raise InputError(f"{folder}: expected a new folder or one of slices written here, got other files")
    folder.parent.mkdir(parents=True, exist_ok=True)
    unfinished = Path(tempfile.mkdtemp(prefix=".writing-", dir=folder.parent))
    try:
        for k in range(volume.shape[2]):
            Image.fromarray(palette[volume.labels[:, :, k]]).save(unfinished / f"slice_{k:04d}.png")
        if folder.exists():
            shutil.rmtree(folder)
        unfinished.chmod(0o777 & ~_umask())
        unfinished.replace(folder)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


def sorted_slices(folder: Path) -> list[Path]:
    """The PNG files of a folder in the order of their numbers, which must have no gap.

    Raises
    ------
    FileFormatError
        If there are none, a name has no number where the others have theirs, what follows the number
        differs, or a number is missing or there twice.
    """
    paths = [path for path in folder.iterdir() if path.suffix.lower() == ".png" and path.is_file()]
    paths = sorted(path for path in paths if not path.name.startswith("."))
    if not paths:
        raise FileFormatError(f"{folder}: expected PNG slices, got none")
    if len(paths) == 1:
        return paths
    first, last = paths[0].stem, paths[-1].stem  # they are sorted: what these share, all share
    same = next((n for n, pair in enumerate(zip(first, last, strict=False)) if len(set(pair)) == 2), None)
    prefix = first[:same].rstrip("0123456789")
    numbered: dict[int, Path] = {}
    ends = set()
    for path in paths:
        match = re.fullmatch(r"(\d+)(.*)", path.stem[len(prefix) :])
        if match is None:
            raise FileFormatError(f"{path}: expected a slice number after {prefix!r}")
        number = int(match[1])
        if number in numbered:
            raise FileFormatError(f"{path}: expected one slice {number}, got also {numbered[number].name}")
        numbered[number] = path
        ends.add(match[2])
    if len(ends) > 1:
        raise FileFormatError(f"{folder}: expected one series of slices, got names that end {sorted(ends)}")
    numbers = sorted(numbered)
    if numbers[-1] - numbers[0] + 1 != len(numbers):
        missing = sorted(set(range(numbers[0], numbers[-1] + 1)) - set(numbers))
        raise FileFormatError(
            f"{folder}: expected slices {numbers[0]} to {numbers[-1]}, got {len(missing)} missing, "
            f"such as {missing[:5]}"
        )
    return [numbered[number] for number in numbers]


def _same_size(paths: list[Path]) -> list[Path]:
    sizes = {}
    for path in paths:
        with parsing(path, "a PNG image"), Image.open(path, formats=["PNG"]) as image:
            sizes.setdefault(image.size, path)
    if len(sizes) > 1:
        listed = ", ".join(f"{path.name} {width} x {height}" for (width, height), path in sizes.items())
        raise FileFormatError(f"{paths[0].parent}: expected slices of one size, got {listed}")
    return paths


def _slice_codes(path: Path) -> np.ndarray:
    """(rows, columns) uint32 colour codes of one slice."""
    with parsing(path, "a PNG image"), Image.open(path, formats=["PNG"]) as image:
        if image.mode not in ("RGB", "RGBA", "P"):
            raise FileFormatError(f"{path}: expected an RGB or RGBA image, got mode {image.mode}")
        return colour_code(np.asarray(image.convert("RGBA")))


def _affine(spacing: Sequence[float], origin: Sequence[float], directions: np.ndarray | None) -> np.ndarray:
    spacing = np.asarray(spacing, dtype=float)
    origin = np.asarray(origin, dtype=float)
    directions = np.eye(3) if directions is None else np.asarray(directions, dtype=float)
    if spacing.shape != (3,) or not np.isfinite(spacing).all() or (spacing <= 0).any():
        raise GeometryError(f"spacing: expected three positive numbers of mm, got {spacing.tolist()}")
    if origin.shape != (3,) or directions.shape != (3, 3):
        raise GeometryError(
            f"expected an origin of shape (3,) and directions of (3, 3), "
            f"got {origin.shape} and {directions.shape}"
        )
    if not np.allclose(np.linalg.norm(directions, axis=0), 1, atol=1e-6):
        raise GeometryError(f"directions: expected unit vectors as columns, got {directions.tolist()}")
    affine = np.eye(4)
    affine[:3, :3] = directions * spacing
    affine[:3, 3] = origin
    return affine


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
