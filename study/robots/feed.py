"""Feed rate from the bone met: the speed between 0.5 and 5 mm/s (Siebold, 2.4.1)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.errors import InputError
from study.robots import _kernels

if TYPE_CHECKING:
    from study.planners import Plan


@dataclass(frozen=True)
class FeedSettings:
    """Linear speed of the burr from the bone it removes.

    The text prints the two speed limits and says that the bone volume removed per step, weighed by
    its density, sets the speed between them; it prints no law. The law here is the machinist's: the
    drill removes at most `removal_rate` mm^3 of bone a second (the energy to cut a volume of bone
    and the power of the drill are both constant), so at q mm^3 a mm of travel

        speed = removal_rate / q, kept within min_speed and max_speed.

    What the choice decides is shown by the other laws of `study.robots.feed_laws`.

    Parameters
    ----------
    min_speed, max_speed : float
        mm/s (2.4.1: 0.5 and 5).
    removal_rate : float
        mm^3/s of bone of relative density 1; the one constant that is not printed. The default
        makes the zigzag planner's mean speed over the catalogue of specimens the printed 3.7 mm/s;
        ``benchmarks/fit_feed.py`` recomputes it. No figure of the 3-D planner enters it.

    Raises
    ------
    InputError
        If a value is not positive or the limits are not in order.
    """

    min_speed: float = 0.5
    max_speed: float = 5.0
    removal_rate: float = 5.514

    def __post_init__(self) -> None:
        values = np.array([self.min_speed, self.max_speed, self.removal_rate], dtype=float)
        if not np.isfinite(values).all() or (values <= 0).any() or self.min_speed > self.max_speed:
            raise InputError(
                "FeedSettings: expected 0 < min_speed <= max_speed (mm/s) and removal_rate > 0 (mm^3/s), "
                f"got {self.min_speed}, {self.max_speed}, {self.removal_rate}"
            )

    def speeds(self, removed: np.ndarray, lengths: np.ndarray) -> np.ndarray:
        """Speed of each step.

        Parameters
        ----------
        removed : (m,) array
            mm^3 of bone (of relative density 1) removed in each step.
        lengths : (m,) array
            mm travelled in each step. A step without length gets `max_speed`: its bone, if any,
            costs no time.

        Returns
        -------
        (m,) array
            mm/s within the limits.
        """
        removed, lengths = np.asarray(removed, dtype=float), np.asarray(lengths, dtype=float)
        free = np.full(removed.shape, self.max_speed)
        cutting = (removed > 0) & (lengths > 0)
        wanted = np.divide(self.removal_rate * lengths, removed, out=free, where=cutting)
        return np.clip(wanted, self.min_speed, self.max_speed)


def relative_density(hounsfield: np.ndarray, bone: float = 1500.0) -> np.ndarray:
    """Bone density relative to a reference, from a CT.

    Linear from 0 at 0 HU (water: marrow, soft tissue and air cells cost the drill nothing) to 1 at
    `bone`.

    Parameters
    ----------
    hounsfield : array
        HU.
    bone : float
        HU of bone of relative density 1. Not printed; 1500 HU, compact cortical bone.

    Returns
    -------
    array
        At least 0; denser bone is above 1.

    Raises
    ------
    InputError
        If `bone` is not above 0 HU.
    """
    if not np.isfinite(bone) or bone <= 0:
        raise InputError(f"bone: expected HU above 0, got {bone!r}")
    return np.maximum(np.asarray(hounsfield, dtype=float) / bone, 0.0)


def weighted_removal(plan: Plan, density: np.ndarray) -> np.ndarray:
    """Bone removed on the way to each point of a plan, every voxel weighed by its relative density.

    Parameters
    ----------
    plan : Plan
    density : (nx, ny, nz) array
        Relative density on the grid of the plan's volume; 1 everywhere gives back ``plan.removed``.

    Returns
    -------
    (n,) array
        mm^3 of bone of density 1.

    Raises
    ------
    InputError
        If `density` has another shape than the volume, or a value below 0 or not finite.
    """
    volume = plan.modified.volume
    density = np.ascontiguousarray(density, dtype=float)
    if density.shape != volume.shape:
        raise InputError(f"density: expected the volume's shape {volume.shape}, got {density.shape}")
    if not np.isfinite(density).all() or (density < 0).any():
        raise InputError(
            "density: expected finite relative densities of at least 0 (see relative_density for HU)"
        )
    points = np.ascontiguousarray(volume.indices(plan.points) * volume.spacing)
    sums = _kernels.weight_removed(
        volume.labels,
        volume.names["target"],
        density,
        points,
        volume.spacing,
        float(plan.modified.burr_radius),
    )
    return sums * volume.voxel_volume
