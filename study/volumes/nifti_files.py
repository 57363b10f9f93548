"""NIfTI label maps (``.nii``, ``.nii.gz``)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import nibabel as nib
import numpy as np

from study.errors import FileFormatError, GeometryError
from study.files import written_whole
from study.volumes.file_checks import (
    as_labels,
    names_from_json,
    names_to_json,
    parsing,
    present_labels,
    volume_from_file,
)
from study.volumes.label_volume import LabelVolume, default_names

_COMMENT = 6
_MM = {"mm": 1.0, "meter": 1000.0, "micron": 1e-3, "unknown": 1.0}
_RAS_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def read_nifti(path: Path, names: Mapping[str, int] | None = None) -> LabelVolume:
    """Read a NIfTI label map; see `study.volumes.read_volume`.

    The affine is the sform, else the qform, converted from RAS to LPS. A header with neither states
    no orientation and is refused: left and right would be a guess.
    """
    with parsing(path, "a NIfTI file"):
        image = nib.load(path)
        if not isinstance(image, nib.Nifti1Image):
            raise FileFormatError(f"{path}: expected a NIfTI file, got {type(image).__name__}")
        data = np.asanyarray(image.dataobj)
        unit = image.header.get_xyzt_units()[0]
    if image.header["sform_code"] <= 0 and image.header["qform_code"] <= 0:
        raise GeometryError(f"{path}: expected an sform or a qform, got a header without orientation")
    if unit not in _MM:
        raise GeometryError(f"{path}: expected lengths in {sorted(_MM)}, got {unit}")
    labels = as_labels(data, path)
    own = _own_extension(image)
    affine = _RAS_LPS @ np.asarray(image.affine, dtype=float)
    affine[:3] *= _MM[unit]
    if "affine_lps" in own:
        affine = _sharper(affine, own["affine_lps"], path)
    found = names_from_json(json.dumps(own["names"]), path) if "names" in own else None
    if names is not None:
        found = names
    elif found is None:
        found = default_names(present_labels(labels))
    return volume_from_file(path, labels, affine, found)


def write_nifti(volume: LabelVolume, path: Path) -> None:
    """Write a NIfTI-1 label map; see `study.volumes.write_volume`.

    NIfTI-1 keeps its affine in single precision, so the exact one goes, with the names, into a comment
    extension (code 6, JSON).
    """
    affine = _RAS_LPS @ volume.affine
    image = nib.Nifti1Image(volume.labels, affine)
    image.header.set_xyzt_units("mm")
    directions = volume.directions
    # A qform is a rotation (and a flip): it cannot say what a sheared volume is.
    rigid = np.allclose(directions.T @ directions, np.eye(3), atol=1e-6)
    image.set_sform(affine, code=1)
    image.set_qform(affine, code=1 if rigid else 0)
    own = {"study": {"names": json.loads(names_to_json(volume.names)), "affine_lps": volume.affine.tolist()}}
    image.header.extensions.append(nib.nifti1.Nifti1Extension(_COMMENT, json.dumps(own).encode()))
    with written_whole(path) as temporary:
        nib.save(image, temporary)


def _own_extension(image: nib.Nifti1Image) -> dict[str, Any]:
    for extension in image.header.extensions:
        if extension.get_code() != _COMMENT:
            continue
        content = extension.get_content()
        text = content.decode("utf-8", "replace") if isinstance(content, bytes) else str(content)
        try:
            found = json.loads(text.rstrip("\0 \n"))
        except json.JSONDecodeError:
            continue  # somebody else's comment
        if isinstance(found, dict) and isinstance(found.get("study"), dict):
            return found["study"]
    return {}


def _sharper(affine: np.ndarray, stored: object, path: Path) -> np.ndarray:
    """The stored double-precision affine, as long as the header says the same in single precision."""
    with parsing(path, "a stored affine of (4, 4) numbers"):
        exact = np.array(stored, dtype=float).reshape(4, 4)
    scale = np.abs(exact).max(initial=1.0)
    # Whoever edits the header (a tool that crops, a user) does not know of our extension.
    return exact if np.abs(exact - affine).max() <= 4 * np.finfo(np.float32).eps * scale else affine
