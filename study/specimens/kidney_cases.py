"""Kidneys with a tumour: procedural, prepared files, or public segmentations as they were published."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from scipy import ndimage

from study.errors import FileFormatError, LabelError
from study.specimens.case_files import json_object, label_file
from study.specimens.kidney import KIDNEY_NAMES
from study.specimens.kidney_checks import checked_surface, checked_swab, checked_tumour
from study.specimens.kidney_measures import exophytic_share, tumour_sections
from study.specimens.kidney_raw import affected_kidney
from study.specimens.kidney_reach import reachable_vertices
from study.specimens.kidney_swab import SwabRule, trace_swab
from study.specimens.orientation import SIDES
from study.volumes import LabelVolume, read_surface, read_volume
from study.volumes import surface as surface_of

if TYPE_CHECKING:
    import trimesh

#: mm: the Gaussian before a kidney's surface is drawn, and the lattice it is drawn on (about 8 000 to
#: 12 000 vertices).
SURFACE_SMOOTHING, SURFACE_PITCH = 1.0, 1.75
_PREPARED = "labels_1mm.nrrd"
_LABEL_FILES = (_PREPARED, "segmentation.nii.gz")
_SURFACE, _SWAB = "kidney_with_tumour.stl", "swab.csv"


@dataclass(frozen=True, eq=False)
class KidneyCase:
    """A kidney with a tumour.

    Surface and swab that did not come with the case are made when they are first asked for.

    Attributes
    ----------
    name : str
    side : str
        "right", "left", or "" if the files do not say.
    anatomy : LabelVolume
        ``background``, ``kidney``, ``tumour``; LPS.
    given_surface : trimesh.Trimesh or None
    given_swab : (n, 3) array or None
    swab_rule : SwabRule
    swab_seed : int
        Of the digitiser's noise in a swab that is made.
    """

    name: str
    side: str
    anatomy: LabelVolume
    given_surface: trimesh.Trimesh | None = None
    given_swab: np.ndarray | None = None
    swab_rule: SwabRule = field(default_factory=SwabRule)
    swab_seed: int = 0

    @cached_property
    def surface(self) -> trimesh.Trimesh:
        """Closed surface of kidney and tumour, mm."""
        return self.given_surface if self.given_surface is not None else kidney_surface(self.anatomy)

    @cached_property
    def swab(self) -> np.ndarray:
        """(n, 3) mm: points traced on the surface, in tracing order; read-only."""
        if self.given_swab is not None:
            swab = np.array(self.given_swab, dtype=float)
        else:
            swab = trace_swab(self.surface, self.tumour_centre, self.swab_rule, self.swab_seed)
        swab.flags.writeable = False
        return swab

    @cached_property
    def reachable(self) -> np.ndarray:
        """(n,) bool: which vertices of the surface a swab can touch, see `reachable_vertices`."""
        return reachable_vertices(self.surface, self.anatomy)

    @property
    def tumour_centre(self) -> np.ndarray:
        """(3,) mm: mean of the tumour's voxel centres."""
        return self.anatomy.points(np.argwhere(self.anatomy.mask("tumour"))).mean(axis=0)

    def summary(self) -> pd.Series:
        """Sizes of kidney and tumour; the largest section of the tumour is in mm."""
        return pd.Series(
            {
                "side": self.side,
                "kidney_cm3": self.anatomy.volume_mm3("kidney") / 1000,
                "tumour_cm3": self.anatomy.volume_mm3("tumour") / 1000,
                "largest_section_mm": tumour_sections(self.anatomy).max(),
                "exophytic_share": exophytic_share(self.anatomy),
                "surface_vertices": len(self.surface.vertices),
                "swab_points": len(self.swab),
            },
            name=self.name,
        )


def kidney_surface(
    anatomy: LabelVolume, smooth_mm: float = SURFACE_SMOOTHING, pitch_mm: float = SURFACE_PITCH
) -> trimesh.Trimesh:
    """The outer surface of kidney and tumour together, closed and without cavities.

    Parameters
    ----------
    anatomy : LabelVolume
        With ``kidney`` and ``tumour``.
    smooth_mm, pitch_mm : float
        See `study.volumes.surface`.

    Returns
    -------
    trimesh.Trimesh

    Raises
    ------
    LabelError
        If neither label has a voxel.
    """
    whole = ndimage.binary_fill_holes(anatomy.mask("kidney", "tumour"))
    volume = anatomy.with_labels(whole.astype(np.uint8), {"background": 0, "kidney with tumour": 1})
    mesh = surface_of(volume, "kidney with tumour", smooth_mm, pitch_mm)
    if mesh.body_count > 1:
        import trimesh

        # Specks, and cavities (of negative volume) that smoothing has cut off from the outside.
        bodies = mesh.split(only_watertight=False)
        least = 0.01 * max(body.volume for body in bodies)
        mesh = trimesh.util.concatenate([body for body in bodies if body.volume > least])
    return checked_surface(mesh, "surface of the labels")


def read_kidney_case(
    path: str | os.PathLike[str], *, labels: str | None = None, aligned: bool = True
) -> KidneyCase:
    """Read a segmented kidney with a tumour, prepared or as published.

    Parameters
    ----------
    path : path-like
        An image file, or a folder that holds ``labels_1mm.nrrd``, ``segmentation.nii.gz`` or one image
        file of any name; labels 1 kidney and 2 tumour. Read if present beside it: ``case.json``
        (``case``, ``side``), ``kidney_with_tumour.stl``, ``swab.csv`` (x, y, z in mm).
    labels : str, optional
        Name of the label file in the folder.
    aligned : bool
        Whether ``swab.csv`` is in the frame of the image. If not, its points may lie anywhere, and
        `study.registration.align_surface` finds where they belong.

    Returns
    -------
    KidneyCase
        The labels of ``labels_1mm.nrrd`` are taken as they are; of all others `affected_kidney` takes
        the kidney with the largest tumour.

    Raises
    ------
    FileNotFoundError, FileFormatError
        As for `read_temporal_bone_case`.
    LabelError
        If no voxel is kidney or none is tumour.
    GeometryError
        If the surface is not closed, or tumour, surface and swab are not those of one kidney in one
        frame in mm.
    """
    path = Path(path)
    folder = path.parent if path.is_file() else path
    # Files of the sets are all called the same; their folders tell them apart.
    own_name = path.is_file() and path.name not in _LABEL_FILES
    name = path.name.split(".")[0] if own_name else folder.resolve().name
    path = path if path.is_file() else label_file(folder, labels, _LABEL_FILES)
    anatomy = read_volume(path, names=KIDNEY_NAMES)
    for label in ("kidney", "tumour"):
        if not anatomy.mask(label).any():
            raise LabelError(f"{path}: expected voxels labelled {anatomy.names[label]} ({label}), got none")
    side = ""
    if path.name != _PREPARED:
        anatomy, side = affected_kidney(anatomy, str(path))
    checked_tumour(anatomy, str(path))

    case_path = folder / "case.json"
    case = json_object(case_path) if case_path.is_file() else {}
    side = case.get("side") or side
    if side and side not in SIDES:
        raise FileFormatError(f"{case_path}: expected side 'right' or 'left', got {side!r}")
    surface = swab = None
    if (folder / _SURFACE).is_file():
        surface = checked_surface(read_surface(folder / _SURFACE), str(folder / _SURFACE), anatomy)
        if surface.volume < 0:
            surface.invert()
    if (folder / _SWAB).is_file():
        swab = checked_swab(_points(folder / _SWAB), str(folder / _SWAB), anatomy, aligned)
    return KidneyCase(str(case.get("case", name)), side, anatomy, surface, swab)


def _points(path: Path) -> np.ndarray:
    try:
        table = pd.read_csv(path)
        table.columns = [str(column).strip().lower().removesuffix("_mm") for column in table]
        return table[["x", "y", "z"]].to_numpy(dtype=float)
    except (KeyError, ValueError, UnicodeDecodeError, pd.errors.ParserError) as error:
        raise FileFormatError(f"{path}: expected columns x, y, z in mm, got {error!r}") from error
