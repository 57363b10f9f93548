"""What growing a margin returns."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pandas as pd
from scipy import ndimage

from study.errors import InputError, MarginError
from study.margins.exact import Choice
from study.margins.overall_risk import RiskEstimate, overall_damage_risk
from study.margins.point_risk import all_distances, point_damage_risk, widest_deviation
from study.margins.protrusion import largest_losses, protrusion_risk
from study.margins.region import Region, reach_of
from study.margins.room import with_edge
from study.margins.settings import GrowthSettings
from study.registration.sources import ErrorSource, checked_transforms, displacement_moments
from study.volumes import LabelVolume


@dataclass(frozen=True, eq=False)
class SafetyMargin:
    """Tissue around a structure that must not be milled, or must be removed, and what it was grown from.

    Attributes
    ----------
    structure : str
    purpose : {"protect", "remove", "stay_inside"}
    volume : LabelVolume
        Larger than the one that was given where a margin to be removed leaves that.
    structure_mask, mask : (nx, ny, nz) bool arrays
        The structure, and the margin around it (without the structure); to stay inside, a rim of the
        structure.
    model : ErrorSource
    acceptable_risk : float
    shape : {"spatially_varying", "constant_thickness"}
    settings : GrowthSettings
    estimate : RiskEstimate
        On the registrations with which growth stopped.
    validation : RiskEstimate or None
        On registrations never used before.
    distance : float
        Largest distance from a voxel of the margin to the structure's surface: standard deviations of the
        error, mm for constant thickness. To remove or to stay inside always mm, to the nearest voxel from
        which the margin begins.
    edge_share : float
        Share of the structure's surface, in voxel faces, that is only the edge of the volume.
    time_s : float
        Seconds it took, validation included.
    history : DataFrame or None
        Steps of the published method.
    choice : Choice or None
        Registrations and ranked voxels of the exact method.
    """

    structure: str
    volume: LabelVolume
    structure_mask: np.ndarray
    mask: np.ndarray
    model: ErrorSource
    acceptable_risk: float
    shape: str
    settings: GrowthSettings
    estimate: RiskEstimate
    validation: RiskEstimate | None
    distance: float
    edge_share: float
    time_s: float
    history: pd.DataFrame | None = None
    choice: Choice | None = field(default=None, repr=False)
    purpose: str = "protect"

    @property
    def voxels(self) -> int:
        """Voxels in the margin."""
        return int(np.count_nonzero(self.mask))

    @property
    def volume_mm3(self) -> float:
        """mm^3 of the margin."""
        return self.voxels * self.volume.voxel_volume

    @property
    def inside(self) -> np.ndarray:
        """(nx, ny, nz) bool array: the structure without a rim to stay inside of, else with its margin."""
        if self.purpose == "stay_inside":
            return self.structure_mask & ~self.mask
        return self.structure_mask | self.mask

    @property
    def damage_risk(self) -> float:
        """Overall damage risk among the registrations with which growth stopped."""
        return self.estimate.risk

    @cached_property
    def needs(self) -> np.ndarray:
        """(n,) voxels of the smallest margin from which on each registration is harmless (exact method).

        One more than the ranked voxels where these are not enough. Found by another sweep when first asked
        for.
        """
        if self.choice is None:
            raise MarginError('needs: expected a margin grown with method="exact", got "published"')
        return self.choice.needs()

    def curve(self) -> pd.DataFrame:
        """Overall damage risk against margin.

        Returns
        -------
        DataFrame
            ``margin_voxels``, ``volume_mm3``, ``distance`` (standard deviations or mm, as
            of the margin), ``risk``. Exact method: the share of the registrations with which the margin was
            chosen that do damage, at every margin where it changes, as far as voxels were ranked (to a
            third of the acceptable risk at least). Published method: its steps.
        """
        step = self.volume.voxel_volume
        if self.choice is None and self.history is None:
            raise MarginError("curve: expected a margin that was grown, got a union of several")
        if self.choice is None:
            table = self.history[["margin_voxels", "risk"]].copy()
            table.insert(1, "volume_mm3", table["margin_voxels"] * step)
            return table
        needs, known = self.needs, self.choice.ranking.distances
        sizes, counts = np.unique(needs, return_counts=True)
        if sizes[0] != 0:
            sizes, counts = np.append(0, sizes), np.append(0, counts)
        ranked = sizes <= len(known)
        risk = (len(needs) - np.cumsum(counts)) / len(needs)
        distances = np.append(0.0, known)[sizes[ranked]]
        return pd.DataFrame(
            {
                "margin_voxels": sizes[ranked],
                "volume_mm3": sizes[ranked] * step,
                "distance": distances,
                "risk": risk[ranked],
            }
        )

    @cached_property
    def final_shell(self) -> np.ndarray:
        """(n, 3) voxels outside structure and margin that share a face with them (Siebold, 3.3.1).

        To stay inside: voxels inside that share a face with the rim.
        """
        union = Region.around(self.structure_mask | self.mask, self.volume, 0.0)
        inside = union.part(self.inside)
        if self.purpose == "stay_inside":
            return np.argwhere(inside & ~ndimage.binary_erosion(inside, border_value=1)) + union.low
        return np.argwhere(ndimage.binary_dilation(inside) & ~inside) + union.low

    @cached_property
    def shell_distances(self) -> np.ndarray:
        """(n,) smallest Mahalanobis distance of the final shell's voxels to the structure's surface.

        Infinite under an error that does not scatter.
        """
        around = Region.around(self.structure_mask | self.mask, self.volume, 0.0)
        region = replace(around, solid=around.part(self.structure_mask).view(np.uint8))
        region = with_edge(region) if self.purpose == "stay_inside" else region
        moments = displacement_moments(self.model)
        if not widest_deviation(region, moments) > 0:
            return np.full(len(self.final_shell), np.inf)
        return all_distances(region, self.final_shell - region.low, moments)

    @property
    def shell_point_risks(self) -> np.ndarray:
        """(n,) point damage risk of the final shell's voxels, from the chi-squared law."""
        return point_damage_risk(self.shell_distances)

    def risk_on(
        self, registrations: int, rng: object = None, model: ErrorSource | None = None
    ) -> RiskEstimate:
        """Overall damage risk on fresh registrations, or under another error source.

        Parameters
        ----------
        registrations : int
        rng : anything `numpy.random.default_rng` takes
        model : ErrorSource, optional
            The margin's own by default.
        """
        if registrations != int(registrations) or registrations < 1:
            raise InputError(f"registrations: expected a positive number, got {registrations}")
        rng = np.random.default_rng(rng)
        hits = done = 0
        while done < registrations:
            count = min(100_000, registrations - done)
            transforms = checked_transforms(model or self.model, count, rng)
            hits += self._estimated(transforms).hits
            done += count
        return RiskEstimate(hits, done)

    def _estimated(self, transforms: np.ndarray) -> RiskEstimate:
        """Overall damage risk on given registrations."""
        if self.purpose == "protect":
            reach = reach_of(transforms, self.structure_mask, self.volume)
            region = Region.around(self.structure_mask, self.volume, reach)
            return overall_damage_risk(region, region.part(self.inside).view(np.uint8), transforms)
        whole = Region.around(self.structure_mask | self.mask, self.volume, 0.0)
        region = replace(whole, solid=whole.part(self.structure_mask).view(np.uint8))
        if self.purpose == "remove":
            return protrusion_risk(region, region.part(self.inside).view(np.uint8), transforms)
        order = np.flatnonzero(region.part(self.inside))
        lost = largest_losses(region, order, np.ones(len(order)), transforms)
        return RiskEstimate(int(np.count_nonzero(lost)), len(transforms))

    def summary(self) -> pd.Series:
        """The rows of Table 3.2, and what else says how good the margin is."""
        distances = self.shell_distances[np.isfinite(self.shell_distances)]
        values = {
            "structure": self.structure,
            "shape": self.shape,
            "purpose": self.purpose,
            "method": self.settings.method,
            "acceptable_risk": self.acceptable_risk,
            "safety_margin_volume_mm3": self.volume_mm3,
            "final_damage_probability": self.damage_risk,
            "mahalanobis_mean": float(distances.mean()) if len(distances) else np.nan,
            "mahalanobis_std": float(distances.std(ddof=1)) if len(distances) > 1 else np.nan,
            "distance": self.distance,
            "edge_share": self.edge_share,
            "time_s": self.time_s,
        }
        if self.validation is not None:
            values["validation_risk"] = self.validation.risk
            values["validation_low"], values["validation_high"] = self.validation.interval
        return pd.Series(values)
