"""Frames and quaternions against scipy and against each other."""

import doctest

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.guidance import FrameGraph, frames
from study.guidance.frames import actual_tcp, desired_tcp, difference, from_pose, inverse, pose_of, rigid


def random_transform(rng):
    return rigid(Rotation.random(random_state=rng), rng.uniform(-500, 500, 3))


def room(seed=0):
    """A camera that sees robot, tool and patient, the drill on the tool, the image on the patient."""
    rng = np.random.default_rng(seed)
    pairs = [("cam", "rob"), ("cam", "tool"), ("cam", "pat"), ("tool", "tcp"), ("pat", "img"), ("tool", "ee")]
    graph, known = FrameGraph(), {}
    for to, frm in pairs:
        known[to, frm] = random_transform(rng)
        graph.add(to, frm, known[to, frm])
    return graph, known, rng


def test_docstrings():
    assert doctest.testmod(frames).failed == 0


def test_graph_composes_and_inverts():
    graph, known, _ = room()
    T = graph.transform("rob", "img")
    expected = np.linalg.inv(known["cam", "rob"]) @ known["cam", "pat"] @ known["pat", "img"]
    assert np.allclose(T, expected, atol=1e-9)
    assert np.allclose(graph.transform("img", "rob") @ T, np.eye(4), atol=1e-9)
    assert np.array_equal(graph.transform("tcp", "tcp"), np.eye(4))
    for a in graph.names:
        for b in graph.names:
            for c in graph.names:
                assert np.allclose(
                    graph.transform(a, b) @ graph.transform(b, c), graph.transform(a, c), atol=1e-9
                )


def test_equations_5_and_6_are_ways_through_the_graph():
    graph, known, rng = room()
    args = known["cam", "rob"], known["cam", "tool"], known["tool", "tcp"]
    assert np.allclose(actual_tcp(*args), graph.transform("rob", "tcp"), atol=1e-9)
    planned = random_transform(rng)
    wanted = desired_tcp(known["cam", "rob"], known["cam", "pat"], known["pat", "img"], planned)
    assert np.allclose(wanted, graph.transform("rob", "img") @ planned, atol=1e-9)


def test_saying_a_transform_anew_changes_what_follows():
    graph, known, rng = room()
    before = graph.transform("rob", "tcp")
    graph.add("cam", "tool", random_transform(rng))
    assert not np.allclose(graph.transform("rob", "tcp"), before)
    graph.add("tool", "cam", inverse(known["cam", "tool"]))  # and from the other side
    assert np.allclose(graph.transform("rob", "tcp"), before, atol=1e-9)


def test_graph_refuses():
    graph, _, _ = room()
    with pytest.raises(InputError, match="already follows from others: rob - cam - tool"):
        graph.add("rob", "tool", np.eye(4))
    with pytest.raises(InputError, match="two different frames"):
        graph.add("cam", "cam", np.eye(4))
    with pytest.raises(InputError, match="determinant"):
        graph.add("cam", "new", np.diag([1.0, 1.0, -1.0, 1.0]))
    with pytest.raises(InputError, match="expected one of cam, rob"):
        graph.transform("cam", "moon")
    graph.add("a", "b", np.eye(4))
    with pytest.raises(InputError, match="no known transforms connect"):
        graph.transform("a", "cam")


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_quaternions_have_their_scalar_first(seed):
    rng = np.random.default_rng(seed)
    T = random_transform(rng)
    p, q = pose_of(T)
    # The textbook's matrix of q0, qx, qy, qz.
    w, x, y, z = q
    R = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert np.allclose(R, T[:3, :3], atol=1e-12)
    assert q[0] >= 0
    assert np.allclose(from_pose(p, q), T, atol=1e-12)
    assert np.allclose(from_pose(p, -q), T, atol=1e-12)  # both signs are one orientation


@pytest.mark.parametrize(
    ("position", "quaternion", "message"),
    [
        ([0, 0, 0], [1.01, 0, 0, 0], "unit quaternion"),
        ([0, 0, 0], [0, 0, 0, 0], "unit quaternion"),
        ([0, 0, 0], [1, 0, 0], "four finite numbers"),
        ([0, 0, 0], [np.nan, 0, 0, 1], "four finite numbers"),
        ([0, 0], [1, 0, 0, 0], "position"),
        ([0, 0, np.inf], [1, 0, 0, 0], "position"),
    ],
)
def test_from_pose_refuses(position, quaternion, message):
    with pytest.raises(InputError, match=message):
        from_pose(position, quaternion)


def test_difference_is_a_turn_then_a_shift_in_the_outer_axes():
    rng = np.random.default_rng(3)
    wanted = random_transform(rng)
    turn, shift = 0.01 * rng.normal(size=3), rng.normal(size=3)
    actual = wanted.copy()
    actual[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ wanted[:3, :3]
    actual[:3, 3] += shift
    found = difference(actual, wanted)
    assert np.allclose(found[0], turn, atol=1e-12)
    assert np.allclose(found[1], shift, atol=1e-9)
