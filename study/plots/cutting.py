"""How plans with different terms of the fitness cut: bone at a structure, force, angle, over the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from study.experiments.cutting import Cutting
from study.plots.style import legend_below, new_axes, styled

#: For each set of terms a colour and a line, in the order they are drawn; they differ in lightness too.
COLOURS = ("#111111", "#d55e00", "#56b4e9", "#0072b2", "#e69f00", "#009e73", "#cc79a7")
LINES = ("-", "-", "--", "-", "-", "-", ":")
CALM, NEAR = "#9aa0a6", "#c8322d"


@styled()
def bone_at_structure(
    records: Mapping[tuple[int, str], Cutting], names: Sequence[str], structure: str
) -> Figure:
    """Bone left within reach of a structure over the length of the path, a panel for each robot.

    Parameters
    ----------
    records : mapping of (dof, terms) to Cutting
    names : sequence of str
        Terms to draw.
    structure : str
        Its name, for the axis.
    """
    dofs = sorted({dof for dof, _ in records})
    figure, axes = new_axes(1, len(dofs), (5.2 * len(dofs), 4.4), sharey=True)
    for ax, dof in zip(axes[0], dofs, strict=True):
        for n, name in enumerate(names):
            record = records[dof, name]
            left = record.near.sum() - np.cumsum(record.near)
            ax.plot(record.way / 1000, left, color=COLOURS[n % 7], ls=LINES[n % 7], lw=1.6, label=name)
        ax.set(title=f"{dof} degrees of freedom", xlabel="path (m)", xlim=(0, None), ylim=(0, None))
        ax.spines[["top", "right"]].set_visible(False)
    within = next(iter(records.values())).near_mm
    axes[0, 0].set_ylabel(f"target left within {within:g} mm of the {structure} (mm³)")
    legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], 3)
    return figure


@styled()
def force_along_path(records: Mapping[str, Cutting], structure: str) -> Figure:
    """Force over the length of the path, a row for each plan, red where the burr is near the structure.

    Parameters
    ----------
    records : mapping of str to Cutting
        By the title of their row.
    structure : str
        Its name, for the legend.
    """
    figure, axes = new_axes(len(records), 1, (10, 1.9 * len(records) + 0.6), sharex=True, sharey=True)
    for ax, (name, record) in zip(axes[:, 0], records.items(), strict=True):
        metres = record.way / 1000
        ax.fill_between(metres, record.force, color=CALM, lw=0, label="elsewhere")
        ax.vlines(
            metres[record.at_structure], 0, record.force[record.at_structure], color=NEAR, lw=0.7,
            label=f"burr within {record.near_mm:g} mm of the {structure}",
        )  # fmt: skip
        ax.set(title=name, ylabel="mm³ of bone per mm", ylim=(0, None))
        ax.margins(x=0.005)
        ax.spines[["top", "right"]].set_visible(False)
    axes[-1, 0].set_xlabel("path (m)")
    legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], 2)
    return figure


@styled()
def angles_of_cut(records: Mapping[tuple[int, str], Cutting], names: Sequence[str]) -> Figure:
    """Share of the bone cut at less than an angle from the shaft's axis, a panel for each robot.

    Parameters
    ----------
    records : mapping of (dof, terms) to Cutting
    names : sequence of str
        Terms to draw.
    """
    dofs = sorted({dof for dof, _ in records})
    figure, axes = new_axes(1, len(dofs), (5.2 * len(dofs), 4.4), sharey=True)
    for ax, dof in zip(axes[0], dofs, strict=True):
        for n, name in enumerate(names):
            record = records[dof, name]
            cut = np.isfinite(record.sine)
            order = np.argsort(record.sine[cut])
            angle = np.rad2deg(np.arcsin(np.minimum(record.sine[cut][order], 1.0)))
            bone = np.cumsum(record.plan.removed[cut][order])
            ax.plot(angle, 100 * bone / bone[-1], color=COLOURS[n % 7], ls=LINES[n % 7], lw=1.6, label=name)
        ax.set(
            title=f"{dof} degrees of freedom",
            xlabel="angle between shaft and bone cut (°): 0 pole, 90 equator",
            xlim=(0, 90), ylim=(0, 100), xticks=range(0, 91, 15),
        )  # fmt: skip
        ax.spines[["top", "right"]].set_visible(False)
    axes[0, 0].set_ylabel("bone cut at a smaller angle (%)")
    legend_below(figure, axes[0, 0].get_legend_handles_labels()[0], 3)
    return figure
