"""What every volume reader checks: the file is there, its voxels are labels, its affine can be used."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from study.errors import FileFormatError, GeometryError, StudyError
from study.volumes.label_volume import LabelVolume


def existing_file(path: str | os.PathLike[str]) -> Path:
    """`path` as a `pathlib.Path`, known to be a file.

    Raises
    ------
    FileNotFoundError
        If nothing is there.
    FileFormatError
        If it is a folder.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    if not path.is_file():
        raise FileFormatError(f"{path}: expected a file, got a folder")
    return path


@contextmanager
def parsing(path: Path, what: str) -> Iterator[None]:
    """Turn whatever a parsing library raises on bad bytes into a `FileFormatError` that names the file."""
    try:
        yield
    except (StudyError, PermissionError, MemoryError):
        raise
    except Exception as error:
        # Parsers meet arbitrary bytes and raise anything from KeyError to zlib.error.
        reason = str(error) or type(error).__name__
        raise FileFormatError(f"{path}: expected {what}, got a file that cannot be read: {reason}") from error


def as_labels(data: np.ndarray, path: Path) -> np.ndarray:
    """Voxel values of a file as labels.

    Parameters
    ----------
    data : (nx, ny, nz) or (nx, ny, nz, 1, ...) array
        Integers, booleans, or floats that hold whole numbers; 0 to 255.
    path : pathlib.Path
        For the message.

    Returns
    -------
    (nx, ny, nz) uint8 array

    Raises
    ------
    FileFormatError
        If the array is not 3-D or a value is not a whole number from 0 to 255.
    """
    if data.ndim > 3 and set(data.shape[3:]) == {1}:
        data = data.reshape(data.shape[:3])
    if data.ndim != 3 or 0 in data.shape:
        raise FileFormatError(f"{path}: expected a 3-D label map, got an array of shape {data.shape}")
    if data.dtype.kind == "f":
        whole = np.isfinite(data) & (data == np.rint(data))
        if not whole.all():
            odd = data[~whole]
            raise FileFormatError(
                f"{path}: expected whole numbers 0..255, got {odd.size} other values such as {odd.flat[0]}"
            )
    elif data.dtype.kind not in "iub":
        raise FileFormatError(f"{path}: expected one number a voxel, got data of type {data.dtype}")
    low, high = data.min(), data.max()
    if low < 0 or high > 255:
        raise FileFormatError(f"{path}: expected labels 0..255, got {low}..{high}")
    return np.ascontiguousarray(data, dtype=np.uint8)


def present_labels(labels: np.ndarray) -> list[int]:
    """Sorted values of a uint8 array; ``np.unique`` would sort every voxel."""
    seen = np.zeros(256, bool)
    seen[labels.ravel(order="K")] = True
    return np.flatnonzero(seen).tolist()


def volume_from_file(
    path: Path, labels: np.ndarray, affine: np.ndarray, names: Mapping[str, int]
) -> LabelVolume:
    """A `LabelVolume` whose geometry errors name the file."""
    try:
        return LabelVolume(labels, affine, dict(names))
    except GeometryError as error:
        raise GeometryError(f"{path}: {error}") from None


def names_to_json(names: Mapping[str, int]) -> str:
    """Label names as one line of ASCII."""
    return json.dumps(dict(names))


def names_from_json(text: str, path: Path) -> dict[str, int]:
    """Label names written by `names_to_json`.

    Raises
    ------
    FileFormatError
        If the text is not a JSON object of str to 0..255.
    """
    with parsing(path, "label names as JSON"):
        names = json.loads(text)
    if not isinstance(names, dict) or not all(
        type(value) is int and 0 <= value <= 255 for value in names.values()
    ):
        raise FileFormatError(f"{path}: expected label names as name -> 0..255, got {text}")
    return names
