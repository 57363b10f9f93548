"""Volumes in files: one function to read, one to write, the format chosen by suffix."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from study.errors import FileFormatError, InputError
from study.volumes.file_checks import existing_file
from study.volumes.label_volume import LabelVolume
from study.volumes.nifti_files import read_nifti, write_nifti
from study.volumes.nrrd_files import read_nrrd, write_nrrd

#: Longest first: a name ends with the first that fits.
SUFFIXES = (".seg.nrrd", ".nrrd", ".nii.gz", ".nii")


def read_volume(path: str | os.PathLike[str], names: Mapping[str, int] | None = None) -> LabelVolume:
    """Read a segmented image; its mm frame is LPS whatever the file's is.

    ============== ==================================================================================
    suffix         read as
    ============== ==================================================================================
    ``.seg.nrrd``  3D Slicer segmentation: names of its segments, 0 is air. Segments in several
                   layers are merged when they do not overlap.
    ``.nrrd``      label map; names if this package wrote it, else `default_names`.
    ``.nii[.gz]``  label map, RAS converted to LPS; names as for ``.nrrd``.
    ============== ==================================================================================

    Parameters
    ----------
    path : path-like
    names : mapping of str to int, optional
        What the labels mean; wins over whatever the file says.

    Returns
    -------
    LabelVolume
        Labels of shape (nx, ny, nz) in the file's own axis order, affine to mm in LPS.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    FileFormatError
        If the suffix is none of the above, the file is not what its suffix says or is truncated, the
        voxels are not whole numbers 0..255 (floats that hold whole numbers are fine), there are more
        than three axes longer than one, or segments overlap.
    GeometryError
        If spacing, directions or origin are missing, not finite, or not invertible.
    InputError
        If `names` is not a mapping of str to 0..255.
    """
    path = existing_file(path)
    if _suffix(path).endswith("nrrd"):
        return read_nrrd(path, names)
    return read_nifti(path, names)


def write_volume(
    volume: LabelVolume,
    path: str | os.PathLike[str],
    *,
    colours: Mapping[str, Sequence[float]] | None = None,
) -> None:
    """Write a segmented image so that `read_volume` gives labels, names and affine back.

    Parameters
    ----------
    volume : LabelVolume
    path : path-like
        The suffix chooses the format, see `read_volume`. A ``.seg.nrrd`` opens in 3D Slicer with one
        named, coloured segment for each label but 0 (``label_<n>`` for a label without a name).
    colours : mapping of str to (3,) floats, optional
        Red, green, blue from 0 to 1 for names of labels; only for ``.seg.nrrd``.

    Raises
    ------
    FileFormatError
        If the suffix is none of `read_volume`'s.
    InputError
        If `colours` is given for another format, names a label the volume has not, or a colour is not
        three numbers 0..1.
    """
    path = Path(path)
    suffix = _suffix(path)
    _check_colours(volume, colours, suffix)
    if suffix.endswith("nrrd"):
        write_nrrd(volume, path, segmentation=suffix == ".seg.nrrd", colours=colours)
    else:
        write_nifti(volume, path)


def _suffix(path: Path) -> str:
    for suffix in SUFFIXES:
        if path.name.lower().endswith(suffix):
            return suffix
    raise FileFormatError(f"{path}: expected a name that ends with one of {', '.join(SUFFIXES)}")


def _check_colours(volume: LabelVolume, colours: Mapping[str, Sequence[float]] | None, suffix: str) -> None:
    if colours is None:
        return
    if suffix != ".seg.nrrd":
        raise InputError(f"colours: expected only with .seg.nrrd, got them with {suffix}")
    for name, colour in colours.items():
        if name not in volume.names:
            raise InputError(f"colours: expected names among {sorted(volume.names)}, got {name!r}")
        if len(colour) != 3 or not all(0 <= part <= 1 for part in colour):
            raise InputError(f"colours: expected three numbers 0..1 for {name!r}, got {colour!r}")
