"""The modified volume: where the burr's centre may go and what it has to visit (Siebold, 2.2.1 and 2.2.5)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from study.errors import InputError, LabelError, PlanningError
from study.volumes import LabelVolume
from study.volumes.distances import overlapped_by_ball

#: How far around the target positions are looked at through which the burr may pass, in mm.
LIFT_MM = 10.0


@dataclass(frozen=True, eq=False)
class ModifiedVolume:
    """Burr-centre positions derived from a segmentation; all masks have the volume's shape.

    Attributes
    ----------
    volume : LabelVolume
        The unmodified volume. Whatever is neither ``air`` nor ``target`` in it is protected.
    burr_radius : float
        mm.
    allowed : bool array
        The burr may stand here: none of the voxels it overlaps is protected or outside the image.
    target : bool array
        Targeted voxels of the modified volume, its boundary included: the eroded target and its
        dilation into air.
    boundary : bool array
        The targeted bone boundary (2.2.5): targeted voxels that share a face with solid voxels
        outside the modified target. Only the supervoxel's centre clears them.
    """

    volume: LabelVolume
    burr_radius: float
    allowed: np.ndarray
    target: np.ndarray
    boundary: np.ndarray

    @cached_property
    def unreachable(self) -> np.ndarray:
        """Target voxels of the unmodified volume that this burr reaches from nowhere (figure 2.3)."""
        reached = overlapped_by_ball(self.allowed, self.burr_radius, self.volume.spacing)
        return self.volume.mask("target") & ~reached

    @property
    def target_cm3(self) -> float:
        """Modified initial target volume in cm^3 (a column of Tables A.1-A.4)."""
        return float(np.count_nonzero(self.target) * self.volume.voxel_volume / 1000)

    def as_label_volume(self) -> LabelVolume:
        """The modified volume of figure 2.5: air, protected, target, target boundary."""
        air = self.volume.mask("air")
        labels = np.where(air, 0, 1).astype(np.uint8)
        labels[self.target] = 2
        labels[self.boundary] = 3
        names = {"air": 0, "protected": 1, "target": 2, "target_boundary": 3}
        return self.volume.with_labels(labels, names)


def check_planning_volume(volume: LabelVolume) -> tuple[np.ndarray, np.ndarray]:
    """Masks of air and target of a volume that can be planned on.

    Raises
    ------
    LabelError
        If the volume has no ``air`` or no ``target`` among its names.
    PlanningError
        If no voxel is target, or target touches the edge of the volume.
    """
    for name in ("air", "target"):
        if name not in volume.names:
            raise LabelError(f"a planning volume needs the labels 'air' and 'target', got {volume.names}")
    air, target = volume.mask("air"), volume.mask("target")
    if not target.any():
        raise PlanningError(f"the volume holds no voxel labelled 'target' ({volume.names['target']})")
    for axis in range(3):
        for end, plane in (("first", 0), ("last", -1)):
            touching = int(np.count_nonzero(np.take(target, plane, axis=axis)))
            if touching:
                raise PlanningError(
                    f"{touching} target voxels lie in the {end} plane of axis {'ijk'[axis]}; what is beyond "
                    "the edge of the image is unknown: expected target inside (LabelVolume.padded adds air)"
                )
    return air, target


def _touched(mask: np.ndarray, connectivity: int) -> np.ndarray:
    """Voxels that share a face (6) or any vertex (26) with a voxel of `mask`."""
    out = np.zeros_like(mask) if connectivity == 6 else mask.copy()
    for axis in range(3):
        source = np.moveaxis(mask if connectivity == 6 else out.copy(), axis, 0)
        grown = np.moveaxis(out, axis, 0)
        grown[1:] |= source[:-1]
        grown[:-1] |= source[1:]
    return out


def modified_volume(
    volume: LabelVolume, burr_radius: float, *, boundary_connectivity: int = 6, finishing: bool = False
) -> ModifiedVolume:
    """Erode the target by the burr, dilate the rest into air, find the target boundary.

    Parameters
    ----------
    volume : LabelVolume
        With labels ``air`` and ``target``; everything else is protected.
    burr_radius : float
        mm.
    boundary_connectivity : {6, 26}
        Whether target boundary shares a face (2.2.5) or any vertex (Table 2.1) with the solid around.
    finishing : bool
        Target also every allowed position from which the burr reaches bone that the positions above
        do not: what a later, smaller burr is for (end of 2.3), whose own erosion of the thin rest
        would leave nothing.

    Returns
    -------
    ModifiedVolume

    Raises
    ------
    LabelError, PlanningError
        See `check_planning_volume`; also when the burr fits nowhere in the target.

    Notes
    -----
    Only protected bone erodes (figure 2.4: without the dilation the burr would enter the outermost
    bone with its whole radius, so air does not). The dilation keeps to positions at which the whole
    burr avoids protected bone. What lies beyond the image is unknown and counts as protected.
    """
    if boundary_connectivity not in (6, 26):
        raise InputError(f"boundary_connectivity: expected 6 or 26, got {boundary_connectivity!r}")
    air, target = check_planning_volume(volume)
    spacing = volume.spacing
    reach = np.floor(burr_radius / spacing + 0.5).astype(int)
    # Work in a box around the target: the burr's reach, and room to lift it over bone between pits.
    lift = np.ceil(LIFT_MM / spacing).astype(int)
    corners = [np.flatnonzero(target.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    low = np.array([c[0] for c in corners]) - reach
    high = np.array([c[-1] for c in corners]) + reach + 1
    box_low, box_high = np.maximum(low - reach - lift, 0), np.minimum(high + reach + lift, volume.shape)
    box = tuple(slice(a, b) for a, b in zip(box_low, box_high, strict=True))
    air_box, target_box = air[box], target[box]
    protected = ~(air_box | target_box)

    allowed = ~overlapped_by_ball(protected, burr_radius, spacing)
    for axis in range(3):  # the burr may not reach beyond the image, nor beyond the box that was looked at
        low_edge = [slice(None)] * 3
        high_edge = [slice(None)] * 3
        low_edge[axis], high_edge[axis] = (
            slice(0, reach[axis]),
            slice(allowed.shape[axis] - reach[axis], None),
        )
        allowed[tuple(low_edge)] = False
        allowed[tuple(high_edge)] = False

    eroded = target_box & allowed
    modified = eroded | (air_box & allowed & overlapped_by_ball(eroded, burr_radius, spacing))
    if finishing:
        rest = target_box & ~overlapped_by_ball(modified, burr_radius, spacing)
        modified |= allowed & overlapped_by_ball(rest, burr_radius, spacing)
    if not modified.any():
        raise PlanningError(
            f"a burr of {2 * burr_radius:g} mm fits nowhere in the target of "
            f"{np.count_nonzero(target) * volume.voxel_volume:.1f} mm^3 without cutting protected voxels"
        )
    solid_outside = ~modified & ~air_box
    boundary = modified & _touched(solid_outside, boundary_connectivity)

    def whole(part: np.ndarray) -> np.ndarray:
        out = np.zeros(volume.shape, dtype=bool)
        out[box] = part
        out.flags.writeable = False
        return out

    return ModifiedVolume(volume, float(burr_radius), whole(allowed), whole(modified), whole(boundary))
