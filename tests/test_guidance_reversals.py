"""Figure 7: what the record is made of, how lag is read, and what fusion makes of it."""

from dataclasses import replace

import numpy as np
import pytest

from study.errors import InputError
from study.experiments.filter_claims import dependence_claims, fusion_claims
from study.guidance.filter_comparison import (
    FIRST_ORDER,
    FUSED,
    RAW,
    SECOND_ORDER,
    compare_filters,
    fused_mm,
    fused_quality,
    lag_of,
    over_delays,
    over_noise,
    over_phases,
    over_runs,
    over_signals,
    over_speeds,
    signal_quality,
    told_settings,
)
from study.guidance.fusion import FusionSettings
from study.guidance.patient_motion import ADAPTIVE, HEAVY, LIGHT, PatientMotionSettings, move_patient
from study.guidance.patient_motion import RAW as SEEN
from study.guidance.reversals import Motion, ReversalSettings, record_reversals
from study.guidance.tracker import MarkerBody, Tracker, TrackerSettings, facing_pose
from study.plots.guidance_filters import filter_comparison, filter_dependence, patient_filter

SHORT = ReversalSettings(rest_s=3.0, strokes=4)
CLEAN = replace(
    SHORT,
    tracker=TrackerSettings(jitter_mm=(0, 0, 0), distortion_mm=0.0, quantum_mm=0.0),
    encoder_step_mm=0.0,
    gain_error=0.0,
)


@pytest.fixture(scope="module")
def record():
    return record_reversals(SHORT, 0)


def test_motion_is_what_the_settings_say():
    motion = Motion(SHORT)
    start, stop = SHORT.moving_s
    time = np.arange(0, stop + 1, 0.001)
    x, v = motion.position(time), motion.velocity(time)
    assert np.abs(v).max() == pytest.approx(SHORT.speed_mm_s)
    assert (x.min(), x.max()) == pytest.approx((0.0, SHORT.stroke_mm), abs=0.02)
    assert np.abs(np.gradient(v, time)).max() <= SHORT.acceleration_mm_s2 * 1.01
    assert np.abs(np.gradient(x, time) - v).max() < 0.2
    assert not x[time <= start].any() and np.abs(v[time > stop + 0.002]).max() < 1e-9
    # Jerk is limited: the acceleration takes the smoothing time to set in.
    jerk = np.abs(np.gradient(np.gradient(v, time), time)).max()
    assert jerk <= 2.05 * SHORT.acceleration_mm_s2 / SHORT.smoothing_s


def test_a_clean_record_is_the_truth_of_earlier():
    found = record_reversals(CLEAN, 0)
    time, motion = found.time_s, found.motion
    fresh = found.fresh
    # Frames every 40 ms, 40 ms old when they come and 60 a step later.
    assert fresh[::2].all() and not fresh[1::2].any()
    age = np.where(fresh, 0.04, 0.06)
    assert found.raw_mm == pytest.approx(motion.position(time - age), abs=1e-6)
    # Encoders: the mean speed over one cycle that ended 12 to 24 ms ago.
    ends = np.floor((time - 0.012) / 0.012 + 1e-6) * 0.012
    mean = (motion.position(ends) - motion.position(ends - 0.012)) / 0.012
    assert found.velocity[:, 0] == pytest.approx(mean, abs=1e-6)
    assert not found.velocity[:, 1:].any()


def test_gain_error_is_the_arms_own_belief():
    told = record_reversals(replace(CLEAN, gain_error=0.01), 0).velocity[:, 0]
    true = record_reversals(CLEAN, 0).velocity[:, 0]
    assert told == pytest.approx(true / 1.01)


def test_frames_between_steps_wait():
    found = record_reversals(replace(CLEAN, tracker_phase_s=0.005), 0)
    age = np.where(found.fresh, 0.055, 0.075)
    assert found.raw_mm == pytest.approx(found.motion.position(found.time_s - age), abs=1e-6)


def test_noise_is_the_trackers(record):
    """Of a tip on a lever: the first-order covariance of the marker's pose, carried to the tip."""
    long = record_reversals(replace(SHORT, rest_s=100.0, strokes=1), 1).noise
    tracker = Tracker(SHORT.tracker, 0)
    pose = facing_pose([0.0, 0.0, SHORT.distance_mm])
    covariance = tracker.pose_covariance(MarkerBody.plate(SHORT.marker_mm), pose[None])[0]
    lever = pose[:3, :3] @ [0.0, -SHORT.lever_mm, 0.0]
    # dp = dt + dr x lever
    J = np.hstack([[[0, lever[2], -lever[1]], [-lever[2], 0, lever[0]], [lever[1], -lever[0], 0]], np.eye(3)])
    expected = np.sqrt(np.diag(J @ covariance @ J.T) + SHORT.tracker.quantum_mm**2 / 12)
    assert long.position_mm == pytest.approx(expected, rel=0.06)
    assert long.rotation_rad == pytest.approx(np.sqrt(np.diag(covariance)[:3]), rel=0.06)


def test_same_seed_same_record(record):
    again = record_reversals(SHORT, 0)
    assert np.array_equal(record.tip, again.tip) and record.noise == again.noise
    assert not np.array_equal(record.tip, record_reversals(SHORT, 1).tip)


@pytest.mark.parametrize("lag", [-0.03, 0.0, 0.0137, 0.05, 0.2])
def test_lag_of_a_known_delay(lag):
    motion = Motion(SHORT)
    start, stop = SHORT.moving_s
    time = np.arange(start, stop, 0.02)
    noise = 0.02 * np.random.default_rng(0).normal(size=len(time))
    assert lag_of(time, motion.position(time - lag), motion) == pytest.approx(lag, abs=1e-5)
    assert lag_of(time, motion.position(time - lag) + noise, motion) == pytest.approx(lag, abs=5e-4)


def test_quality_of_the_truth_and_of_a_shifted_truth(record):
    quality = signal_quality(record.truth_mm, record)
    assert quality["rms_error_mm"] == quality["noise_at_rest_mm"] == 0.0
    assert abs(quality["lag_ms"]) < 0.01
    assert signal_quality(record.truth_mm + 0.3, record)["rms_error_mm"] == pytest.approx(0.3)


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("speed", [20.0, 40.0, 60.0])
def test_the_issues_goal_and_the_texts_claims(seed, speed):
    """At most 15 ms and a third of the raw error; quieter than raw; the low-pass lags more than both."""
    settings = replace(SHORT, speed_mm_s=speed)
    table = compare_filters(record_reversals(settings, seed)).table().set_index("signal")
    lag, error, noise = table["lag_ms"], table["rms_error_mm"], table["noise_at_rest_mm"]
    assert abs(lag[FUSED]) <= 15
    assert error[FUSED] <= error[RAW] / 3
    assert lag[FUSED] < lag[RAW] < lag[FIRST_ORDER] < lag[SECOND_ORDER]
    assert noise[FUSED] < noise[RAW] and noise[FIRST_ORDER] < noise[RAW]
    # Held frames are 40 or 60 ms old; the low-pass adds its own.
    assert lag[RAW] == pytest.approx(50, abs=1.5)
    assert lag[FIRST_ORDER] - lag[RAW] == pytest.approx(1e3 / (2 * np.pi * 3), abs=3)


def test_fusion_is_told_what_was_read(record):
    told = told_settings(record)
    assert told.lags == 2 and told.position_mm == record.noise.position_mm
    assert compare_filters(record).fusion == told
    late = record_reversals(replace(SHORT, tracker=replace(SHORT.tracker, delay_s=0.08)), 0)
    assert told_settings(late).lags == 4
    with pytest.raises(InputError, match="sample_s"):
        fused_mm(record, FusionSettings(sample_s=0.01))


def test_unsuspected_delay_becomes_lag():
    table = over_delays([0.04, 0.08], [0.04, 0.08], SHORT).set_index(["true_delay_ms", "believed_delay_ms"])
    lag = table["lag_ms"]
    assert lag[80, 40] - lag[40, 40] == pytest.approx(40, abs=3)
    assert lag[40, 80] - lag[40, 40] == pytest.approx(-40, abs=8)
    assert (table.loc[[(40, 40), (80, 80)], "error_over_raw_ratio"] <= 1 / 3).all()
    assert table.loc[(80, 40), "error_over_raw_ratio"] > 1 / 3


def test_waiting_frames_become_lag():
    table = over_phases([0.0, 0.01, 0.02], SHORT)
    assert table["waiting_ms"].tolist() == pytest.approx([0, 10, 0])
    assert table["lag_ms"][1] - table["lag_ms"][0] == pytest.approx(10, abs=1.5)


def test_errors_grow_with_speed():
    table = over_speeds([20.0, 40.0], SHORT)
    error = table.set_index(["signal", "speed_mm_s"])["rms_error_mm"]
    assert error[RAW, 40.0] == pytest.approx(2 * error[RAW, 20.0], rel=0.02)


def test_noise_trades_error_for_rest(record):
    table = over_noise(record, [0.005, 0.05, 1.0], [0.1])
    assert table["noise_at_rest_mm"].is_monotonic_increasing
    assert table["rms_error_mm"].is_monotonic_decreasing
    assert table["nis_moving"].is_monotonic_decreasing
    # A filter that trusts nothing but the tracker is as noisy as it.
    raw = signal_quality(record.raw_mm, record)["noise_at_rest_mm"]
    assert table["noise_at_rest_mm"].iloc[-1] == pytest.approx(raw, rel=0.02)
    assert fused_quality(record, told_settings(record))["nis_at_rest"] < 3


@pytest.mark.parametrize(
    "wrong",
    [
        {"speed_mm_s": 0.0},
        {"rest_s": 1.0},
        {"strokes": 0},
        {"gain_error": 1.0},
        {"encoder_delay_s": -0.01},
        {"stroke_mm": 5.0},
        {"sample_s": np.nan},
    ],
)
def test_settings_are_checked(wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        ReversalSettings(**wrong)


def test_runs_and_their_means():
    runs = over_runs(3, SHORT)
    means = over_signals(runs).set_index("signal")
    fused = runs[runs["signal"] == FUSED]
    assert len(fused) == 3 and fused["rms_error_mm"].nunique() == 3
    assert means.loc[FUSED, "rms_error_mm"] == pytest.approx(fused["rms_error_mm"].mean())
    assert means.loc[FUSED, "rms_error_mm_sd"] == pytest.approx(fused["rms_error_mm"].std(ddof=1))
    with pytest.raises(InputError, match="runs"):
        over_runs(0, SHORT)


def test_claims_follow_the_numbers(record):
    runs = over_runs(2, SHORT)
    assert [claim.holds for claim in fusion_claims(runs)] == [True, True, True, True, False]
    late = runs.copy()
    late.loc[late["signal"] == FUSED, "lag_ms"] += 100.0
    late.loc[late["signal"] == FUSED, "rms_error_mm"] *= 10.0
    assert [claim.holds for claim in fusion_claims(late)][:3] == [False, False, False]
    noise = over_noise(record, [0.02, 0.05, 0.1], [0.1])
    delays, waiting = over_delays([0.04, 0.08], [0.04], SHORT), over_phases([0.0, 0.01], SHORT)
    claims = dependence_claims(runs, noise, delays, waiting)
    assert claims[2].holds and claims[3].holds
    waiting.loc[1, "lag_ms"] = -20.0
    delays.loc[1, "lag_ms"] = 0.0
    turned = dependence_claims(runs, noise, delays, waiting)
    assert not turned[2].holds and not turned[3].holds
    assert "-20" in turned[3].evidence


def test_patient_filter_takes_the_best_of_both_weights():
    table = move_patient(rng=0).table().set_index("signal")
    rest, moving = table["noise_at_rest_mm"], table["rms_error_moving_mm"]
    assert rest[ADAPTIVE] < rest[SEEN] / 3 and rest[ADAPTIVE] == pytest.approx(rest[HEAVY], rel=0.02)
    assert moving[ADAPTIVE] < moving[HEAVY] / 3
    assert rest[LIGHT] > 0.8 * rest[SEEN]


def test_patient_is_noticed_soon_and_rest_is_left_alone():
    settings = PatientMotionSettings(shift_mm=5.0, turn_deg=0.0)
    found = move_patient(settings, rng=0)
    start = settings.rest_s
    assert not found.moving[found.time_s < start].any()
    assert not found.moving[found.time_s > start + settings.moving_s + 0.5].any()
    passed = np.linalg.norm(found.truth[:, :3, 3], axis=1) > 2 * found.thresholds[0]
    assert found.time_s[found.moving][0] <= found.time_s[passed][0]
    for wrong in ({"moving_s": 0.0}, {"rest_s": 1.0}, {"shift_mm": np.nan}):
        with pytest.raises(InputError, match=next(iter(wrong))):
            PatientMotionSettings(**wrong)


def test_pictures_are_drawn(record):
    comparison = compare_filters(record)
    figure = filter_comparison(comparison)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == ["truth", *comparison.signals]
    assert len(figure.axes[2].lines) == 5
    noise = over_noise(record, [0.02, 0.1], [0.1, 10.0])
    figure = filter_dependence(
        comparison, noise, over_delays([0.04], [0.04], SHORT), over_speeds([20.0], SHORT)
    )
    assert len(figure.axes[0].lines) == 2 + 3 + 1
    figure = patient_filter(move_patient(rng=0))
    assert [ax.get_xlabel() for ax in figure.axes] == ["time (s)"] * 3
    figure.canvas.draw()
