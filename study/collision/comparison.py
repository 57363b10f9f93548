"""The two 5-DOF checks side by side: the octree and GJK of the text, and ours."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pandas as pd

from study.collision.directions import DirectionCheck
from study.collision.drill import Drill
from study.collision.octree import OctreeCheck
from study.errors import InputError
from study.volumes import LabelVolume


def _asked(ask: Callable[[int], np.ndarray], n: int) -> tuple[np.ndarray, float]:
    """Answers to questions 0 to n - 1, and milliseconds a question, the first call apart."""
    ask(0)
    clock = time.perf_counter()
    answers = np.array([ask(m) for m in range(n)])
    return answers, 1000 * (time.perf_counter() - clock) / n


def compare_checks(
    volume: LabelVolume,
    positions: np.ndarray,
    axes: np.ndarray,
    drill: Drill | None = None,
    half_width: float = np.deg2rad(2.5),
    samples: int = 18,
) -> pd.Series:
    """Ask both checks for the same windows of directions (2.5.1).

    Parameters
    ----------
    volume : LabelVolume
        With cubic voxels; everything but ``air`` is unmilled bone. The burr's ball is not taken out.
    positions : (n, 3) array
        Burr centres, mm.
    axes : (n, 3) array
        Unit vectors from the burr towards the drill body, mm frame: the middles of the windows.
    drill : Drill, optional
    half_width : float
        Radians of tilt and of tip to each side.
    samples : int
        Directions along each side of a window.

    Returns
    -------
    pandas.Series
        windows, directions, the share that is free, answers that differ, those that differ by more than
        the octree's rounding band (`OctreeCheck.gap_mm`, some 40 nm), milliseconds a window for the octree
        and for ours, as called, and their ratio.
    """
    positions, axes = np.asarray(positions, float), np.asarray(axes, float)
    if positions.ndim != 2 or positions.shape[1] != 3 or axes.shape != positions.shape:
        raise InputError(f"expected (n, 3) positions and axes, got {positions.shape} and {axes.shape}")
    solid = ~volume.mask("air")
    drill = Drill() if drill is None else drill
    at = volume.indices(positions) * volume.spacing
    along = axes @ volume.directions
    # Tilt and tip are measured about the index axis that most shafts run along.
    order = np.roll(np.arange(3), 1 - int(np.argmax(np.abs(along).sum(axis=0))))
    solid, along, at = np.transpose(solid, order), along[:, order], at[:, order]
    spacing = volume.spacing[order]
    if along[:, 1].sum() > 0:
        solid, along = solid[:, ::-1], along * [1, -1, 1]
        at[:, 1] = (solid.shape[1] - 1) * spacing[1] - at[:, 1]
    offsets = np.linspace(-half_width, half_width, samples)
    tilts = np.arctan2(along[:, 2], -along[:, 1])[:, None] + offsets
    tips = np.arcsin(along[:, 0])[:, None] + offsets
    tilt, tip = tilts[:, :, None], tips[:, None, :]
    every = np.stack([np.sin(tip) + 0 * tilt, -np.cos(tip) * np.cos(tilt), np.cos(tip) * np.sin(tilt)], -1)
    every = every.reshape(len(at), -1, 3)

    reference = OctreeCheck(solid, spacing, drill)
    ours = DirectionCheck(solid, spacing, drill, burr=False)
    by_octree, octree_ms = _asked(lambda m: reference.free(at[m], every[m]), len(at))
    by_us, our_ms = _asked(lambda m: ours.window(at[m], tilts[m], tips[m]).ravel(), len(at))
    # What the octree refuses within its stated rounding band is no disagreement.
    band = ours.widened(reference.gap_mm)
    near = np.array([band.window(p, a, b).ravel() for p, a, b in zip(at, tilts, tips, strict=True)])
    return pd.Series(
        {
            "windows": len(at),
            "directions": by_us.size,
            "free_share": by_us.mean(),
            "answers_that_differ": int(np.count_nonzero(by_octree != by_us)),
            "beyond_rounding": int(np.count_nonzero((by_octree & ~by_us) | (~by_octree & near))),
            "octree_ms_a_window": octree_ms,
            "ours_ms_a_window": our_ms,
            "ratio": octree_ms / our_ms,
        }
    )
