"""The causes, the room and the phantoms: what they promise and what they refuse."""

import doctest

import numpy as np
import pytest

import study.guidance.systems as systems_module
from study.errors import CalibrationError, InputError, ReachError
from study.guidance import (
    SYSTEMS,
    Faults,
    HoleRun,
    LoopSettings,
    Phantom,
    SafetySettings,
    Scene,
    acrylic_block,
    aluminium_block,
    causes,
    lateral_experiment,
    on_the_table,
    set_up,
    system,
)
from study.guidance.frames import rigid
from study.guidance.scene import facing_orientation
from study.guidance.tracker import view_angles

SPHERES = aluminium_block().spheres


def test_docstrings():
    assert doctest.testmod(systems_module).failed == 0


def test_every_cause_has_a_unit_a_range_and_a_source():
    table = causes()
    assert (table[["unit", "source"]].map(len) > 0).all(axis=None)
    for name in SYSTEMS:
        assert ((table["low"] <= table[name]) & (table[name] <= table["high"])).all()
        for cause in table.index:
            assert getattr(system(name), cause) == table.loc[cause, name]
    table.loc[:, "low"] = -1  # a copy
    assert (causes()["low"] >= 0).all()


def test_drawn_causes_lie_in_their_ranges_and_known_ones_stay():
    table, base = causes(), system("vanderbilt")
    draws = [base.drawn(k) for k in range(200)]
    for cause, row in table.iterrows():
        values = np.array([getattr(each, cause) for each in draws])
        if row["known"] == "yes":
            assert (values == getattr(base, cause)).all()
        else:
            assert ((values >= row["low"]) & (values <= row["high"])).all()
            assert np.ptp(values) > 0.5 * (row["high"] - row["low"])
            assert (values < getattr(base, cause)).any() or row["low"] == getattr(base, cause)
            assert (values > getattr(base, cause)).any()
    assert base.drawn(7) == base.drawn(7)
    assert base.drawn(7) != base.drawn(8)


def test_the_bit_bends_as_a_cantilever():
    bit = system("hannover", shank_mm=3.0, bit_length_mm=40.0)
    assert bit.bit_stiffness_n_mm == pytest.approx(3 * 200e3 * np.pi * 3.0**4 / 64 / 40.0**3)
    assert bit.but(bit_length_mm=80.0).bit_stiffness_n_mm == pytest.approx(bit.bit_stiffness_n_mm / 8)


@pytest.mark.parametrize(
    "changes",
    [
        {"tracker_jitter_mm": -0.1},
        {"tracker_jitter_mm": np.nan},
        {"tracker_jitter_mm": "0.1"},
        {"tracker_jitter_mm": True},
        {"tracker_cycle_s": 0.0},
        {"insertion_mm_s": 0.0},
        {"touches": 2.5},
        {"touches": 0},
        {"pivot_poses": np.inf},
        {"arm": "UR5"},
        {"calibration": "guess"},
        {"gravity": 9.81},
    ],
)
def test_system_refuses(changes):
    with pytest.raises(InputError, match=next(iter(changes))):
        system("hannover", **changes)


def test_unknown_system():
    with pytest.raises(InputError, match="hannover, vanderbilt"):
        system("boston")


def test_whole_numbers_may_come_as_floats():
    changed = system("hannover", touches=2.0, touch_frames=np.float64(5))
    assert changed == system("hannover", touches=2, touch_frames=5)
    set_up(changed, aluminium_block(), 0)


@pytest.mark.parametrize("name", SYSTEMS)
@pytest.mark.parametrize("cause", causes().index)
def test_both_ends_of_every_range_can_be_set_up(name, cause):
    for end in ("low", "high"):
        run = HoleRun(set_up(system(name, **{cause: causes().loc[cause, end]}), acrylic_block(), 0), 0, 0)
        run.run(3.0)
        assert np.isfinite(run._log[: len(run.result.time_s)]).all()


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("vanderbilt", {"pivot_poses": 2}),
        ("vanderbilt", {"pivot_cone_deg": 0.1}),
        ("hannover", {"hand_eye_poses": 2}),
        ("hannover", {"hand_eye_turn_deg": 0.01}),
    ],
)
def test_degenerate_calibration(name, changes):
    with pytest.raises(CalibrationError):
        set_up(system(name, **changes), aluminium_block(), 0)


def test_markers_face_the_camera():
    scene = Scene()
    T = np.stack([scene.T_rob_pat, scene.T_rob_base])
    assert view_angles(scene.T_cam_rob @ T) == pytest.approx(np.zeros(2), abs=1e-7)
    for hole in (acrylic_block().entries[0], np.zeros(3)):
        pose = scene.drilling_pose(acrylic_block().T_rob_img, hole, np.array([0.0, 0.0, 1.0]))
        T_cam_tool = scene.T_cam_rob @ pose @ np.linalg.inv(scene.T_tool_tcp)
        best = view_angles(T_cam_tool[None])[0]
        for turn in np.deg2rad([-2.0, 2.0]):  # turning about the drill does not make it any better
            c, s = np.cos(turn), np.sin(turn)
            spin = rigid([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
            other = scene.T_cam_rob @ pose @ spin @ np.linalg.inv(scene.T_tool_tcp)
            assert view_angles(other[None])[0] > best - 1e-3


def test_facing_needs_a_camera_beside_the_drill():
    down, T_tool_tcp = np.array([0.0, 0.0, -1.0]), Scene().T_tool_tcp
    R = facing_orientation(down, np.array([1.0, 2.0, 3.0]), T_tool_tcp)
    assert np.allclose(R @ R.T, np.eye(3))
    assert np.allclose(R[:, 2], down)
    for towards in ([0, 0, 5.0], [0, 0, -5.0], [0, 0, 0], [np.nan, 0, 0]):
        with pytest.raises(InputError, match="camera"):
            facing_orientation(down, np.array(towards, float), T_tool_tcp)
    with pytest.raises(InputError, match="camera"):
        facing_orientation(down, np.array([1.0, 0, 0]), np.eye(4))


@pytest.mark.parametrize(
    "changes",
    [
        {"camera": (0.0, 0.0)},
        {"looks_at": (np.nan, 0.0, 0.0)},
        {"tip_lever_mm": np.nan},
        {"mount_tilt_deg": np.inf},
    ],
)
def test_scene_refuses(changes):
    with pytest.raises(InputError, match=next(iter(changes))):
        Scene(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spheres": SPHERES[:2]}, "spheres"),
        ({"spheres": [[0, 0, 0], [1, 0, 0], [2, 0, 0]]}, "spheres"),
        ({"entries": [[0, 0, 0], [1, 1, 1]]}, "as many"),
        ({"entries": [[0, 0]]}, "entries"),
        ({"targets": [[0, 0, np.nan]]}, "targets"),
        ({"targets": [[0, 0, 0]]}, "some length"),
        ({"T_rob_img": 2 * np.eye(4)}, "T_rob_img"),
        ({"beyond_mm": -1.0}, "beyond_mm"),
        ({"beyond_mm": np.inf}, "beyond_mm"),
        ({"beyond_mm": np.nan}, "beyond_mm"),
    ],
)
def test_phantom_refuses(changes, message):
    good = {"spheres": SPHERES, "entries": [[0, 0, 0]], "targets": [[0, 0, 9]], "T_rob_img": np.eye(4)}
    Phantom("good", **good)
    with pytest.raises(InputError, match=message):
        Phantom("bad", **(good | changes))


def test_blocks_are_the_printed_ones():
    block = aluminium_block()
    assert block.entries.shape == (24, 3)
    assert len(block.spheres) == 5
    assert np.allclose(block.lengths, 35.0)
    assert block.beyond_mm == 2.0
    size = np.ptp(np.vstack([block.entries, block.spheres]), axis=0)
    assert (size[:2] < [125.0, 75.0]).all()
    acrylic = acrylic_block()
    assert acrylic.entries.shape == (6, 3)
    assert len(acrylic.spheres) == 3
    assert np.array_equal(acrylic.targets, acrylic_block().targets)
    assert not np.array_equal(acrylic.targets, acrylic_block(1).targets)


def test_out_of_reach():
    far = Phantom("far", SPHERES, [0, 0, 0], [0, 0, 9], rigid(translation=[3000.0, 0.0, 0.0]))
    with pytest.raises(ReachError, match="reach"):
        lateral_experiment(system("hannover"), 0, phantom=far)
    with pytest.raises(ReachError):
        HoleRun(set_up(system("vanderbilt"), on_the_table("deep", SPHERES, [0, 0, 0], [0, 0, 900]), 0), 0)


def test_lateral_needs_upright_holes():
    with pytest.raises(InputError, match="oblique"):
        lateral_experiment(system("hannover"), 0, phantom=acrylic_block())


@pytest.mark.parametrize("hole", [-1, 24, 1.5, True, np.nan, "0"])
def test_no_such_hole(hole):
    with pytest.raises(InputError, match="hole"):
        HoleRun(set_up(system("hannover"), aluminium_block(), 0), hole)


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ({"occluded": [("robot", 1, 2)]}, "tool, base, patient"),
        ({"occluded": [("tool", 1)]}, "occluded"),
        ({"frozen": [3.0]}, "frozen"),
        ({"silent": [(2, 1)]}, "from <= to"),
        ({"no_handshake": [(-1, 1)]}, "from <= to"),
        ({"frozen": [(0, np.nan)]}, "from <= to"),
        ({"spikes": [(1, (1, 2))]}, "three finite"),
        ({"patient_moves": [(1, 2, (0, np.inf, 0))]}, "three finite"),
    ],
)
def test_faults_refuse(faults, message):
    with pytest.raises(InputError, match=message):
        Faults(**faults)


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        (SafetySettings, {"frozen_samples": 1.5}),
        (SafetySettings, {"missing_samples": -1}),
        (SafetySettings, {"outlying_samples": 0}),
        (SafetySettings, {"patient_jump_mm": np.nan}),
        (SafetySettings, {"off_line_mm": 0.0}),
        (LoopSettings, {"wait_mm": 0.0}),
        (LoopSettings, {"settle_s": -1.0}),
        (LoopSettings, {"retraction": np.inf}),
    ],
)
def test_settings_refuse(kind, changes):
    with pytest.raises(InputError, match=next(iter(changes))):
        kind(**changes)
