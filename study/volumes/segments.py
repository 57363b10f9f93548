"""The segments of a 3D Slicer segmentation: their header fields, their layers merged into one map."""

from __future__ import annotations

import colorsys
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from study.errors import FileFormatError
from study.volumes.file_checks import present_labels
from study.volumes.label_volume import LabelVolume

_FIELD = re.compile(r"Segment(\d+)_(ID|Name|LabelValue|Layer)")
#: Colours (red, green, blue, 0..1) of the labels a planning volume has; others get spread-out hues.
_USUAL_COLOURS = {"protected": (0.95, 0.87, 0.67), "bone": (0.95, 0.87, 0.67), "target": (0.85, 0.25, 0.2)}


@dataclass(frozen=True)
class Segment:
    """One segment: the voxels of `layer` whose value is `value`."""

    name: str
    value: int
    layer: int


def parse_segments(fields: Mapping[str, str], n_layers: int, path: Path) -> list[Segment]:
    """Segments described by ``SegmentN_...`` key/value pairs, in order of N.

    Files of Slicer before 4.11 have neither layer nor label value: there segment N is layer N, and its
    voxels are 1.

    Parameters
    ----------
    fields : mapping of str to str
        All key/value pairs of the header.
    n_layers : int
        Number of label maps in the file.
    path : pathlib.Path
        For the message.

    Raises
    ------
    FileFormatError
        If a number cannot be read, a layer does not exist, two segments share a name, or two share a
        layer and value; or if the file holds fractions instead of labels.
    """
    representation = fields.get(
        "Segmentation_SourceRepresentation",
        fields.get("Segmentation_MasterRepresentation", "Binary labelmap"),
    )
    if representation != "Binary labelmap":
        raise FileFormatError(f"{path}: expected segments stored as Binary labelmap, got {representation}")
    found: dict[int, dict[str, str]] = {}
    for key, text in fields.items():
        if match := _FIELD.fullmatch(key):
            found.setdefault(int(match[1]), {})[match[2]] = text
    segments = []
    for number in sorted(found):
        own = found[number]
        name = own.get("Name") or own.get("ID") or f"segment_{number}"
        value = _whole(own.get("LabelValue", "1"), f"Segment{number}_LabelValue", 255, path)
        default_layer = str(number if n_layers > 1 else 0)
        layer = _whole(own.get("Layer", default_layer), f"Segment{number}_Layer", n_layers - 1, path)
        segments.append(Segment(name, value, layer))
    seen: dict[object, Segment] = {}
    for segment in segments:
        for key, what in ((segment.name, "name"), ((segment.layer, segment.value), "layer and label value")):
            if key in seen:
                raise FileFormatError(
                    f"{path}: expected segments that differ in name and in layer and label value, got "
                    f"{seen[key].name!r} and {segment.name!r} with the same {what} {key}"
                )
            seen[key] = segment
    return segments


def merge_layers(
    layers: np.ndarray, segments: Sequence[Segment], path: Path
) -> tuple[np.ndarray, list[Segment]]:
    """One label map of segments that do not overlap.

    Segments keep their label values when these differ; a segment whose value an earlier one took gets
    the smallest free value.

    Parameters
    ----------
    layers : (n, nx, ny, nz) uint8 array
    segments : sequence of Segment
    path : pathlib.Path
        For the message.

    Returns
    -------
    labels : (nx, ny, nz) uint8 array
    segments : list of Segment
        With the values they have in `labels`, all in layer 0.

    Raises
    ------
    FileFormatError
        If segments overlap, or a layer holds values that no segment claims.
    """
    values = {segment.value for segment in segments}
    free = [value for value in range(1, 256) if value not in values]
    if len(segments) > 255:
        raise FileFormatError(f"{path}: expected at most 255 segments, got {len(segments)}")
    merged = np.zeros(layers.shape[1:], np.uint8)
    claimed = np.zeros(layers.shape, bool)
    moved: list[Segment] = []
    for segment in segments:
        mask = layers[segment.layer] == segment.value
        if segment.value == 0:
            raise FileFormatError(
                f"{path}: expected label values 1..255 in layers, got 0 for {segment.name!r}"
            )
        claimed[segment.layer] |= mask
        taken = {other.value for other in moved}
        value = segment.value if segment.value not in taken else free.pop(0)
        under = np.unique(merged[mask])
        if under.any():
            names = [repr(other.name) for other in moved if other.value in under]
            count = np.count_nonzero(merged[mask])
            raise FileFormatError(
                f"{path}: expected segments that do not overlap, got {count} voxels of {segment.name!r} "
                f"that also belong to {', '.join(names)}"
            )
        merged[mask] = value
        moved.append(replace(segment, value=value, layer=0))
    if (stray := (layers != 0) & ~claimed).any():
        raise FileFormatError(
            f"{path}: expected every label of every layer to belong to a segment, "
            f"got {np.count_nonzero(stray)} voxels of labels {np.unique(layers[stray]).tolist()} that do not"
        )
    return merged, moved


def names_of_segments(segments: Sequence[Segment], labels: np.ndarray) -> dict[str, int]:
    """Label names from segments; 0 is air, labels in the image that no segment claims are ``label_<n>``."""
    names = {segment.name: segment.value for segment in segments}
    if 0 not in names.values():
        names = {("background" if "air" in names else "air"): 0, **names}
    for value in present_labels(labels):
        if value not in names.values():
            names[f"label_{value}"] = value
    return names


def segment_fields(
    volume: LabelVolume, colours: Mapping[str, Sequence[float]] | None = None
) -> dict[str, str]:
    """Header key/value pairs from which Slicer shows the labels of `volume` as named, coloured segments.

    Parameters
    ----------
    volume : LabelVolume
    colours : mapping of str to (3,) floats, optional
        Red, green, blue from 0 to 1 of a label's name.

    Returns
    -------
    dict of str to str
        Every label but 0; of several names of one label the first. A label without a name becomes
        ``label_<n>``.
    """
    named: dict[int, str] = {}
    for name, value in volume.names.items():
        named.setdefault(value, name)
    for value in present_labels(volume.labels):
        named.setdefault(value, f"label_{value}")
    # Slicer cuts a whole layer to the extent of the first segment in it, so all have the whole image's.
    extent = " ".join(f"0 {size - 1}" for size in volume.shape)
    fields = {
        "Segmentation_ContainedRepresentationNames": "Binary labelmap|",
        "Segmentation_MasterRepresentation": "Binary labelmap",
        "Segmentation_ReferenceImageExtentOffset": "0 0 0",
    }
    chosen = {**_USUAL_COLOURS, **(colours or {})}
    for number, value in enumerate(sorted(value for value in named if value != 0)):
        red, green, blue = chosen.get(named[value]) or colorsys.hsv_to_rgb(
            value * 0.61803398875 % 1, 0.6, 0.9
        )
        fields |= {
            f"Segment{number}_ID": f"Segment_{value}",
            f"Segment{number}_Name": named[value],
            f"Segment{number}_NameAutoGenerated": "0",
            f"Segment{number}_Color": f"{red:.6f} {green:.6f} {blue:.6f}",
            f"Segment{number}_ColorAutoGenerated": "0",
            f"Segment{number}_Extent": extent,
            f"Segment{number}_LabelValue": str(value),
            f"Segment{number}_Layer": "0",
        }
    return fields


def _whole(text: str, field: str, highest: int, path: Path) -> int:
    try:
        value = int(text)
    except ValueError:
        value = -1
    if not 0 <= value <= highest:
        raise FileFormatError(f"{path}: expected {field} to be a whole number 0..{highest}, got {text!r}")
    return value
