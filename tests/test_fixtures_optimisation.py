"""The motion nearest to the desired one: the compiled solver against maintained ones and by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from study.errors import InputError
from study.fixtures.optimisation import nearest_motion


def problem(seed, n, m, kind):
    """Rows that a tool meets: in all directions, nearly parallel, or nearly opposite; 0 is allowed."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(m, n))
    if kind == "parallel":
        rows[1:] = rows[0] + 1e-3 * rows[1:]
    if kind == "slot":
        rows[m // 2 :] = -rows[: m - m // 2] + 1e-4 * rng.normal(size=(m - m // 2, n))
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    least = -np.abs(rng.normal(size=m)) * 0.1 * (rng.random(m) < 0.5)
    return rows, least, rng.normal(size=n) * 0.3


@pytest.mark.parametrize("method", ["nnls", "quadprog"])
@given(
    seed=st.integers(0, 2**31),
    n=st.sampled_from([2, 3, 6, 8]),
    m=st.integers(1, 25),
    kind=st.sampled_from(["any", "parallel", "slot"]),
)
@settings(deadline=None, max_examples=150)
def test_as_maintained_solvers(method, seed, n, m, kind):
    if method == "quadprog":
        pytest.importorskip("quadprog")
    rows, least, desired = problem(seed, n, m, kind)
    motion = nearest_motion(rows, least, desired)
    assert (rows @ motion - least).min() > -1e-9
    # Onto a convex set that contains 0.
    assert np.linalg.norm(motion - desired / 2) <= np.linalg.norm(desired) / 2 + 1e-9
    other = nearest_motion(rows, least, desired, method)
    if other is not None:  # they give up on some that are nearly degenerate
        np.testing.assert_allclose(motion, other, atol=1e-6)


def test_by_hand():
    np.testing.assert_allclose(nearest_motion([[0, 0, 1]], [-0.1], [0.2, 0, -0.5]), [0.2, 0, -0.1])
    edge = [[0, 0, 1], [0, 1, 0]]
    np.testing.assert_allclose(nearest_motion(edge, [0, 0], [0.2, -1, -0.5]), [0.2, 0, 0], atol=1e-15)
    # Scaled rows say the same.
    np.testing.assert_allclose(nearest_motion([[0, 0, 9]], [-0.9], [0.2, 0, -0.5]), [0.2, 0, -0.1])
    np.testing.assert_allclose(nearest_motion(np.zeros((0, 3)), [], [1, 2, 3]), [1, 2, 3])
    np.testing.assert_allclose(nearest_motion([[0, 0, 0]], [-1], [1, 2, 3]), [1, 2, 3])


def test_a_plane_that_is_dropped_again():
    # The first plane that matters at the desired point does not at the solution.
    rows = np.array([[1.0, 0.2, 0], [1.0, -3.0, 0]])
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    least, desired = np.array([0.0, 1.0]), np.array([-1.0, 0.1, 0])
    motion = nearest_motion(rows, least, desired)
    np.testing.assert_allclose(motion, nearest_motion(rows, least, desired, "nnls"), atol=1e-9)


@pytest.mark.parametrize("method", ["compiled", "nnls"])
def test_no_motion_is_reported(method):
    assert nearest_motion([[1, 0, 0], [-1, 0, 0]], [0.1, 0.1], [0, 0, 0], method) is None
    assert nearest_motion([[0, 0, 0]], [0.1], [0, 0, 0], method) is None


def test_bad_input():
    with pytest.raises(InputError, match=r"\(1, 2\)"):
        nearest_motion([[1, 0]], [0], [0, 0, 0])
    with pytest.raises(InputError, match="finite"):
        nearest_motion([[1, 0, np.nan]], [0], [0, 0, 0])
