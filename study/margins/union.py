"""Several margins around one structure, taken together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from study.errors import InputError
from study.margins.margin import SafetyMargin
from study.registration.sources import ErrorSource
from study.volumes import LabelVolume

# Voxels: how far grids may be from whole steps of each other.
_ON_GRID = 1e-3


def union_of_margins(
    margins: Sequence[SafetyMargin], model: ErrorSource, registrations: int = 5_000, rng: object = None
) -> SafetyMargin:
    """All that any of several margins holds, as one margin.

    The text proposes it against digitiser error: a margin for each of many sampled tracings, and their union
    (Siebold, 5.2). Every margin holds its own acceptable risk; the union's is lower, by how much says its
    validation under all errors at once.

    Parameters
    ----------
    margins : sequence of SafetyMargin
        Around the same structure for the same purpose, on one volume (padded or not).
    model : ErrorSource
        Under which the union is validated.
    registrations : int
        For that.
    rng : anything `numpy.random.default_rng` takes

    Returns
    -------
    SafetyMargin
        With the settings of the first, without a curve; ``estimate`` and ``validation`` are the same.

    Raises
    ------
    InputError
        If there are none, or they are not of one structure, purpose and grid.
    """
    margins = list(margins)
    if not margins:
        raise InputError("margins: expected at least one, got none")
    first = margins[0]
    for other in margins[1:]:
        if (other.structure, other.purpose) != (first.structure, first.purpose):
            raise InputError(
                f"margins: expected all to {first.purpose} {first.structure!r}, got one to {other.purpose} "
                f"{other.structure!r}"
            )
    lows = np.array([_offset(margin.volume, first.volume) for margin in margins])
    highs = lows + [margin.volume.shape for margin in margins]
    low, high = lows.min(axis=0), highs.max(axis=0)
    mask, body = np.zeros(high - low, bool), np.zeros(high - low, bool)
    labels = np.zeros(high - low, np.uint8)
    # The largest grid comes last: it knows most of what the others were padded with.
    for margin, start in sorted(zip(margins, lows, strict=True), key=lambda pair: pair[0].volume.labels.size):
        box = tuple(slice(a, a + n) for a, n in zip(start - low, margin.volume.shape, strict=True))
        mask[box] |= margin.mask
        body[box] |= margin.structure_mask
        labels[box] = margin.volume.labels
    if not all(np.count_nonzero(body) == np.count_nonzero(margin.structure_mask) for margin in margins):
        raise InputError(f"margins: expected the same {first.structure!r} in all, got different voxels")
    affine = first.volume.affine.copy()
    affine[:3, 3] = first.volume.points((low - lows[0])[None].astype(float))[0]
    whole = replace(
        first,
        model=model,
        volume=LabelVolume(labels, affine, first.volume.names),
        mask=mask,
        structure_mask=body,
        validation=None,
        history=None,
        choice=None,
        distance=max(margin.distance for margin in margins),
        time_s=sum(margin.time_s for margin in margins),
    )
    found = whole.risk_on(registrations, rng)
    return replace(whole, estimate=found, validation=found)


def _offset(volume: LabelVolume, of: LabelVolume) -> np.ndarray:
    """(3,) ints: index in the second volume of the first one's first voxel."""
    start = of.indices(volume.points(np.zeros((1, 3))))[0]
    steps = np.linalg.inv(of.affine[:3, :3]) @ volume.affine[:3, :3]
    if np.abs(start - np.rint(start)).max() > _ON_GRID or not np.allclose(steps, np.eye(3), atol=1e-6):
        raise InputError(
            f"margins: expected volumes of one grid, got one {start.round(4).tolist()} voxels off, its axes "
            f"{steps.round(6).tolist()} of the first one's"
        )
    return np.rint(start).astype(int)
