"""Balls of voxels: the element against geometry, the fast dilation against scipy's."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import ndimage

from study.errors import InputError
from study.volumes import ball_element
from study.volumes.distances import overlapped_by_ball

SPACINGS = st.tuples(*[st.floats(0.2, 1.5)] * 3).map(np.array)


@given(radius=st.floats(0.1, 3), spacing=SPACINGS)
def test_element_holds_every_voxel_whose_box_reaches_into_the_ball(radius, spacing):
    element = ball_element(radius, spacing)
    reach = (np.array(element.shape) - 1) // 2
    wide = reach + 2  # look beyond the element too: nothing may be missing there
    offsets = np.stack(np.meshgrid(*[np.arange(-n, n + 1) for n in wide], indexing="ij"), axis=-1)
    centre = offsets * spacing
    nearest = np.clip(0, centre - spacing / 2, centre + spacing / 2)
    distance = np.linalg.norm(nearest, axis=-1)
    assume((np.abs(distance - radius) > 1e-9).all())
    expected = distance < radius
    inner = tuple(slice(2, -2) for _ in range(3))
    assert (element == expected[inner]).all()
    assert expected.sum() == element.sum()


@given(radius=st.floats(0.1, 3), spacing=SPACINGS)
def test_element_of_centres_is_within_the_element_of_overlaps(radius, spacing):
    whole = ball_element(radius, spacing)
    centres = ball_element(radius, spacing, overlap=False)
    assert centres.shape == whole.shape
    assert not (centres & ~whole).any()
    axes = [(np.arange(n) - n // 2) * step for n, step in zip(whole.shape, spacing, strict=True)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    distance = np.sqrt(x**2 + y**2 + z**2)
    assume((np.abs(distance - radius) > 1e-9).all())
    assert (centres == (distance < radius)).all()


def test_touching_is_not_cutting():
    assert ball_element(0.5, (1, 1, 1)).sum() == 1
    assert ball_element(0.5 + 1e-6, (1, 1, 1)).sum() == 7
    assert ball_element(1.5, (1, 1, 1))[:, 1, 1].tolist() == ball_element(1.5, 1)[:, 1, 1].tolist()
    assert ball_element(1.5, (1, 1, 1)).shape == (5, 5, 5)
    assert not ball_element(1.5, (1, 1, 1))[0].any()


@pytest.mark.parametrize("radius", [0, -1, np.nan, np.inf])
def test_refuses_a_radius(radius):
    with pytest.raises(InputError, match="radius: expected"):
        ball_element(radius, (1, 1, 1))


@pytest.mark.parametrize("spacing", [(1, 0, 1), (1, -1, 1), (1, np.nan, 1)])
def test_refuses_a_spacing(spacing):
    with pytest.raises(InputError, match="spacing: expected"):
        ball_element(1, spacing)


@given(
    seed=st.integers(0, 2**32),
    radius=st.floats(0.1, 2.5),
    spacing=SPACINGS,
    share=st.sampled_from([0, 0.01, 0.1, 0.9, 1]),
)
def test_fast_dilation_is_dilation_by_the_element(seed, radius, spacing, share):
    rng = np.random.default_rng(seed)
    mask = rng.random(tuple(rng.integers(1, 11, 3))) < share
    expected = ndimage.binary_dilation(mask, ball_element(radius, spacing))
    assert (overlapped_by_ball(mask, radius, spacing) == expected).all()


def test_fast_dilation_takes_any_memory_order():
    mask = np.asfortranarray(np.random.default_rng(0).random((9, 8, 7)) < 0.05)
    expected = ndimage.binary_dilation(mask, ball_element(1.2, (0.4, 0.5, 0.6)))
    assert (overlapped_by_ball(mask, 1.2, (0.4, 0.5, 0.6)) == expected).all()
    assert (overlapped_by_ball(mask[::-1], 1.2, (0.4, 0.5, 0.6)) == expected[::-1]).all()
