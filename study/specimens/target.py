"""From a segmented temporal bone to a planning volume: the rule for the target of a mastoidectomy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from study.errors import InputError, LabelError, PlanningError
from study.specimens.orientation import side_of, surgical_view
from study.specimens.structures import SYNONYMS, labels_of, structure_mask
from study.volumes import PLANNING_NAMES, LabelVolume
from study.volumes.distances import overlapped_by_ball

#: mm kept free around every structure by a mastoidectomy.
CLEARANCES = {
    "facial_nerve": 1.5,
    "chorda_tympani": 1.0,
    "labyrinth": 1.0,
    "sigmoid_sinus": 1.0,
    "dura": 1.0,
    "external_auditory_canal": 1.0,
    "ossicles": 1.5,
    "internal_auditory_canal": 2.0,
    "carotid_artery": 3.0,
    "temporomandibular_joint": 3.0,
    "vestibular_aqueduct": 1.0,
    "intracranial": 2.0,
}


@dataclass(frozen=True)
class TargetRule:
    """Which part of a temporal bone is to be milled.

    The texts print no rule (their targets were drawn by surgeons), so this one is ours: a cone about
    the lateral axis, opened from the cortex down to the antrum at the dome of the lateral
    semicircular canal, behind the ear canal, in front of the sinus, below the dura, clear of every
    structure, without undercuts. It uses no random numbers and no grey values.

    Parameters
    ----------
    clearances : mapping of str to float
        mm kept between a target voxel's centre and every voxel of a structure, by structure (the
        names of `study.specimens.structures.SYNONYMS`). A structure that is not named here is
        ordinary bone; one that is named but not in the volume is passed over, unless it is one of
        the four the rule cannot do without (labyrinth, external auditory canal, facial nerve, and
        sigmoid sinus or dura).
    base_radius, max_radius : float
        mm: radius of the cone at the dome, and the most it opens to.
    opening_deg : float
        Degrees by which the cone opens to each side.
    depth : float
        mm to which the target may go medially, beyond `depth_from`; negative stops short of it.
    depth_from : {"labyrinth", "facial_nerve"}
        What `depth` counts from: the labyrinth's most lateral point (the dome of the lateral canal),
        or the middle of the facial nerve's mastoid segment.
    anterior_limit : float
        mm in front of the ear canal's centroid at which the target ends.
    inferior_limit : float
        mm below the lowest point of the ear canal's inner half at which the target ends.
    edge_margin : float
        mm between the target and the edges of the volume (not the lateral one).
    opening_radius : float
        mm: target narrower than a ball of this radius is left. 0 keeps all.
    pit_width : float
        mm: pits of the outer surface narrower than this are not exterior air.
    undercuts : bool
        Whether target may lie medially of bone that stays.
    burr_radius : float
        mm: of the components of the target, the one in which this burr has most room is kept.

    Raises
    ------
    InputError
        If a length is out of range or a clearance is given for an unknown structure.
    """

    clearances: Mapping[str, float] = field(default_factory=lambda: dict(CLEARANCES))
    base_radius: float = 6.0
    max_radius: float = 16.0
    opening_deg: float = 45.0
    depth: float = 2.0
    depth_from: str = "labyrinth"
    anterior_limit: float = 4.0
    inferior_limit: float = 9.0
    edge_margin: float = 2.0
    opening_radius: float = 1.6
    pit_width: float = 4.0
    undercuts: bool = False
    burr_radius: float = 2.5

    def __post_init__(self) -> None:
        for name in ("base_radius", "max_radius", "burr_radius"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name}: expected mm above 0, got {getattr(self, name)}")
        for name in ("edge_margin", "opening_radius", "pit_width"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise InputError(f"{name}: expected mm of at least 0, got {getattr(self, name)}")
        for name in ("depth", "anterior_limit", "inferior_limit"):
            if not np.isfinite(getattr(self, name)):
                raise InputError(f"{name}: expected mm, got {getattr(self, name)}")
        if not 0 <= self.opening_deg <= 80:
            raise InputError(f"opening_deg: expected 0 to 80 degrees, got {self.opening_deg}")
        if self.depth_from not in ("labyrinth", "facial_nerve"):
            raise InputError(f"depth_from: expected 'labyrinth' or 'facial_nerve', got {self.depth_from!r}")
        for name, mm in self.clearances.items():
            if name not in SYNONYMS or name in ("air", "air_cells", "bone"):
                raise InputError(f"clearances: expected structures of {sorted(SYNONYMS)}, got {name!r}")
            if not (np.isfinite(mm) and mm >= 0):
                raise InputError(f"clearances: expected mm of at least 0 for {name!r}, got {mm}")


#: For a temporal bone that was cut off at the level of the facial nerve (Siebold, 2.5): no deeper
#: than the nerve's mastoid segment.
MASTOIDECTOMY = TargetRule(depth=0.0, depth_from="facial_nerve")

#: For a whole head: on through the semicircular canals towards the internal auditory canal, in the
#: gap between nerve, dura and sinus, which are laid bare to a thinner shell.
TRANSLABYRINTHINE = TargetRule(
    clearances={
        **{name: mm for name, mm in CLEARANCES.items() if name not in ("labyrinth", "vestibular_aqueduct")},
        "facial_nerve": 1.0,
        "sigmoid_sinus": 0.5,
        "dura": 0.5,
        "internal_auditory_canal": 1.0,
        "intracranial": 1.5,
    },
    depth=8.0,
)


def mastoidectomy_target(
    anatomy: LabelVolume, rule: TargetRule | None = None, side: str | None = None
) -> LabelVolume:
    """Turn a segmented temporal bone into a planning volume.

    Parameters
    ----------
    anatomy : LabelVolume
        With labels for the labyrinth, the external auditory canal, the facial nerve and the sigmoid
        sinus or the dura, under names of `study.specimens.structures.SYNONYMS`. Grid axes along
        left, posterior, superior, in any order. Air must reach laterally to the edge of the volume.
    rule : TargetRule, optional
    side : {"right", "left"}, optional
        Found from the anatomy if not given.

    Returns
    -------
    LabelVolume
        On the same grid: ``air`` (in line of sight from the side), ``target`` (bone and air cells
        to be milled), ``protected`` (everything else: also middle ear, untouched air cells, brain).

    Raises
    ------
    LabelError
        If a structure that the rule needs is missing.
    GeometryError
        If the grid is oblique.
    PlanningError
        If nothing is left as target, naming the step that emptied it.
    """
    rule = TargetRule() if rule is None else rule
    side = side_of(anatomy) if side is None else side
    view = surgical_view(anatomy, side)
    if not labels_of(anatomy, "sigmoid_sinus") + labels_of(anatomy, "dura"):
        raise LabelError(
            f"expected a label for 'sigmoid_sinus' or 'dura' to stop at, got {sorted(anatomy.names)}"
        )
    landmarks = {
        name: view.turned(structure_mask(anatomy, name))
        for name in ("labyrinth", "external_auditory_canal", "facial_nerve")
    }
    hollow = view.turned(_mask_if_any(anatomy, "air"))
    exterior = _exterior(hollow, rule.pit_width, view.spacing)

    region = _region(landmarks, rule, view.spacing, hollow.shape) & ~exterior
    _require(region, "the region of the rule lies in exterior air")
    # All that follows happens near the region.
    reach = max(2 * rule.opening_radius, rule.burr_radius, *rule.clearances.values(), 0.0)
    box = _box_around(region, reach, view.spacing)
    outside = exterior[box]

    keep_out = _keep_out(anatomy, rule, view, box)
    if "intracranial" in rule.clearances:
        below_top = _open_above(hollow, exterior)[box]
        keep_out |= overlapped_by_ball(below_top, rule.clearances["intracranial"], view.spacing)
    target = region[box] & ~keep_out
    _require(target, "the region of the rule lies within the clearances")
    if not rule.undercuts:
        target = _open_to_the_side(target, outside)
        _require(target, "no voxel of the region can be reached from the side without an undercut")
    if rule.opening_radius > 0:
        target = _opened(target, outside, rule.opening_radius, view.spacing)
        if not rule.undercuts:
            target = _open_to_the_side(target, outside)
        _require(target, f"no part is as wide as a ball of {rule.opening_radius:g} mm")
    target = _roomiest(target, outside, rule.burr_radius, view.spacing)

    labels = np.full(hollow.shape, PLANNING_NAMES["protected"], np.uint8)
    labels[exterior] = PLANNING_NAMES["air"]
    labels[box][target] = PLANNING_NAMES["target"]
    return LabelVolume(np.ascontiguousarray(view.back(labels)), anatomy.affine, PLANNING_NAMES)


def _box_around(mask: np.ndarray, reach: float, spacing: np.ndarray) -> tuple[slice, slice, slice]:
    """Slices of the voxels within `reach` mm and a little more of a mask, along every axis."""
    more = np.ceil(reach / spacing).astype(int) + 2
    found = [np.flatnonzero(mask.any(axis=tuple({0, 1, 2} - {axis}))) for axis in range(3)]
    return tuple(slice(max(f[0] - m, 0), f[-1] + m + 1) for f, m in zip(found, more, strict=True))


def _mask_if_any(anatomy: LabelVolume, structure: str) -> np.ndarray:
    names = labels_of(anatomy, structure)
    return anatomy.mask(*names) if names else np.zeros(anatomy.shape, bool)


def _require(target: np.ndarray, otherwise: str) -> None:
    if not target.any():
        raise PlanningError(f"the target came out empty: {otherwise}")


def _exterior(hollow: np.ndarray, pit_width: float, spacing: np.ndarray) -> np.ndarray:
    """Air that is seen from the side; the opening of the depth map closes pits narrower than a disc."""
    depth = np.where(hollow.all(axis=0), hollow.shape[0], np.argmin(hollow, axis=0))
    if pit_width > 0:
        reach = np.floor(pit_width / 2 / spacing[1:]).astype(int)
        y, z = np.ogrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1]
        disc = (y * spacing[1]) ** 2 + (z * spacing[2]) ** 2 <= (pit_width / 2) ** 2
        depth = ndimage.grey_opening(depth, footprint=disc)
    return np.arange(hollow.shape[0])[:, None, None] < depth[None]


def _open_above(hollow: np.ndarray, exterior: np.ndarray) -> np.ndarray:
    """Intracranial space that carries no label: seen from above, and not from the side."""
    inside = hollow & ~exterior
    return np.logical_and.accumulate(inside[:, :, ::-1], axis=2)[:, :, ::-1]


def _keep_out(anatomy: LabelVolume, rule: TargetRule, view, box: tuple) -> np.ndarray:
    """Everything nearer to a structure than its clearance, structures of equal clearance at once."""
    names: dict[float, set[str]] = {}
    for structure, mm in rule.clearances.items():
        names.setdefault(float(mm), set()).update(labels_of(anatomy, structure))
    # What may not be removed is also no target where it has no clearance of its own.
    keep = _mask_if_any(anatomy, "middle_ear") | _mask_if_any(anatomy, "intracranial")
    keep = view.turned(keep)[box].copy()
    for mm, labels in names.items():
        mask = view.turned(anatomy.mask(*labels))[box] if labels else None
        if mask is not None:
            keep |= overlapped_by_ball(mask, mm, view.spacing) if mm > 0 else mask
    return keep


def _region(landmarks: dict, rule: TargetRule, spacing: np.ndarray, shape: tuple) -> np.ndarray:
    """The cone about the lateral axis, cut off at its limits."""
    labyrinth, canal = np.argwhere(landmarks["labyrinth"]), np.argwhere(landmarks["external_auditory_canal"])
    dome = labyrinth[labyrinth[:, 0] == labyrinth[:, 0].min()].mean(axis=0)
    medial, posterior, superior = (
        (np.arange(n) - dome[axis]) * spacing[axis] for axis, n in enumerate(shape)
    )
    height = np.maximum(-medial, 0)
    radius = np.minimum(rule.base_radius + np.tan(np.deg2rad(rule.opening_deg)) * height, rule.max_radius)
    region = (posterior[:, None] ** 2 + superior[None] ** 2)[None] <= radius[:, None, None] ** 2

    floor = 0.0
    if rule.depth_from == "facial_nerve":
        nerve = np.argwhere(landmarks["facial_nerve"])
        # The mastoid segment is the part below the second genu: the lower half of the nerve's height.
        low = nerve[nerve[:, 2] <= (nerve[:, 2].min() + nerve[:, 2].max()) / 2]
        floor = float((np.median(low[:, 0]) - dome[0]) * spacing[0])
    inner = canal[canal[:, 0] >= (canal[:, 0].min() + canal[:, 0].max()) / 2]
    front = (canal[:, 1].mean() - dome[1]) * spacing[1] - rule.anterior_limit
    bottom = (inner[:, 2].min() - dome[2]) * spacing[2] - rule.inferior_limit
    region[medial > floor + rule.depth] = False
    region[:, posterior < front] = False
    region[:, :, superior < bottom] = False
    edge = np.ceil(rule.edge_margin / spacing - 1e-9).astype(int)
    edge = np.maximum(edge, 1)
    region[-edge[0] :] = False
    region[0] = False
    region[:, : edge[1]] = region[:, -edge[1] :] = False
    region[:, :, : edge[2]] = region[:, :, -edge[2] :] = False
    return region


def _open_to_the_side(target: np.ndarray, exterior: np.ndarray) -> np.ndarray:
    """Only what has nothing but target and exterior air lateral of it."""
    return target & np.logical_and.accumulate(target | exterior, axis=0)


def _opened(target: np.ndarray, exterior: np.ndarray, radius: float, spacing: np.ndarray) -> np.ndarray:
    free = target | exterior
    eroded = ~overlapped_by_ball(~free, radius, spacing)
    return target & overlapped_by_ball(eroded, radius, spacing)


def _roomiest(target: np.ndarray, exterior: np.ndarray, burr: float, spacing: np.ndarray) -> np.ndarray:
    parts, count = ndimage.label(target)
    room = target & ~overlapped_by_ball(~(target | exterior), burr, spacing)
    held = np.bincount(parts[room], minlength=count + 1)[1:]
    if not held.any():
        raise PlanningError(f"the target came out empty: a burr of {2 * burr:g} mm fits nowhere in it")
    return parts == 1 + int(np.argmax(held))
