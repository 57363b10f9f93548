"""Chapter 4 of Siebold in 2-D: sections through a tumour with its margin, and what margins were grown by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from study.errors import InputError
from study.margins import SafetyMargin
from study.margins.published import transfer_share
from study.margins.removal_steps import Protrusion, RemovalStep
from study.plots.margins import HIT, points_in_plane, voxel_grid
from study.plots.palette import STYLES
from study.plots.planes import Plane
from study.plots.style import legend_below, new_axes, styled
from study.volumes import LabelVolume

#: Colours of margins that are compared.
SERIES = ("#0055a4", "#e07b00", "#159a37", "#8f3fa8", "#7a828c")


def axial_plane(centre: np.ndarray, half_width: float, half_height: float = 0.0, pixels: int = 500) -> Plane:
    """Across the body's long axis, seen from below as scans are: anterior on top, left on the right."""
    right, down = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    return Plane(np.asarray(centre, float), right, down, half_width, half_height or half_width, pixels)


def coronal_plane(
    centre: np.ndarray, half_width: float, half_height: float = 0.0, pixels: int = 500
) -> Plane:
    """Seen from the front: superior on top, left on the right."""
    right, down = np.array([1.0, 0, 0]), np.array([0, 0, -1.0])
    return Plane(np.asarray(centre, float), right, down, half_width, half_height or half_width, pixels)


def anatomy_layers(plane: Plane, volume: LabelVolume) -> list[tuple[np.ndarray, str, float]]:
    """Kidney and tumour in a section."""
    return [
        (plane.of(volume, volume.mask(name)), STYLES[name].colour, opacity)
        for name, opacity in (("kidney", 0.65), ("tumour", 1.0))
        if name in volume.names
    ]


def margin_section(
    axes: Axes, plane: Plane, margin: SafetyMargin, swab: np.ndarray | None = None, title: str = ""
) -> None:
    """Kidney, tumour and margin in a plane, with the swab points near it.

    Parameters
    ----------
    axes : Axes
    plane : Plane
    margin : SafetyMargin
    swab : (n, 3) array, optional
        mm.
    title : str
    """
    kidney, *_ = anatomy_layers(plane, margin.volume)
    body = plane.of(margin.volume, margin.structure_mask), STYLES["tumour"].colour, 1.0
    around = plane.of(margin.volume, margin.mask), STYLES["removed_margin"].colour, 0.85
    plane.show(axes, [kidney, around, body], title)
    if swab is not None:
        points_near(axes, plane, swab)


def points_near(axes: Axes, plane: Plane, points: np.ndarray, mm: float = 3.0) -> None:
    """Swab points within `mm` of a plane."""
    place = plane.place(points)
    near = place[np.abs(place[:, 2]) <= mm]
    axes.plot(*near[:, :2].T, "o", ms=4.2, mfc=STYLES["swab"].colour, mec="white", mew=0.4)


def protrusion_section(
    axes: Axes, plane: Plane, margin: SafetyMargin, grown: np.ndarray, shown: Protrusion
) -> None:
    """Structure and margin as planned, and where one registration shows the centres of its boundary voxels.

    Parameters
    ----------
    axes : Axes
    plane : Plane
    margin : SafetyMargin
        Says what the structure is.
    grown : (nx, ny, nz) bool array
        The margin drawn.
    shown : Protrusion
    """
    volume = margin.volume
    layers = [
        (plane.of(volume, grown), STYLES["removed_margin"].colour, 0.75),
        (plane.of(volume, margin.structure_mask), STYLES["tumour"].colour, 0.8),
    ]
    plane.show(axes, layers)
    voxel_grid(axes, plane, volume)
    points_in_plane(axes, plane, volume, shown.appear, shown.outside, 12)


@styled()
def removal_sections(axes: Sequence[Axes], plane: Plane, margin: SafetyMargin, step: RemovalStep) -> None:
    """Before, chosen and enclosed, after: one step of the printed growth in three axes.

    Parameters
    ----------
    axes : sequence of three Axes
    plane : Plane
    margin : SafetyMargin
    step : RemovalStep
    """
    volume = margin.volume
    names = {"tumour": 1.0, "removed_margin": 0.85, "violated": 1.0, "enclosed": 1.0}

    def layer(name: str, mask: np.ndarray) -> tuple[np.ndarray, str, float]:
        return plane.of(volume, mask), STYLES[name].colour, names[name]

    body, before = layer("tumour", margin.structure_mask), layer("removed_margin", step.before)
    chosen, enclosed = layer("violated", step.chosen), layer("enclosed", step.enclosed)
    counts = [int(np.count_nonzero(mask)) for mask in (step.chosen, step.enclosed)]
    titles = (
        f"(b) step {step.number}, risk {step.risk:.2g}",
        f"(c) {counts[0]} chosen, {counts[1]} enclosed",
        "(d) margin after it",
    )
    drawn = ([before, body], [before, chosen, enclosed, body], [layer("removed_margin", step.after), body])
    for ax, title, layers in zip(axes, titles, drawn, strict=True):
        plane.show(ax, layers, title)
        voxel_grid(ax, plane, volume)


@styled()
def removal_transfer_figure(margin: SafetyMargin) -> Figure:
    """Figure 4.5: what a step transfers against the overall damage risk, by the rule and in one growth.

    Parameters
    ----------
    margin : SafetyMargin
        To remove, grown with ``method="published"``.

    Raises
    ------
    InputError
        If it was not.
    """
    if margin.history is None or margin.purpose != "remove":
        raise InputError(f"{margin.structure}: expected a margin to remove, grown in steps")
    history, settings = margin.history, margin.settings
    steps = history.iloc[:-1]
    risk, shell = steps["risk"].to_numpy(), steps["shell_voxels"].to_numpy()
    start = settings.decay_start_of(margin.structure)
    figure, axes = new_axes(1, 2, (12, 4.6))
    x = np.unique(np.r_[np.geomspace(margin.acceptable_risk, 1, 400), start])
    law = np.array([transfer_share(r, margin.acceptable_risk, settings.initial_transfer, start) for r in x])
    least = settings.least_transfer
    count, share = axes[0]
    size = np.interp(x, np.sort(risk), shell[np.argsort(risk)]) if len(risk) else np.full(len(x), np.nan)
    count.plot(x, np.maximum(law * size, least), color="black", lw=2)
    count.axhline(least, color="black", lw=0.9, ls="--")
    count.vlines(
        risk, np.maximum(least, steps["transfer_share"] * shell), steps["transferred"], color=HIT, lw=1
    )
    count.plot(risk, steps["transferred"], "o", ms=6, mfc=HIT, mec="white", mew=0.5, zorder=3)
    count.set(xlim=(0, 1.03), ylim=(0, None), ylabel="voxels transferred in a step")
    count.set_title("(a) voxels, with the shells of this growth")
    share.plot(x, 100 * law, color="black", lw=2)
    share.plot(risk, 100 * steps["transferred"] / shell, "o", ms=6, mfc=HIT, mec="white", mew=0.5, zorder=3)
    share.set(xlim=(margin.acceptable_risk / 1.2, 1.15), ylim=(0, None), ylabel="% of the analyzed shell")
    share.set(xscale="log", title="(b) share of the shell, near the acceptable risk")
    for ax in axes[0]:
        ax.set(xlabel="overall damage risk at the start of a step")
        ax.axvline(margin.acceptable_risk, color="black", lw=0.9, ls=":")
        ax.spines[["top", "right"]].set_visible(False)
    handles = [
        Line2D([], [], color="black", lw=2, label="rule (4.2.5, 4.3.1)"),
        Line2D([], [], marker="o", ls="", ms=6, mfc=HIT, mec="white",
               label=f"steps of one growth ({len(risk)}), closing included"),
        Line2D([], [], color="black", lw=0.9, ls="--", label=f"least transfer, {least} voxels"),
        Line2D([], [], color="black", lw=0.9, ls=":", label=f"acceptable risk {margin.acceptable_risk:g}"),
    ]  # fmt: skip
    legend_below(figure, handles, 4)
    return figure


@styled()
def removal_risks(groups: Mapping[str, Mapping[str, SafetyMargin]]) -> Figure:
    """Overall damage risk against the margin's volume, in-sample and on fresh registrations.

    Parameters
    ----------
    groups : mapping
        Title of each panel to margins by what the legend calls them, in one order in all panels.
    """
    figure, axes = new_axes(1, len(groups), (6.2 * len(groups), 5.0), sharey=True)
    handles: dict[str, Line2D] = {}
    every = [margin for margins in groups.values() for margin in margins.values()]
    # A risk of none of the registrations has a level of its own, below that of one of them.
    none = 0.5 / max(margin.estimate.registrations for margin in every)
    for ax, (title, margins) in zip(axes[0], groups.items(), strict=True):
        for colour, (name, margin) in zip(SERIES, margins.items(), strict=False):
            table = margin.curve()
            risk = np.maximum(table["risk"], none)
            if margin.choice is None:
                ax.plot(table["volume_mm3"], risk, "o-", ms=3.5, lw=1.2, color=colour)
            else:
                ax.step(table["volume_mm3"], risk, where="post", color=colour, lw=1.8)
            at = margin.volume_mm3
            ax.plot(at, max(margin.damage_risk, none), "o", ms=9, mfc=colour, mec="black", zorder=4)
            if margin.validation is not None:
                low, high = np.maximum(margin.validation.interval, none)
                ax.plot([at, at], [low, high], color=colour, lw=3.5, alpha=0.75)
                ax.plot(at, max(margin.validation.risk, none), "_", ms=13, mew=2.5, color=colour)
            handles.setdefault(name, Line2D([], [], color=colour, lw=2.4, label=name))
        accepted = next(iter(margins.values())).acceptable_risk
        ax.axhline(accepted, color="black", lw=0.9, ls=":")
        ax.set(yscale="log", xlabel="volume of the margin (mm³)", title=title, xlim=(0, None))
        ax.spines[["top", "right"]].set_visible(False)
        ax.grid(color="#00000015", lw=0.6)
    ticks = [risk for risk in (1.0, 0.1, 0.01, 0.001, 0.0001) if risk > 1.5 * none]
    axes[0, 0].set(ylabel="overall damage risk", ylim=(none / 1.25, 1.3))
    axes[0, 0].set_yticks([*ticks, none], labels=[*(f"{risk:g}" for risk in ticks), "none"])
    axes[0, 0].minorticks_off()
    marks = [
        Line2D([], [], marker="o", ls="", ms=9, mfc="#bbbbbb", mec="black", label="where growth stopped"),
        Line2D([], [], marker="_", color="#777777", lw=3.5, ms=13, mew=2.5,
               label="on fresh registrations, 95 % interval"),
        Line2D([], [], color="black", lw=0.9, ls=":", label="acceptable risk"),
    ]  # fmt: skip
    legend_below(figure, [*handles.values(), *marks], 4)
    return figure


def risk_colours(shares: np.ndarray) -> mpl.colors.Normalize:
    """Scale of shares of registrations in %, from none to the largest; it spreads the small ones."""
    top = 100 * float(shares.max()) if len(shares) else 1.0
    return mpl.colors.PowerNorm(0.5, 0.0, max(top, 1e-6))
