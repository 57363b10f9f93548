"""Position and velocity of insertion and retraction (Zheng, section 3.7)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from study.fixtures.retraction import Retraction
from study.plots.style import new_axes, styled

AXIS_COLOURS = ("#0055a4", "#c8322d", "#2e9e3f")
STOP_COLOUR = "#111111"


@styled()
def insertion_and_retraction(out: Retraction, stopped: Retraction | None = None) -> Figure:
    """Position, speed and distance from the way in, of both.

    Parameters
    ----------
    out : Retraction
    stopped : Retraction, optional
        The same, stopped on command; drawn dashed.
    """
    way_in, limits = out.insertion, out.settings
    figure, axes = new_axes(
        3, 2, (11, 8.2), sharey="row", width_ratios=(way_in.seconds, max(out.seconds, way_in.seconds / 2))
    )
    times = way_in.times - way_in.times[0]
    for ax, at, poses, speeds, title in (
        (axes[:, 0], times, way_in.poses, way_in.velocities, f"insertion, {way_in.seconds:.1f} s"),
        (axes[:, 1], out.times, out.poses, out.velocities, f"retraction, {out.seconds:.1f} s"),
    ):
        for i, (name, colour) in enumerate(zip("xyz", AXIS_COLOURS, strict=True)):
            ax[0].plot(at, poses[:, i] - way_in.poses[0, i], color=colour, lw=1.2, label=name)
        ax[0].set_title(title)
        ax[1].plot(at, np.linalg.norm(speeds[:, :3], axis=1), color="#4a4f57", lw=1)
        ax[2].plot(at, out.deviations(poses), color="#4a4f57", lw=1)
        ax[2].set_xlabel("time, s")
    if stopped is not None:
        for i, colour in enumerate(AXIS_COLOURS):
            axes[0, 1].plot(
                stopped.times, stopped.poses[:, i] - way_in.poses[0, i], color=colour, lw=2.2, ls=":"
            )
        axes[1, 1].plot(
            stopped.times, np.linalg.norm(stopped.velocities[:, :3], axis=1), color=STOP_COLOUR,
            lw=1.8, ls=":",
            label=f"stopped at {stopped.stopped_at_s:.2f} s",
        )  # fmt: skip
    axes[1, 1].axhline(limits.speed_mm_s, color="#c8322d", lw=0.8, ls="--", label="limit")
    axes[2, 1].axhline(limits.tolerance_mm, color="#c8322d", lw=0.8, ls="--", label="tube")
    labels = "from the start, mm", "speed, mm/s", "from the way in, mm"
    for ax, label in zip(axes[:, 0], labels, strict=True):
        ax.set_ylabel(label)
    axes[0, 0].legend(ncols=3)
    axes[1, 1].legend()
    axes[2, 1].legend()
    return figure
