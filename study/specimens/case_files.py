"""Files of a case's folder: the label map among them, JSON notes."""

from __future__ import annotations

import json
from pathlib import Path

from study.errors import FileFormatError

_IMAGES = (".nrrd", ".nii", ".nii.gz")


def json_object(path: Path) -> dict:
    """The JSON object in a file.

    Raises
    ------
    FileFormatError
        If it holds anything else.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError) as error:
        raise FileFormatError(f"{path}: expected JSON, got {error}") from error
    if not isinstance(content, dict):
        raise FileFormatError(f"{path}: expected a JSON object, got {type(content).__name__}")
    return content


def label_file(folder: Path, wanted: str | None, preferred: tuple[str, ...]) -> Path:
    """The image of a folder: the one wanted, else the first of the preferred names, else the only one.

    Raises
    ------
    FileNotFoundError
        If there is no such folder, or no file of the name wanted.
    FileFormatError
        If it is not clear which file is meant.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder}: no such folder")
    for name in (wanted,) if wanted else preferred:
        if (folder / name).is_file():
            return folder / name
    if wanted:
        raise FileNotFoundError(f"{folder / wanted}: no such file")
    images = sorted(
        path
        for path in folder.iterdir()
        if path.name.endswith(_IMAGES) and not path.name.startswith(("planning", "."))
    )
    if len(images) != 1:
        raise FileFormatError(
            f"{folder}: expected {' or '.join(preferred)}, or a single image file (name it with labels=), "
            f"got {[path.name for path in images] or 'none'}"
        )
    return images[0]
