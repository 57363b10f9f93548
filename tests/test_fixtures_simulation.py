"""Hands, and the loop in which they guide a tool."""

from time import perf_counter

import numpy as np
import pandas as pd
import pytest
from fixture_cases import VtkDistance, plate, rough
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.errors import FileFormatError, InputError
from study.fixtures import Controller, MeshFixture, ShaftTool, Slack, SphereTool
from study.fixtures.hands import RandomHand, RecordedHand, ScriptedHand, Tremor
from study.fixtures.simulation import simulate

STEADY = Tremor(0, rms_mm=0.0, rms_rad=0.0)


@pytest.fixture(scope="module")
def ball():
    return MeshFixture(rough(subdivisions=3))


def pressed(fixture, seed=1, seconds=3.0, **options):
    hand = RandomHand(seed, [[0.0, 0, 0], [0, 3, 0]], **options)
    return simulate(Controller([fixture], SphereTool(0.8)), hand, [0, 0, 8.0], seconds)


def test_tremor_has_its_size_and_its_band():
    t = np.arange(0, 60, 1 / 400)
    tremor = Tremor(4, rms_mm=0.12, rms_rad=0.003)
    shake = np.array([tremor.displacement(s, 6) for s in t])
    assert np.sqrt((shake[:, :3] ** 2).sum(1).mean()) == pytest.approx(0.12, rel=0.05)
    assert np.sqrt((shake[:, 3:] ** 2).sum(1).mean()) == pytest.approx(0.003, rel=0.05)
    power = (np.abs(np.fft.rfft(shake * np.hanning(len(t))[:, None], axis=0)) ** 2).sum(1)
    f = np.fft.rfftfreq(len(t), 1 / 400)
    assert power[(f >= 7.9) & (f <= 12.1)].sum() / power.sum() > 0.999
    rate = np.array([tremor.velocity(s, 6) for s in t])
    np.testing.assert_allclose(
        np.gradient(shake, t, axis=0)[1:-1], rate[1:-1], atol=0.01 * np.abs(rate).max()
    )
    assert tremor.displacement(1.0).shape == (3,)


def test_random_hand_pushes_towards_its_targets():
    hand = RandomHand(0, [[0.0, 0, 0], [9, 0, 0]], hold_s=1.0, tremor=STEADY)
    x, wandered = np.array([4.0, 3, 0]), []
    for t in np.arange(0, 2, 0.01):
        target = np.array([0.0, 0, 0]) if t < 1 else np.array([9.0, 0, 0])
        push = 4 * (target - x)
        push *= min(1, 8.0 / np.linalg.norm(push))
        wandered.append(hand.desired(t, x) - push)
    assert np.sqrt((np.array(wandered) ** 2).sum(1).mean()) == pytest.approx(3.0, rel=0.5)
    assert np.abs(np.diff(wandered, axis=0)).max() < 0.01 * 2 * np.pi * 2 * 3 * 4  # slower than 2 Hz allows


def test_scripted_hand_arrives_turned_and_on_time():
    end = [3.0, -1, 2, 0.4, -0.2, 0.1]
    hand = ScriptedHand([[0.0, 0, 0, 0, 0, 0], [3, 0, 0, 0, 0, 0], end], speed_mm_s=2.0, hold_s=0.25)
    turn = np.linalg.norm(end[3:])
    assert hand.seconds == pytest.approx(1.5 + 0.25 + max(np.sqrt(5) / 2, turn / 0.2) + 0.25)
    np.testing.assert_allclose(hand.goal(0.75), [1.5, 0, 0, 0, 0, 0], atol=1e-12)
    far = MeshFixture(plate(3))
    shifted = ScriptedHand(np.add(hand.waypoints, [0, 0, 50, 0, 0, 0]), speed_mm_s=2.0, hold_s=0.25)
    run = simulate(Controller([far], ShaftTool(1.0, 0.5, 30.0)), shifted, [0, 0, 50, 0, 0, 0], hand.seconds)
    assert set(run.log["status"]) == {"free"}
    # The goal's own velocity is commanded too, so that the tool does not lag.
    on_the_way = [shifted.goal(t)[:3] for t in run.times[:-1]]
    assert np.abs(run.poses[:-1, :3] - on_the_way).max() < 0.02
    left = Rotation.from_rotvec(run.end[3:]) * Rotation.from_rotvec(end[3:]).inv()
    assert left.magnitude() < 0.01
    np.testing.assert_allclose(run.end[:3], np.add(end[:3], [0, 0, 50]), atol=0.02)


def test_a_goal_behind_a_surface_presses_and_slides():
    fixture = MeshFixture(plate())
    hand = ScriptedHand([[-3, 0, 3], [-3, 0, -0.5], [3, 0, -0.5]], speed_mm_s=4.0)
    run = simulate(Controller([fixture], SphereTool(1.0)), hand, [-3, 0, 3], hand.seconds + 1)
    assert run.end == pytest.approx([3, 0, 1], abs=0.05)
    assert run.poses[:, 2].min() > 1
    assert (run.log["status"] == "constrained").mean() > 0.5


@given(
    n=st.integers(1, 30),
    freedoms=st.sampled_from([3, 6]),
    seed=st.integers(0, 2**31),
    scale=st.floats(1e-12, 1e9),
)
@settings(deadline=None, max_examples=15)
def test_recorded_round_trip(n, freedoms, seed, scale, tmp_path_factory):
    rng = np.random.default_rng(seed)
    hand = RecordedHand(np.cumsum(rng.uniform(1e-4, 1, n)), scale * rng.normal(size=(n, freedoms)))
    path = tmp_path_factory.mktemp("hand") / "hand.csv"
    hand.to_csv(path)
    again = RecordedHand.read_csv(path)
    assert np.array_equal(again.times, hand.times)
    assert np.array_equal(again.velocities, hand.velocities)


def test_recorded_hand_holds_and_lets_go():
    hand = RecordedHand([1.0, 2.0, 3.0], np.arange(9.0).reshape(3, 3))
    assert hand.desired(0.99, None).tolist() == [0, 0, 0]
    assert hand.desired(1.0, None).tolist() == [0, 1, 2]
    assert hand.desired(2.999, None).tolist() == [3, 4, 5]
    assert hand.desired(3.5, None).tolist() == [6, 7, 8]
    assert hand.desired(4.0, None).tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,x_mm_s,y_mm_s,z_mm_s\n0,1,2,3\n0,1,2,3\n", "times that grow, row 1"),
        ("time_s,x_mm_s,y_mm_s,z_mm_s\n0,1,2,3\n1,1,,3\n", "finite numbers, row 1"),
        ("time_s,x_mm_s,y_mm_s,z_mm_s\n0,1,two,3\n", "two"),
        ("time,x,y,z\n0,1,2,3\n", "expected the columns"),
        ("time_s,x_mm_s,y_mm_s,z_mm_s\n", "n at least 1"),
        ("", "cannot be read"),
    ],
)
def test_recorded_files_that_are_none(text, message, tmp_path):
    path = tmp_path / "hand.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=message) as raised:
        RecordedHand.read_csv(path)
    assert "hand.csv" in str(raised.value)
    with pytest.raises(FileFormatError, match="cannot be read"):
        RecordedHand.read_csv(tmp_path / "none.csv")


def test_never_in_although_pressed(ball):
    run = pressed(ball)
    other = VtkDistance(rough(subdivisions=3))
    assert min(other(x) for x in run.poses) > 0.8
    assert (run.log["status"] == "constrained").mean() > 0.5
    wanted = run.poses[:-1] + run.log[["hand_x_mm_s", "hand_y_mm_s", "hand_z_mm_s"]].to_numpy() * run.cycle_s
    assert min(other(x) for x in wanted) < 0.8 - 0.01
    np.testing.assert_allclose(
        np.diff(run.poses, axis=0), run.log[["move_x_mm", "move_y_mm", "move_z_mm"]], atol=1e-14
    )


def test_same_seed_same_bytes_and_the_log_replays(ball, tmp_path):
    one, two, other = pressed(ball), pressed(ball), pressed(ball, seed=2)
    bare = [run.log.drop(columns="compute_us") for run in (one, two, other)]
    assert bare[0].to_csv() == bare[1].to_csv() != bare[2].to_csv()
    one.hand.to_csv(tmp_path / "hand.csv")
    hand = RecordedHand.read_csv(tmp_path / "hand.csv")
    again = simulate(Controller([ball], SphereTool(0.8)), hand, [0, 0, 8.0], 3.0)
    assert np.array_equal(again.poses, one.poses)
    one.to_csv(tmp_path / "run.csv")
    back = pd.read_csv(tmp_path / "run.csv", dtype=str)
    assert back["x_mm"].astype(float).tolist() == one.log["x_mm"].tolist()
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".writing")] == []


def test_a_stop_is_logged_and_the_hand_goes_on():
    control = Controller([MeshFixture(plate())], SphereTool(1.0))
    hand = ScriptedHand([[0, 0, 0.5], [0, 0, 4]])
    run = simulate(control, hand, [0, 0, 0.5], 0.5)
    assert set(run.log["status"]) == {"inside"}
    assert len(run.log) == 100
    assert run.end.tolist() == [0, 0, 0.5]
    assert run.log["clearance_mm"].iloc[-1] == pytest.approx(-0.5)


class Faulty:
    """A hand that fails now and then."""

    def __init__(self, what):
        self.what, self.asked = what, 0

    def desired(self, time_s, pose):
        self.asked += 1
        pose[:] = np.nan  # what it is handed is its own
        if self.asked % 3:
            return np.array([1.0, 0, 0])
        if self.what == "raises":
            raise OSError("unplugged")
        return {"nan": np.full(3, np.nan), "shape": np.zeros(4), "words": ["a", "b", "c"]}[self.what]


@pytest.mark.parametrize("what", ["raises", "nan", "shape", "words"])
def test_a_faulty_hand_does_not_end_the_loop(what):
    hand = Faulty(what)
    run = simulate(Controller([MeshFixture(plate())], SphereTool(1.0)), hand, [0, 0, 5], 0.3)
    assert hand.asked == 60
    assert run.log["status"].tolist() == ["free", "free", "refused"] * 20
    assert run.end == pytest.approx([0.2, 0, 5])
    assert np.isfinite(run.hand.velocities).all()


def test_a_faulty_viewer_does_not_disturb_the_loop(ball):
    class Broken:
        asked = 0

        def show(self, pose, status=""):
            self.asked += 1
            pose[:] = 0
            if self.asked == 5:
                raise RuntimeError("gone")

    viewer = Broken()
    hand = RandomHand(1, [0.0, 0, 0])
    run = simulate(Controller([ball], SphereTool(0.8)), hand, [0, 0, 8.0], 0.5, viewer=viewer)
    assert viewer.asked == 5
    plain = simulate(Controller([ball], SphereTool(0.8)), hand, [0, 0, 8.0], 0.5)
    assert np.array_equal(run.poses, plain.poses)


def test_paced_takes_its_time_and_changes_no_number(ball):
    hand = RandomHand(1, [0.0, 0, 0])
    control = Controller([ball], SphereTool(0.8))
    began = perf_counter()
    run = simulate(control, hand, [0, 0, 8.0], 0.25, paced=True)
    assert 0.25 <= perf_counter() - began < 1.0
    assert np.array_equal(run.poses, simulate(control, hand, [0, 0, 8.0], 0.25).poses)


def test_depths_are_logged_where_there_is_slack():
    bone, nerve = MeshFixture(plate(), "bone", slack=Slack(0.4)), MeshFixture(plate(), "bone")
    hand = ScriptedHand([[0, 0, 2], [0, 0, 0.2]], tremor=Tremor(0))
    run = simulate(Controller([bone], SphereTool(1.0)), hand, [0, 0, 2], hand.seconds)
    assert 0 < run.log["depth_bone_mm"].max() <= 0.4
    both = simulate(Controller([bone, nerve], SphereTool(1.0)), hand, [0, 0, 2], 0.1)
    assert {"depth_bone_0_mm", "depth_bone_1_mm"} <= set(both.log)


def test_bad_input(ball):
    control = Controller([ball], SphereTool(0.8))
    hand = RandomHand(1, [0.0, 0, 0])
    for start in ([0, 0, np.nan], [0, 0, 8, 0, 0, 0]):
        with pytest.raises(InputError, match="start"):
            simulate(control, hand, start, 1.0)
    for seconds, cycle in ((0, 0.005), (1, 0), (np.nan, 0.005), (1, np.inf), (0.001, 0.005)):
        with pytest.raises(InputError, match="at least one cycle"):
            simulate(control, hand, [0, 0, 8], seconds, cycle)
    with pytest.raises(InputError, match="targets"):
        RandomHand(0, [[1.0, 2]])
    with pytest.raises(InputError, match="targets"):
        RandomHand(0, [1.0, 2, np.nan])
    with pytest.raises(InputError, match="push_mm_s"):
        RandomHand(0, [1.0, 2, 3], push_mm_s=-1)
    with pytest.raises(InputError, match="waypoints"):
        ScriptedHand([[0, 0, 0]])
    with pytest.raises(InputError, match="different"):
        ScriptedHand([[0, 0, 0], [0, 0, 0]])
    with pytest.raises(InputError, match="speed_mm_s"):
        ScriptedHand([[0, 0, 0], [1, 0, 0]], speed_mm_s=0)
    with pytest.raises(InputError, match="band_hz"):
        Tremor(0, band_hz=(12.0, 8.0))
    with pytest.raises(InputError, match="rms_mm"):
        Tremor(0, rms_mm=-1)
    with pytest.raises(InputError, match="times that grow"):
        RecordedHand([0.0, 1, 1], np.zeros((3, 3)))
    with pytest.raises(InputError, match="n at least"):
        RecordedHand([0.0, 1], np.zeros((2, 4)))
