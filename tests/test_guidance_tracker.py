"""The optical tracker: what it does to markers, against brute force and Monte Carlo."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance.frames import difference, rigid
from study.guidance.tracker import MarkerBody, Tracker, TrackerSettings, facing_pose, touch, view_angles
from study.registration import register_points
from study.registration.first_order import motion_of_points

BODY = MarkerBody.plate(80.0)


def poses(n: int, seed: int = 0) -> np.ndarray:
    """Markers in the measuring volume, turned to the camera within some 30 degrees."""
    rng = np.random.default_rng(seed)
    places = rng.uniform([-400, -300, 1400], [400, 300, 2200], (n, 3))
    return facing_pose(places) @ rigid(Rotation.from_rotvec(rng.normal(size=(n, 3)) * 0.3))


def test_a_plate_can_be_told_from_itself_turned():
    apart = np.linalg.norm(BODY.points[:, None] - BODY.points, axis=2)[np.triu_indices(4, 1)]
    assert np.diff(np.sort(apart)).min() > 1.0
    assert np.abs(BODY.points.mean(axis=0)).max() < 1e-12
    assert (BODY.points**2).sum(axis=1).mean() == pytest.approx(80.0**2 / 2)


def test_distortion_has_the_stated_size_and_length():
    """Over many trackers: rms length, zero mean, and a correlation that falls off as stated."""
    settings = TrackerSettings(distortion_mm=0.2, distortion_length_mm=300.0)
    steps = np.array([0.0, 150.0, 300.0, 600.0])
    line = np.array([100.0, -50.0, 1800.0]) + steps[:, None] * np.array([0.6, 0.0, 0.8])
    found = np.array([Tracker(settings, seed).distortion(line) for seed in range(4000)])
    assert np.sqrt((found**2).sum(axis=2).mean(axis=0)) == pytest.approx(0.2, rel=0.03)
    products = (found[:, :1] * found).sum(axis=2).mean(axis=0) / 0.2**2
    assert products == pytest.approx(np.exp(-(steps**2) / (2 * 300.0**2)), abs=0.04)


def test_distortion_stays_and_another_tracker_has_another():
    places = poses(5)[:, :3, 3]
    tracker = Tracker(rng=1)
    assert np.array_equal(tracker.distortion(places), tracker.distortion(places))
    assert np.array_equal(tracker.distortion(places), Tracker(rng=1).distortion(places))
    assert not np.allclose(tracker.distortion(places), Tracker(rng=2).distortion(places))


def test_distorted_is_the_registration_of_misplaced_spheres():
    tracker = Tracker(rng=3)
    true = poses(20)
    for pose, found in zip(true, tracker.distorted(BODY, true), strict=True):
        spheres = BODY.points @ pose[:3, :3].T + pose[:3, 3]
        fit = register_points(BODY.points, spheres + tracker.distortion(spheres))
        assert np.abs(found - fit.transform).max() < 1e-9


def test_near_markers_share_the_distortion():
    """The difference between two markers 50 mm apart errs much less than either does."""
    near = np.eye(4)
    near[0, 3] = 50.0
    alone, apart = [], []
    for seed in range(100):
        tracker = Tracker(rng=seed)
        first = poses(1, seed)
        second = first @ near
        one = tracker.distorted(BODY, first)[0, :3, 3] - first[0, :3, 3]
        two = tracker.distorted(BODY, second)[0, :3, 3] - second[0, :3, 3]
        alone.append(one @ one)
        apart.append((two - one) @ (two - one))
    assert np.sqrt(np.mean(apart)) < 0.3 * np.sqrt(np.mean(alone))


def test_covariance_is_that_of_many_samples():
    settings = TrackerSettings(quantum_mm=0.0, jitter_mm=(0.05, 0.04, 0.15))
    tracker = Tracker(settings, rng=0)
    body = MarkerBody(BODY.points + np.array([10.0, -5.0, 20.0]), "off its origin")
    for pose in poses(3):
        true = np.tile(pose, (40_000, 1, 1))
        turn, shift = difference(tracker.measured(body, true, rng=1), tracker.distorted(body, true[:1]))
        found = np.cov(np.hstack([turn, shift]), rowvar=False)
        expected = tracker.pose_covariance(body, pose[None])[0]
        scale = np.sqrt(np.diag(expected))
        assert np.abs((found - expected) / np.outer(scale, scale)).max() < 0.03


def test_more_and_farther_spheres_err_less():
    tracker = Tracker(rng=0)
    pose = poses(1)
    usual = tracker.pose_covariance(BODY, pose)[0]
    twice = tracker.pose_covariance(MarkerBody.plate(160.0), pose)[0]
    assert np.allclose(twice[:3, :3], usual[:3, :3] / 4) and np.allclose(twice[3:, 3:], usual[3:, 3:])
    turned = BODY.points @ Rotation.from_rotvec([0, 0, np.pi / 4]).as_matrix().T
    eight = MarkerBody(np.vstack([BODY.points, turned]))
    assert np.trace(tracker.pose_covariance(eight, pose)[0, 3:, 3:]) == pytest.approx(
        np.trace(usual[3:, 3:]) / 2
    )
    assert np.trace(tracker.pose_covariance(eight, pose)[0, :3, :3]) < 0.55 * np.trace(usual[:3, :3])


def test_without_causes_the_tracker_is_right():
    tracker = Tracker(TrackerSettings(jitter_mm=(0, 0, 0), distortion_mm=0.0, quantum_mm=0.0), rng=0)
    true = poses(10)
    assert np.abs(tracker.measured(BODY, true, rng=0) - true).max() < 1e-9
    assert not tracker.pose_covariance(BODY, true).any()


def test_positions_are_rounded():
    tracker = Tracker(TrackerSettings(quantum_mm=0.05), rng=0)
    found = tracker.measured(BODY, poses(50), rng=0)[:, :3, 3] / 0.05
    assert np.abs(found - np.round(found)).max() < 1e-6


def test_many_poses_take_little_time():
    """A thousand virtual experiments ask for some 300 poses each."""
    tracker, true, rng = Tracker(rng=0), poses(300), np.random.default_rng(0)
    tracker.measured(BODY, true, rng)
    best = np.inf
    for _ in range(5):
        start = time.perf_counter()
        tracker.distorted(BODY, true)
        tracker.pose_covariance(BODY, true)
        best = min(best, time.perf_counter() - start)
    assert best < 0.03, f"distorted and pose_covariance of 300 poses took {best * 1e3:.1f} ms"


def test_facing_poses_face():
    places = np.array([[300.0, -200.0, 1800.0], [2000.0, 0.0, 100.0], [0.0, 0.0, 900.0]])
    many = facing_pose(places)
    for place, pose in zip(places, many, strict=True):
        assert np.array_equal(facing_pose(place), pose)
        assert np.allclose(pose @ [0, 0, np.linalg.norm(place), 1], [0, 0, 0, 1])
        assert np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3)) and np.linalg.det(pose[:3, :3]) > 0
    assert facing_pose([0, 0, 100.0], [0, 0, 300.0])[:3, 2].tolist() == [0, 0, 1]


def test_view_angles():
    pose = facing_pose([300.0, -200.0, 1800.0])
    turned = pose @ rigid(Rotation.from_rotvec([0.4, 0, 0]))
    assert view_angles(np.array([pose, turned])) == pytest.approx([0.0, 0.4], abs=1e-7)


@pytest.mark.parametrize(
    ("make", "word"),
    [
        (lambda: MarkerBody([[0, 0, 0], [1, 0, 0]]), "at least 3"),
        (lambda: MarkerBody([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), "one line"),
        (lambda: MarkerBody.plate(-1.0), "size_mm"),
        (lambda: TrackerSettings(jitter_mm=(0.1, 0.1)), "jitter_mm"),
        (lambda: TrackerSettings(distortion_mm=np.nan), "distortion_mm"),
        (lambda: TrackerSettings(distortion_length_mm=0.0), "distortion_length_mm"),
        (lambda: TrackerSettings(cycle_s=-0.04), "cycle_s"),
        (lambda: TrackerSettings(waves=0), "waves"),
        (lambda: Tracker(rng=0).measured(BODY, np.eye(4)), "shape"),
        (lambda: Tracker(rng=0).measured(BODY, 2 * np.eye(4)[None]), "rotation"),
        (lambda: Tracker(rng=0).distorted(BODY, np.full((1, 4, 4), np.nan)), "finite"),
        (lambda: Tracker(rng=0).distortion([[0, 0, np.inf]]), "finite"),
        (lambda: facing_pose([0, 0, 0]), "apart from"),
        (lambda: facing_pose([0, np.nan, 0]), "finite"),
        (lambda: facing_pose([0, 0]), "shape"),
        (lambda: view_angles(np.eye(4)[None]), "origin"),
    ],
)
def test_bad_input_is_named(make, word):
    with pytest.raises(InputError, match=word):
        make()


# -------------------------------------------------------------------------------------------- pointer

TIP = rigid(translation=[0.0, -150.0, 0.0])
QUIET = TrackerSettings(jitter_mm=(0, 0, 0), distortion_mm=0.0, quantum_mm=0.0)
POINTS = np.array([[50.0, 20.0, 1700.0], [-30.0, 40.0, 1750.0], [0.0, -60.0, 1680.0]])
REF = facing_pose([100.0, 100.0, 1720.0])


def in_reference(points: np.ndarray) -> np.ndarray:
    return (points - REF[:3, 3]) @ REF[:3, :3]


def test_a_touch_without_causes_is_where_the_point_is():
    found = touch(Tracker(QUIET, 0), BODY, TIP, POINTS, REF, seating_std_mm=0.0, rng=0)
    assert np.abs(found - in_reference(POINTS)).max() < 1e-9


def test_a_touch_misses_by_what_it_is_told():
    """Seating alone scatters as stated; a tip's error alone keeps its length and turns with the pointer."""
    many = np.tile(POINTS, (2000, 1))
    found = touch(Tracker(QUIET, 0), BODY, TIP, many, REF, seating_std_mm=0.05, rng=0)
    assert (found - in_reference(many)).std(axis=0) == pytest.approx([0.05] * 3, rel=0.05)
    error = [0.1, -0.2, 0.2]
    found = touch(
        Tracker(QUIET, 0), BODY, TIP, many, REF, seating_std_mm=0.0, rng=0, tip_error_mm=error
    ) - in_reference(many)
    assert np.linalg.norm(found, axis=1) == pytest.approx(0.3)
    assert 0.8 < np.linalg.norm(found.mean(axis=0)) / 0.3 < 0.999


def test_frames_of_a_touch_are_averaged():
    """As the first order of both markers' covariances says: the pointer's tip, seen from the reference."""
    tracker = Tracker(TrackerSettings(distortion_mm=0.0), rng=0)
    many = np.tile(POINTS[0], (20_000, 1))
    once, often = (
        touch(tracker, BODY, TIP, many, REF, seating_std_mm=0.0, samples=n, rng=1, tilt_rad=0.0)
        for n in (1, 25)
    )
    assert often.std(axis=0) == pytest.approx(once.std(axis=0) / 5, rel=0.03)
    held = facing_pose(POINTS[0]) @ rigid(translation=-TIP[:3, 3])
    expected = np.zeros((3, 3))
    for pose in (held, REF):
        at = motion_of_points(POINTS[:1] - pose[:3, 3], np.zeros(3))[0]
        expected += at @ tracker.pose_covariance(BODY, pose[None])[0] @ at.T
    expected = REF[:3, :3].T @ expected @ REF[:3, :3]
    scale = np.sqrt(np.diag(expected))
    assert np.abs((np.cov(once, rowvar=False) - expected) / np.outer(scale, scale)).max() < 0.05


def test_a_reference_may_move_between_touches():
    refs = np.array([REF, facing_pose([-50.0, 0.0, 1600.0]), facing_pose([0.0, 100.0, 1900.0])])
    found = touch(Tracker(QUIET, 0), BODY, TIP, POINTS, refs, seating_std_mm=0.0, rng=0)
    for ref, point, one in zip(refs, POINTS, found, strict=True):
        assert np.abs(ref[:3, :3] @ one + ref[:3, 3] - point).max() < 1e-9


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"T_cam_ref": poses(2)}, "one pose or 3"),
        ({"seating_std_mm": -0.1}, "seating_std_mm"),
        ({"samples": 0}, "samples"),
        ({"points": [[np.nan, 0, 0]]}, "points"),
        ({"T_pointer_tip": 2 * np.eye(4)}, "T_pointer_tip"),
    ],
)
def test_bad_touches_are_named(change, word):
    usual = {"T_pointer_tip": TIP, "points": POINTS, "T_cam_ref": REF, "seating_std_mm": 0.0, "samples": 1}
    with pytest.raises(InputError, match=word):
        touch(Tracker(QUIET, 0), BODY, **(usual | change), rng=0)


def test_a_spec_sheet_as_white_noise_would_shake_the_tip():
    """Why the printed 0.25 mm r.m.s. is split: what it does to a tip 180 mm away in one frame."""
    white = TrackerSettings(jitter_mm=(0.25 / np.sqrt(3),) * 3, distortion_mm=0.0)
    split = TrackerSettings(distortion_mm=0.23)
    assert white.sphere_rms_mm == pytest.approx(0.25) == pytest.approx(split.sphere_rms_mm, rel=0.01)
    pose = poses(1)
    at = motion_of_points(180.0 * pose[:, :3, 0], np.zeros(3))[0]
    shakes = [
        np.sqrt(np.trace(at @ Tracker(one, 0).pose_covariance(BODY, pose)[0] @ at.T))
        for one in (white, split)
    ]
    assert shakes == pytest.approx([0.4, 0.2], rel=0.1)
