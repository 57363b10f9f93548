"""Figure 7 and its relatives: signals of an arm that turns back, of a patient who is moved."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import FixedLocator, NullLocator

from study.guidance.filter_comparison import FIRST_ORDER, FUSED, RAW, SECOND_ORDER, FilterComparison
from study.guidance.frames import difference
from study.guidance.patient_motion import ADAPTIVE, HEAVY, LIGHT, PatientRecord
from study.guidance.patient_motion import RAW as SEEN
from study.plots.style import legend_below, new_axes, styled

TRUTH = "#111111"
COLOURS = {RAW: "#8c8c8c", FIRST_ORDER: "#0072b2", SECOND_ORDER: "#56b4e9", FUSED: "#d55e00"}
#: In the order in which they are drawn: at rest the adaptive filter is the heavy one.
PATIENT_COLOURS = {SEEN: "#8c8c8c", LIGHT: "#009e73", HEAVY: "#0072b2", ADAPTIVE: "#d55e00"}
PATIENT_WIDTHS = {SEEN: 2.0, LIGHT: 1.0, HEAVY: 2.4, ADAPTIVE: 1.1}


def _plain(ax: Axes) -> None:
    ax.grid(color="0.92")
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)


@styled()
def filter_comparison(comparison: FilterComparison) -> Figure:
    """Figure 7: a motion with reversals as the tracker has it, low-passed and fused; a reversal; the errors.

    Parameters
    ----------
    comparison : FilterComparison
    """
    record, settings = comparison.record, comparison.record.settings
    time = record.time_s - settings.rest_s
    figure, axes = new_axes(1, 3, (13.5, 4.6), width_ratios=[1.15, 1.0, 1.15])
    whole, near, errors = axes[0]
    fine = np.arange(-0.5, min(3, settings.strokes) * settings.stroke_s + 0.5, 0.002)
    truth = record.motion.position(fine + settings.rest_s)
    for ax in (whole, near):
        ax.plot(fine, truth, color=TRUTH, lw=1.0, ls="--")
        for name, values in comparison.signals.items():
            held = "steps-post" if name == RAW else "default"
            ax.plot(time, values, color=COLOURS[name], lw=1.3, drawstyle=held)
        ax.set(xlabel="time (s)", ylabel="position (mm)")
    whole.set(title="(a) to and fro", xlim=fine[[0, -1]])
    turn = settings.stroke_s + settings.smoothing_s / 2
    top = record.motion.position(np.array([turn + settings.rest_s]))[0]
    reach = 0.32
    low = min(record.motion.position(turn + settings.rest_s + np.array([-reach, reach])))
    height = top - low
    near.set(
        title="(b) a reversal",
        xlim=(turn - reach, turn + reach),
        ylim=(low - 0.1 * height, top + 0.12 * height),
    )
    whole.add_patch(
        Rectangle(
            (turn - reach, low - 0.1 * height), 2 * reach, 1.22 * height, fill=False, edgecolor="0.4", lw=0.9
        )
    )
    for name, values in comparison.signals.items():
        errors.plot(time, values - record.truth_mm, color=COLOURS[name], lw=1.1)
    errors.axhline(0.0, color=TRUTH, lw=0.9, ls="--")
    errors.set(title="(c) error", xlabel="time (s)", ylabel="signal less truth (mm)", xlim=fine[[0, -1]])
    for ax in axes[0]:
        _plain(ax)
    figure.get_layout_engine().set(w_pad=0.12)
    handles = [Line2D([], [], color=TRUTH, lw=1.0, ls="--", label="truth")]
    handles += [Line2D([], [], color=COLOURS[name], lw=1.5, label=name) for name in comparison.signals]
    legend_below(figure, handles, 5)
    return figure


@styled()
def filter_dependence(
    comparison: FilterComparison, noise: pd.DataFrame, delays: pd.DataFrame, speeds: pd.DataFrame
) -> Figure:
    """What the fusion's result hangs on: noise that it is told, delay that it believes, the arm's speed.

    Parameters
    ----------
    comparison : FilterComparison
        Its other signals are shown as points.
    noise, delays, speeds : DataFrame
        Of `over_noise`, `over_delays` and `over_speeds`.
    """
    figure, axes = new_axes(1, 3, (13.5, 4.6))
    trade, late, fast = axes[0]
    shades = ("#7f2704", "#d94801", "#fd8d3c", "#fdbe85", "#c9a27e")
    trusts = noise.groupby("velocity_mm_s")
    for (velocity, rows), shade in zip(trusts, shades[: trusts.ngroups], strict=True):
        trade.plot(
            rows["noise_at_rest_mm"], rows["rms_error_mm"], "o-", ms=3.5, lw=1.2, color=shade,
            label=f"encoders ± {velocity:g} mm/s",
        )  # fmt: skip
    quality = comparison.table().set_index("signal")
    for name in (RAW, FIRST_ORDER, SECOND_ORDER):
        trade.plot(*quality.loc[name, ["noise_at_rest_mm", "rms_error_mm"]], "s", color=COLOURS[name], ms=6)
    trade.plot(
        *quality.loc[FUSED, ["noise_at_rest_mm", "rms_error_mm"]], "o", ms=11, mfc="none", mec=TRUTH, mew=1.2
    )
    trade.set(
        xscale="log", yscale="log", xlabel="noise at rest (mm)", ylabel="RMS error while moving (mm)",
        title="(a) fused, told other noise; ring: as used",
    )  # fmt: skip
    for axis, ticks in ((trade.xaxis, (0.01, 0.02, 0.05, 0.1, 0.2)), (trade.yaxis, (0.2, 0.5, 1, 2, 5))):
        axis.set_major_locator(FixedLocator(ticks))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    trade.legend(loc="upper right", fontsize=8)
    for ax in (trade, late, fast):
        _plain(ax)
    for (believed, rows), shade in zip(delays.groupby("believed_delay_ms"), shades, strict=False):
        late.plot(
            rows["true_delay_ms"], rows["lag_ms"], "o-", ms=4, color=shade, label=f"believed {believed:g} ms"
        )
    late.axhspan(-15, 15, color="0.93", zorder=0)
    late.axhline(0.0, color=TRUTH, lw=0.9, ls="--")
    late.set(
        xlabel="true delay of the tracker (ms)",
        ylabel="lag of the fused signal (ms)",
        title="(b) told another delay; band: ± 15 ms",
    )
    late.legend(loc="upper left", fontsize=8)
    for name, rows in speeds.groupby("signal", sort=False):
        fast.plot(rows["speed_mm_s"], rows["rms_error_mm"], "o-", ms=4, color=COLOURS[name])
    fast.set(
        xlabel="speed (mm/s)", ylabel="RMS error while moving (mm)", title="(c) other speeds", ylim=(0, None)
    )
    handles = [Line2D([], [], color=COLOURS[n], marker="s", ms=5, lw=1.5, label=n) for n in quality.index]
    legend_below(figure, handles, 4)
    return figure


@styled()
def patient_filter(record: PatientRecord) -> Figure:
    """A patient who is moved once, as seen and as filtered, with what the filter took for motion.

    Parameters
    ----------
    record : PatientRecord
    """
    settings = record.settings
    time = record.time_s - settings.rest_s
    cycle = settings.tracker.cycle_s
    figure, axes = new_axes(1, 3, (13.5, 4.4), width_ratios=[1.2, 1.0, 1.0])
    moved, rest, turned = axes[0]
    whole = (-0.5, settings.moving_s + 2.0)
    panels = (
        (moved, whole, "(a) moved by somebody"),
        (rest, (-3.0, -0.2), "(b) at rest"),
    )
    for ax, span, title in panels:
        inside = (time >= span[0]) & (time <= span[1])
        ax.plot(time[inside], record.truth[inside, 0, 3], color=TRUTH, lw=1.0, ls="--")
        for name, colour in PATIENT_COLOURS.items():
            x = record.signals[name][inside, 0, 3]
            ax.plot(time[inside], x, color=colour, lw=PATIENT_WIDTHS[name])
        ax.set(title=title, xlabel="time (s)", ylabel="position (mm)", xlim=span)
    inside = (time >= whole[0]) & (time <= whole[1])
    for name, colour in PATIENT_COLOURS.items():
        angle, _ = difference(record.signals[name][inside], record.truth[inside])
        turned.plot(time[inside], 1e3 * angle[:, 1], color=colour, lw=PATIENT_WIDTHS[name])
    turned.axhline(0.0, color=TRUTH, lw=0.9, ls="--")
    turned.set(
        title="(c) orientation, less truth",
        xlabel="time (s)",
        ylabel="about the turned axis (mrad)",
        xlim=whole,
    )
    for ax in (moved, turned):
        for at in time[record.moving & inside]:
            ax.axvspan(at, at + cycle, color="#fdeedd", lw=0, zorder=0)
    for ax in axes[0]:
        _plain(ax)
    handles = [Line2D([], [], color=TRUTH, lw=1.0, ls="--", label="truth")]
    handles += [
        Line2D([], [], color=colour, lw=PATIENT_WIDTHS[name], label=name)
        for name, colour in PATIENT_COLOURS.items()
    ]
    figure.get_layout_engine().set(w_pad=0.12)
    handles.append(Patch(facecolor="#fdeedd", label="taken for motion"))
    legend_below(figure, handles, 6)
    return figure
