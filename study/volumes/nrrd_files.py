"""NRRD label maps and 3D Slicer segmentations (``.nrrd``, ``.seg.nrrd``)."""

from __future__ import annotations

import io
import re
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import nrrd
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
from study.volumes.segments import merge_layers, names_of_segments, parse_segments, segment_fields

#: Key of the header's key/value pair that holds our label names as JSON.
NAMES_KEY = "study_label_names"

_KEY_VALUE = re.compile(rb"([^:#][^:]*):=(.*)")
_TOWARDS = {"l": (0, 1), "r": (0, -1), "p": (1, 1), "a": (1, -1), "s": (2, 1), "i": (2, -1)}
_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "µm": 1e-3, "": 1.0, "???": 1.0}


def read_nrrd(path: Path, names: Mapping[str, int] | None = None) -> LabelVolume:
    """Read a NRRD label map; see `study.volumes.read_volume`.

    The frame is the header's ``space`` converted to LPS, or LPS if the header names none. Without
    ``space directions`` the axes are those of the frame and ``spacings`` their steps; without
    ``space origin`` the first voxel's centre is at 0 (as ITK reads such files).
    """
    raw = path.read_bytes()
    with parsing(path, "a NRRD file"):
        stream = io.BytesIO(raw)
        header = nrrd.read_header(stream)
        start = stream.tell()
        data = nrrd.read_data(header, stream, str(path))
    _refuse_cut_gzip(header, raw[start:], path)
    fields = _key_values(raw)
    spatial, affine = _geometry(header, path)
    layers = _layers(data, spatial, path)
    segments = parse_segments(fields, len(layers), path)
    if len(layers) > 1:
        if not segments:
            raise FileFormatError(f"{path}: expected one 3-D label map, got data of shape {data.shape}")
        labels, segments = merge_layers(layers, segments, path)
    else:
        labels = layers[0]
    found = names_from_json(fields[NAMES_KEY], path) if NAMES_KEY in fields else None
    if segments:
        of_segments = names_of_segments(segments, labels)
        # Slicer edits the segments and knows nothing of our key, which then no longer agrees.
        if found is None or not _agree(found, of_segments):
            found = of_segments
    elif found is None:
        found = default_names(present_labels(labels))
    return volume_from_file(path, labels, affine, found if names is None else names)


def write_nrrd(
    volume: LabelVolume,
    path: Path,
    *,
    segmentation: bool,
    colours: Mapping[str, Sequence[float]] | None = None,
) -> None:
    """Write a NRRD label map in LPS with gzip data; see `study.volumes.write_volume`."""
    header = {
        "space": "left-posterior-superior",
        "space directions": volume.affine[:3, :3].T,
        "space origin": volume.affine[:3, 3],
        "space units": ["mm"] * 3,
        "kinds": ["domain"] * 3,
        "encoding": "gzip",
    }
    fields = segment_fields(volume, colours) if segmentation else {}
    fields[NAMES_KEY] = names_to_json(volume.names)
    stream = io.BytesIO()
    nrrd.write(stream, volume.labels, header, compression_level=6)
    head, data = stream.getvalue().split(b"\n\n", 1)
    # pynrrd writes the date, and ASCII only: the same volume shall give the same bytes, names are UTF-8.
    lines = [line for line in head.split(b"\n") if not line.startswith(b"#")]
    for key, text in fields.items():
        escaped = text.replace("\\", "\\\\").replace("\n", "\\n")
        lines.append(f"{key}:={escaped}".encode())
    with written_whole(path) as temporary:
        temporary.write_bytes(b"\n".join(lines) + b"\n\n" + data)


def _key_values(raw: bytes) -> dict[str, str]:
    """Key/value pairs of a header, read as UTF-8 (pynrrd drops what is not ASCII)."""
    pairs = {}
    for line in io.BytesIO(raw):
        line = line.rstrip(b"\r\n")
        if not line.strip():
            break
        if match := _KEY_VALUE.fullmatch(line):
            key, text = (part.decode("utf-8", "replace") for part in match.groups())
            pairs[key] = re.sub(r"\\(n|\\)", lambda hit: "\n" if hit[1] == "n" else "\\", text)
    return pairs


def _refuse_cut_gzip(header: Mapping[str, Any], compressed: bytes, path: Path) -> None:
    # pynrrd does not notice that the end of the stream, with its checksum, is missing.
    if header["encoding"] not in ("gzip", "gz") or {"data file", "datafile"} & set(header):
        return
    compressed = compressed.split(b"\n", header.get("line skip", header.get("lineskip", 0)))[-1]
    stream = zlib.decompressobj(zlib.MAX_WBITS | 16)
    for start in range(0, len(compressed), 1 << 16):
        stream.decompress(compressed[start : start + (1 << 16)])
    if not stream.eof:
        raise FileFormatError(f"{path}: expected complete gzip data, got a truncated file")


def _geometry(header: Mapping[str, Any], path: Path) -> tuple[list[int], np.ndarray]:
    """Which array axes are spatial, and their affine to mm in LPS."""
    sizes = [int(size) for size in header["sizes"]]
    if "space directions" in header:
        rows = [[np.nan] * 3 if row is None else row for row in header["space directions"]]
        if len(rows) != len(sizes) or any(len(row) != 3 for row in rows):
            raise GeometryError(
                f"{path}: expected a 3-D space direction for each of {len(sizes)} axes, "
                f"got {np.shape(header['space directions'])}"
            )
        vectors = np.array(rows, dtype=float)
        spatial = [axis for axis in range(len(sizes)) if not np.isnan(vectors[axis]).all()]
        vectors = vectors[spatial]
    elif "spacings" in header:
        steps = np.asarray(header["spacings"], dtype=float)
        if len(steps) != len(sizes):
            raise GeometryError(f"{path}: expected {len(sizes)} spacings, got {steps.tolist()}")
        spatial = [axis for axis in range(len(sizes)) if not np.isnan(steps[axis])]
        while len(spatial) > 3 and sizes[spatial[-1]] == 1:
            spatial.pop()
        if (steps[spatial] <= 0).any():
            raise GeometryError(f"{path}: expected positive spacings, got {steps.tolist()}")
        vectors = np.diag(steps[spatial])
    else:
        raise GeometryError(f"{path}: expected space directions or spacings, got a header with neither")
    if len(spatial) != 3:
        given = header.get("space directions", header.get("spacings"))
        raise GeometryError(
            f"{path}: expected directions or spacings of exactly three axes, got {np.asarray(given).tolist()}"
        )
    origin = np.asarray(header.get("space origin", np.zeros(3)), dtype=float)
    if origin.shape != (3,):
        raise GeometryError(f"{path}: expected a space origin of three numbers, got {origin.tolist()}")
    for what, numbers in (("space directions or spacings", vectors), ("a space origin", origin)):
        if not np.isfinite(numbers).all():
            raise GeometryError(f"{path}: expected {what} of finite numbers, got {numbers.tolist()}")
    affine = np.eye(4)
    frame = _frame_to_lps(header.get("space", "left-posterior-superior"), path)
    units = _units_in_mm(header.get("space units", ["mm"] * 3), path)
    affine[:3, :3] = frame @ (units[:, None] * vectors.T)
    affine[:3, 3] = frame @ (units * origin)
    return spatial, affine


def _frame_to_lps(space: str, path: Path) -> np.ndarray:
    words = space.lower().split("-")
    letters = words[0] if len(words) == 1 else "".join(word[:1] for word in words)
    matrix = np.zeros((3, 3))
    for column, letter in enumerate(letters[:3]):
        if letter in _TOWARDS:
            axis, sign = _TOWARDS[letter]
            matrix[axis, column] = sign
    if len(letters) != 3 or abs(np.linalg.det(matrix)) != 1:
        raise GeometryError(f"{path}: expected a space such as left-posterior-superior or RAS, got {space!r}")
    return matrix


def _units_in_mm(units: Sequence[str], path: Path) -> np.ndarray:
    if len(units) != 3 or not set(units) <= set(_MM):
        raise GeometryError(f"{path}: expected three space units among {sorted(_MM)}, got {list(units)}")
    return np.array([_MM[unit] for unit in units])


def _layers(data: np.ndarray, spatial: Sequence[int], path: Path) -> np.ndarray:
    """(n, nx, ny, nz) uint8 label maps, all other axes than the spatial ones flattened into the first."""
    others = [axis for axis in range(data.ndim) if axis not in spatial]
    data = np.transpose(data, [*others, *spatial])
    data = data.reshape(-1, *data.shape[len(others) :])
    return np.stack([as_labels(layer, path) for layer in data])


def _agree(stored: Mapping[str, int], of_segments: Mapping[str, int]) -> bool:
    """Whether stored names say what the segments say, labels without voxels or 0 aside."""
    pairs = {(name, value) for name, value in of_segments.items() if value != 0}
    unnamed = {(name, value) for name, value in pairs if name == f"label_{value}"}
    stored_values = {value for value in stored.values() if value != 0}
    return pairs - unnamed <= set(stored.items()) and stored_values <= {value for _, value in pairs}
