"""The two phantoms of the text: an aluminium block of 24 holes, an acrylic block of six (Baron, section 6).

Sizes and counts are printed, the places of spheres and holes are ours: the text shows them in photographs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance.drilling import LoopSettings, drill_holes
from study.guidance.frames import moved, rigid
from study.guidance.scene import Phantom
from study.guidance.setting_up import SetUp, set_up
from study.guidance.systems import GuidedSystem
from study.registration import register_points

#: Image frame of a block: x and y along its top, z down into it.
_DOWN = np.diag([1.0, -1.0, -1.0])


def aluminium_block() -> Phantom:
    """125 x 75 x 35 mm with a grid of 24 holes, five spheres beside them (section 6.1)."""
    x, y = np.meshgrid((np.arange(6) - 2.5) * 17.5, (np.arange(4) - 1.5) * 16.0)
    entries = np.column_stack([x.ravel(), y.ravel(), np.zeros(24)])
    spheres = [
        [-57.0, -32.0, -4.0],
        [57.0, -32.0, -4.0],
        [57.0, 32.0, -4.0],
        [-57.0, 32.0, -4.0],
        [12.0, 34.0, -4.0],
    ]
    return Phantom(
        "aluminium block",
        spheres,
        entries,
        entries + np.array([0.0, 0.0, 35.0]),
        rigid(_DOWN, [450.0, 0.0, 180.0]),
        2.0,
    )


def acrylic_block(rng: object = 0) -> Phantom:
    """Three spheres embedded in epoxy and six drill trajectories between them (section 6.3).

    Parameters
    ----------
    rng : anything `numpy.random.default_rng` takes
        Draws the trajectories, which the text calls arbitrary: up to 20 degrees oblique, 35 to 45 mm long.
    """
    rng = np.random.default_rng(rng)
    spheres = [[-40.0, -25.0, 10.0], [40.0, -20.0, 15.0], [0.0, 30.0, 12.0]]
    entries = np.column_stack([rng.uniform(-30, 30, 6), rng.uniform(-20, 20, 6), np.zeros(6)])
    around, tilt = rng.uniform(0, 2 * np.pi, 6), np.deg2rad(20) * np.sqrt(rng.uniform(size=6))
    turns = Rotation.from_rotvec(
        tilt[:, None] * np.column_stack([np.cos(around), np.sin(around), np.zeros(6)])
    )
    lengths = rng.uniform(35, 45, (6, 1))
    targets = entries + lengths * turns.apply([0.0, 0.0, 1.0])
    return Phantom("acrylic block", spheres, entries, targets, rigid(_DOWN, [450.0, 0.0, 180.0]))


@dataclass(frozen=True, eq=False)
class LateralResult:
    """The holes of one aluminium block as the coordinate measuring machine finds them (section 6.2).

    Attributes
    ----------
    top, bottom : (24, 2) arrays
        Deviation of the holes' centres in x and y of the block, mm.
    ready : SetUp
    """

    top: np.ndarray
    bottom: np.ndarray
    ready: SetUp


@dataclass(frozen=True, eq=False)
class AbsoluteResult:
    """The holes of one acrylic block as the scan after drilling shows them (section 6.4).

    Attributes
    ----------
    target_distance : (6,) array
        From the drilled to the desired target, mm.
    axis_distance : (6,) array
        Between the drilled and the desired axis at the target, mm.
    ready : SetUp
    """

    target_distance: np.ndarray
    axis_distance: np.ndarray
    ready: SetUp


def lateral_experiment(
    system: GuidedSystem,
    rng: object = None,
    settings: LoopSettings | None = None,
    phantom: Phantom | None = None,
) -> LateralResult:
    """Calibrate, register and drill the aluminium block once (section 6.1).

    Parameters
    ----------
    system : GuidedSystem
    rng : anything `numpy.random.default_rng` takes
    settings : LoopSettings, optional
    phantom : Phantom, optional
        Another block with holes along z of its frame.

    Returns
    -------
    LateralResult
    """
    rng = np.random.default_rng(rng)
    phantom = phantom or aluminium_block()
    if np.abs(phantom.directions[:, :2]).max() > 1e-6:
        raise InputError("phantom: expected holes along z of its frame, one is oblique")
    ready = set_up(system, phantom, rng)
    holes = drill_holes(ready, rng, settings)
    errors = np.array([[hole.error_at(0.0), hole.error_at(hole.length)] for hole in holes])
    return LateralResult(errors[:, 0, :2], errors[:, 1, :2], ready)


def absolute_experiment(
    system: GuidedSystem,
    rng: object = None,
    settings: LoopSettings | None = None,
    phantom: Phantom | None = None,
) -> AbsoluteResult:
    """Scan, register, drill and scan the acrylic block once (section 6.3).

    The drilled holes are read in the second scan and carried into the first by the spheres, both of which
    are found with the image's own error.

    Parameters
    ----------
    system : GuidedSystem
    rng : anything `numpy.random.default_rng` takes
    settings : LoopSettings, optional
    phantom : Phantom, optional

    Returns
    -------
    AbsoluteResult
    """
    rng = np.random.default_rng(rng)
    phantom = phantom or acrylic_block()
    ready = set_up(system, phantom, rng, imaged=True)
    holes = drill_holes(ready, rng, settings)
    found = phantom.spheres + system.image_fle_mm * rng.standard_normal(phantom.spheres.shape)
    back = register_points(found, ready.imaged_spheres).transform
    target, axis = [], []
    for hole in holes:
        ends = np.stack([hole.bottom, hole.centre(0.0), hole.centre(hole.length - 1.0)])
        ends = moved(back, ends + system.scan_reading_mm * rng.standard_normal(ends.shape))
        wanted = hole.entry + hole.length * hole.direction
        along = ends[2] - ends[1]
        along /= np.linalg.norm(along)
        off = ends[2] - wanted
        target.append(np.linalg.norm(ends[0] - wanted))
        axis.append(np.linalg.norm(off - (off @ along) * along))
    return AbsoluteResult(np.array(target), np.array(axis), ready)
