"""The live view: a real client on loopback sees the tool, and nothing that it does disturbs the loop."""

import socket
import sys
import time

import numpy as np
import pyigtl
import pytest
from fixture_cases import plate
from scipy.spatial.transform import Rotation

from study.errors import InputError, ViewerError
from study.fixtures import Controller, MeshFixture, SphereTool
from study.fixtures.hands import ScriptedHand
from study.fixtures.simulation import simulate
from study.fixtures.viewer import ToolViewer, slicer_transform


def until(condition, seconds=10.0):
    """Wait until something holds; what it is in the end."""
    end = time.monotonic() + seconds
    while not (value := condition()) and time.monotonic() < end:
        time.sleep(0.01)
    return value


@pytest.fixture
def viewer():
    with ToolViewer(port=0, name="Drill", rate_hz=200) as viewer:
        yield viewer


@pytest.fixture
def client(viewer):
    client = pyigtl.OpenIGTLinkClient("127.0.0.1", viewer.port)
    assert until(lambda: viewer.clients == 1)
    yield client
    client.stop()


def test_a_client_sees_pose_and_status(viewer, client):
    pose = np.array([1.0, 2, 3, 0.1, -0.2, 0.3])
    viewer.show(pose, "constrained")
    message = client.wait_for_message("Drill", timeout=10)
    # LPS to RAS: x and y of the place change sign; of turns about x and y as well.
    np.testing.assert_allclose(message.matrix[:3, 3], [-1, -2, 3], atol=1e-6)
    turn = Rotation.from_matrix(message.matrix[:3, :3].astype(float)).as_rotvec()
    np.testing.assert_allclose(turn, [-0.1, 0.2, 0.3], atol=1e-6)
    assert client.wait_for_message("Drill status", timeout=10).string == "constrained"
    viewer.show(np.array([4.0, 5, 6]), "constrained")
    moved = client.wait_for_message("Drill", timeout=10)
    np.testing.assert_allclose(moved.matrix, slicer_transform([4, 5, 6]), atol=1e-6)
    assert client.wait_for_message("Drill status", timeout=0.2) is None  # told once


def test_who_comes_late_sees_the_latest_and_nothing_older(viewer):
    for k in range(300):
        viewer.show([k, 0, 0], "free")
    seen = []
    with socket.create_connection(("127.0.0.1", viewer.port)) as late:
        late.settimeout(5)
        content = late.recv(106, socket.MSG_WAITALL)
    message = pyigtl.messages.TransformMessage()
    message.unpack(pyigtl.messages.MessageBase.parse_header(content[:58]), content[58:])
    seen.append(message.matrix[0, 3])
    assert seen == [-299.0]


def test_clients_come_and_go(viewer):
    for _ in range(3):
        one = socket.create_connection(("127.0.0.1", viewer.port))
        two = socket.create_connection(("127.0.0.1", viewer.port))
        assert until(lambda: viewer.clients == 2)
        two.sendall(b"what is this" * 1000)  # read, and not acted on
        one.close()
        assert until(lambda: viewer.clients == 1)
        before = viewer.sent
        viewer.show(np.random.default_rng().normal(size=3), "free")
        assert until(lambda before=before: viewer.sent > before)
        two.close()
        assert until(lambda: viewer.clients == 0)


def test_a_client_that_does_not_read_is_let_go_and_others_see_on(viewer, client, monkeypatch):
    monkeypatch.setattr("study.fixtures.viewer.PATIENCE_S", 0.1)
    deaf = socket.socket()
    deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    deaf.connect(("127.0.0.1", viewer.port))
    assert until(lambda: viewer.clients == 2)
    k = 0

    def gone():
        nonlocal k
        k += 1
        viewer.show([k, 0, 0], str(k) * 200)
        return viewer.clients == 1

    assert until(gone, 30)
    viewer.show([-7, 0, 0], "free")

    def seen():
        message = client.wait_for_message("Drill", timeout=1)
        return message is not None and message.matrix[0, 3] == 7

    assert until(seen)
    deaf.close()


def test_the_loop_is_the_same_with_a_viewer_lost(viewer, client):
    control = Controller([MeshFixture(plate(8))], SphereTool(1.0))
    hand = ScriptedHand([[0, 0, 3.0], [0, 0, 0.5], [3, 0, 0.5]])
    alone = simulate(control, hand, [0, 0, 3.0], 1.0)
    client.stop()
    shown = simulate(control, hand, [0, 0, 3.0], 1.0, viewer=viewer)
    viewer.close()
    closed = simulate(control, hand, [0, 0, 3.0], 1.0, viewer=viewer)
    for run in (shown, closed):
        assert run.poses.tobytes() == alone.poses.tobytes()
        assert run.log.drop(columns="compute_us").equals(alone.log.drop(columns="compute_us"))


def test_showing_never_raises(viewer):
    for nonsense in (None, "here", [np.nan] * 3, np.zeros(5), object()):
        viewer.show(nonsense, "free")
        time.sleep(0.02)
    viewer.show([1, 2, 3], "geführt" + 70_000 * "x")
    with socket.create_connection(("127.0.0.1", viewer.port)) as client:
        client.settimeout(5)
        assert client.recv(106, socket.MSG_WAITALL)
    assert viewer.refused >= 2


def test_a_port_in_use_is_told(viewer):
    with pytest.raises(ViewerError, match=str(viewer.port)):
        ToolViewer(port=viewer.port)
    with pytest.raises(ViewerError, match="cannot listen"):
        ToolViewer(port=70000)
    with pytest.raises(InputError, match="rate_hz"):
        ToolViewer(port=0, rate_hz=0.0)
    viewer.close()
    ToolViewer(port=viewer.port).close()  # free again


def test_without_pyigtl_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyigtl", None)
    with pytest.raises(ViewerError, match=r"study\[viewer\]"):
        ToolViewer(port=0)
