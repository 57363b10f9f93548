"""A segmented medical image: one label per voxel, where the voxels lie in mm, what the labels mean."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from study.errors import GeometryError, InputError, LabelError

#: The labels of a planning volume (Siebold, 2.2): air, bone to preserve, bone to remove.
PLANNING_NAMES = {"air": 0, "protected": 1, "target": 2}


def default_names(values: Iterable[int]) -> dict[str, int]:
    """Names for label values of a file that carries none.

    Labels 0, 1, 2 alone are air, protected and target; anything else is ``label_<n>``.
    """
    values = sorted(int(value) for value in values)
    if set(values) <= {0, 1, 2}:
        return dict(PLANNING_NAMES)
    return {f"label_{value}": value for value in values}


@dataclass(frozen=True, eq=False)
class LabelVolume:
    """A segmented 3-D image.

    Parameters
    ----------
    labels : (nx, ny, nz) integer array
        Label of every voxel, 0 to 255; stored as a read-only uint8 array indexed ``[i, j, k]``.
    affine : (4, 4) array
        Voxel index (of voxel centres) to mm. The mm frame is LPS for every file this package reads.
    names : mapping of str to int, optional
        What the labels mean. Without it: see `default_names`.

    Raises
    ------
    InputError
        If `labels` is not a 3-D integer array of values 0..255 or a name is not a string.
    GeometryError
        If `affine` is not a finite, invertible (4, 4) matrix with last row 0 0 0 1.
    """

    labels: np.ndarray
    affine: np.ndarray
    names: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        labels = np.asarray(self.labels)
        if labels.ndim != 3 or 0 in labels.shape:
            raise InputError(f"labels: expected a non-empty (nx, ny, nz) array, got shape {labels.shape}")
        if labels.dtype != np.uint8:
            if labels.dtype == bool:
                labels = labels.astype(np.uint8)
            elif not np.issubdtype(labels.dtype, np.integer):
                raise InputError(f"labels: expected integers, got dtype {labels.dtype}")
            elif labels.min() < 0 or labels.max() > 255:
                raise InputError(f"labels: expected values 0..255, got {labels.min()}..{labels.max()}")
            else:
                labels = labels.astype(np.uint8)
        # Nobody may change the labels behind the volume's back; one memory layout, so that kernels
        # compile once.
        shared = labels is self.labels and labels.flags.writeable
        labels = np.array(labels, order="C") if shared else np.ascontiguousarray(labels).view()
        labels.flags.writeable = False
        affine = np.array(self.affine, dtype=float)
        if affine.shape != (4, 4):
            raise GeometryError(f"affine: expected shape (4, 4), got {affine.shape}")
        if not np.isfinite(affine).all():
            raise GeometryError(f"affine: expected finite numbers, got {affine.tolist()}")
        if not np.array_equal(affine[3], [0, 0, 0, 1]):
            raise GeometryError(f"affine: expected last row 0 0 0 1, got {affine[3].tolist()}")
        steps = np.linalg.norm(affine[:3, :3], axis=0)
        if (steps == 0).any() or abs(np.linalg.det(affine[:3, :3] / steps)) < 1e-6:
            raise GeometryError(f"affine: expected an invertible matrix, got {affine.tolist()}")
        affine.flags.writeable = False
        names = self.names or default_names(np.flatnonzero(np.bincount(labels.reshape(-1), minlength=1)))
        for name, value in names.items():
            if not isinstance(name, str) or value != int(value) or not 0 <= value <= 255:
                raise InputError(f"names: expected str -> 0..255, got {name!r}: {value!r}")
        object.__setattr__(self, "labels", labels)
        object.__setattr__(self, "affine", affine)
        object.__setattr__(self, "names", {name: int(value) for name, value in names.items()})

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along i, j, k."""
        return self.labels.shape

    @property
    def spacing(self) -> np.ndarray:
        """(3,) mm between voxel centres along i, j, k."""
        return np.linalg.norm(self.affine[:3, :3], axis=0)

    @property
    def directions(self) -> np.ndarray:
        """(3, 3) unit vectors of the index axes in the mm frame, one a column."""
        return self.affine[:3, :3] / self.spacing

    @property
    def voxel_volume(self) -> float:
        """mm^3 of one voxel."""
        return float(abs(np.linalg.det(self.affine[:3, :3])))

    def mask(self, *names: str) -> np.ndarray:
        """(nx, ny, nz) bool array, true where the label is one of `names`.

        Raises
        ------
        LabelError
            If a name is not one of this volume's.
        """
        missing = [name for name in names if name not in self.names]
        if missing or not names:
            raise LabelError(f"expected labels among {sorted(self.names)}, got {missing or 'none'}")
        values = [self.names[name] for name in names]
        if len(values) == 1:
            return self.labels == values[0]
        return np.isin(self.labels, values)

    def volume_mm3(self, *names: str) -> float:
        """mm^3 of the voxels labelled with one of `names`."""
        return float(np.count_nonzero(self.mask(*names)) * self.voxel_volume)

    def points(self, indices: np.ndarray) -> np.ndarray:
        """(n, 3) mm of (n, 3) voxel indices (may be fractional)."""
        indices = np.asarray(indices, dtype=float)
        if indices.ndim == 0 or indices.shape[-1] != 3:
            raise InputError(f"indices: expected shape (n, 3), got {indices.shape}")
        return indices @ self.affine[:3, :3].T + self.affine[:3, 3]

    def indices(self, points: np.ndarray) -> np.ndarray:
        """(n, 3) fractional voxel indices of (n, 3) points in mm."""
        points = np.asarray(points, dtype=float)
        if points.ndim == 0 or points.shape[-1] != 3:
            raise InputError(f"points: expected shape (n, 3), got {points.shape}")
        return (points - self.affine[:3, 3]) @ np.linalg.inv(self.affine[:3, :3]).T

    def with_labels(self, labels: np.ndarray, names: Mapping[str, int] | None = None) -> LabelVolume:
        """The same geometry with other labels (and, if given, other names)."""
        if np.shape(labels) != self.shape:
            raise InputError(f"labels: expected shape {self.shape}, got {np.shape(labels)}")
        return LabelVolume(labels, self.affine, dict(self.names if names is None else names))

    def padded(self, mm: float, label: str = "air", sides: np.ndarray | None = None) -> LabelVolume:
        """The volume with extra voxels of `label` around it.

        Parameters
        ----------
        mm : float
            Thickness of the padding in mm, rounded up to whole voxels.
        label : str
            Name of the label the new voxels get.
        sides : (3, 2) bool array, optional
            Which ends of i, j, k to pad; all by default.
        """
        if label not in self.names:
            raise LabelError(f"expected a label among {sorted(self.names)}, got {label!r}")
        if not np.isfinite(mm) or mm < 0:
            raise InputError(f"mm: expected a length of at least 0 mm, got {mm}")
        sides = np.ones((3, 2), bool) if sides is None else np.asarray(sides, bool)
        voxels = np.ceil(mm / self.spacing - 1e-9).astype(int)
        width = sides * voxels[:, None]
        labels = np.pad(self.labels, width, constant_values=self.names[label])
        affine = self.affine.copy()
        affine[:3, 3] = self.points(-width[:, 0].astype(float)[None])[0]
        return LabelVolume(labels, affine, self.names)

    def __repr__(self) -> str:
        spacing = " x ".join(f"{step:.4g}" for step in self.spacing)
        names = ", ".join(f"{name}={value}" for name, value in self.names.items())
        return f"LabelVolume({' x '.join(map(str, self.shape))} voxels of {spacing} mm; {names})"
