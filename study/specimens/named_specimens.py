"""The 36 specimens that carry the names of the printed ones (Siebold, appendix A)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
import pandas as pd

from study.errors import FileFormatError, InputError
from study.paths import data_path
from study.specimens.orientation import SIDES
from study.specimens.parameters import TemporalBoneParameters
from study.specimens.specimen import Specimen, fiducial_ring
from study.specimens.target import MASTOIDECTOMY, TRANSLABYRINTHINE, TargetRule, mastoidectomy_target
from study.specimens.temporal_bone import temporal_bone
from study.volumes import LabelVolume

_COLUMNS = ["name", "side", "seed", "size"]


@dataclass(frozen=True)
class Entry:
    """One line of the catalogue: everything a specimen is made from."""

    name: str
    side: str
    seed: int
    size: float

    @property
    def rule(self) -> TargetRule:
        """The target's rule: deep for whole heads (CH), down to the facial nerve for cut bones (TB).

        The opened region scales with the mastoid.
        """
        rule = TRANSLABYRINTHINE if self.name.startswith("CH") else MASTOIDECTOMY
        return replace(rule, max_radius=rule.max_radius * self.size)

    @property
    def parameters(self) -> TemporalBoneParameters:
        """Drawn from the anatomical ranges by the specimen's own seed; only the size is not drawn."""
        return TemporalBoneParameters.drawn(self.seed, side=self.side, size=self.size)


@cache
def _entries() -> dict[str, Entry]:
    path = data_path("catalogue.csv")
    table = pd.read_csv(path)
    if list(table.columns) != _COLUMNS or table.empty or table["name"].duplicated().any():
        raise FileFormatError(f"{path}: expected columns {_COLUMNS} and one line a name, got {list(table)}")
    if not table["side"].isin(SIDES).all():
        raise FileFormatError(f"{path}: expected sides {SIDES}, got {sorted(table['side'].unique())}")
    return {
        row.name: Entry(row.name, row.side, int(row.seed), float(row.size))
        for row in table.itertuples(index=False, name="Row")
    }


def catalogue() -> tuple[str, ...]:
    """Names of the specimens, in printed order: CH01 to CH19, then TB01 to TB17."""
    return tuple(_entries())


def build(entry: Entry) -> Specimen:
    """Make the specimen of a line of the catalogue, at the scanner's 0.4 mm.

    Raises
    ------
    PlanningError
        If its target comes out empty.
    """
    anatomy = temporal_bone(entry.parameters, entry.seed)
    planning = mastoidectomy_target(anatomy, entry.rule, entry.side)
    fiducials = fiducial_ring(planning, entry.side)
    return Specimen(entry.name, entry.side, anatomy, planning, fiducials, entry.rule, entry.parameters)


@lru_cache(maxsize=4)
def specimen(name: str) -> Specimen:
    """A specimen of the catalogue, the same bytes every time.

    They are our own procedural bones under the printed names. Each has one fitted number, its size,
    chosen so that a 5 mm burr's modified initial target has the volume printed in Table A.1 (within 2 %).
    All else follows from the specimen's seed.

    Parameters
    ----------
    name : str
        One of `catalogue`.

    Returns
    -------
    Specimen

    Raises
    ------
    InputError
        If there is no specimen of that name.
    """
    entries = _entries()
    if name not in entries:
        raise InputError(f"name: expected one of CH01-CH19, TB01-TB17, got {name!r}")
    return build(entries[name])


def fit_size(
    entry: Entry,
    wanted_cm3: float,
    measure: Callable[[LabelVolume], float],
    bounds: tuple[float, float] = (0.45, 1.6),
    tolerance: float = 0.004,
) -> Entry:
    """Find the size at which a specimen's planning volume measures as wanted, by bisection.

    Parameters
    ----------
    entry : Entry
    wanted_cm3 : float
    measure : callable
        From a planning volume to cm^3; grows with the size. It is an argument because planners build
        on specimens, not the other way round.
    bounds : (2,) floats
        Sizes to look between.
    tolerance : float
        Share of `wanted_cm3` that is near enough to stop. The voxel grid makes steps; after 14
        halvings the nearest size found is taken.

    Returns
    -------
    Entry
        With the size rounded to five digits.

    Raises
    ------
    InputError
        If the volume wanted is not between those at the bounds.
    """

    def measured(size: float) -> float:
        return measure(build(replace(entry, size=size)).planning)

    low, high = bounds
    ends = measured(low), measured(high)
    if not ends[0] <= wanted_cm3 <= ends[1]:
        raise InputError(
            f"{entry.name}: expected a volume between {ends[0]:.3f} and {ends[1]:.3f} cm^3 "
            f"(sizes {low} and {high}), got {wanted_cm3}"
        )
    found = {low: ends[0], high: ends[1]}
    for _ in range(14):
        middle = round(float(np.sqrt(low * high)), 5)
        found[middle] = measured(middle)
        if abs(found[middle] / wanted_cm3 - 1) <= tolerance:
            break
        low, high = (middle, high) if found[middle] < wanted_cm3 else (low, middle)
    best = min(found, key=lambda size: abs(found[size] - wanted_cm3))
    return replace(entry, size=best)
