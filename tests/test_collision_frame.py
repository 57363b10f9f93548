"""The canonical frame and the search for the approach."""

import numpy as np
import pytest
from planning_cases import small_cone

from study.collision import Drill, canonical_frame, find_approach
from study.errors import InputError
from study.volumes import LabelVolume


@pytest.mark.parametrize("depth_axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("cropped", [False, True])
def test_canonical_arrays_and_positions_agree_and_come_back(depth_axis, sign, cropped):
    rng = np.random.default_rng(depth_axis)
    labels = np.ones((24, 26, 28), np.uint8)
    labels[10:13, 11:14, 12:15] = 2
    volume = LabelVolume(labels, np.diag([0.4, 0.5, 0.6, 1.0]), {"air": 0, "protected": 1, "target": 2})
    approach = sign * np.eye(3)[depth_axis]
    for rotation_axis in {0, 1, 2} - {depth_axis}:
        drill = Drill(burr_diameter=1.0, shaft_diameters=(0.4, 0.6, 0.8), shaft_ends=(2.0, 3.0, 4.0))
        frame = canonical_frame(volume, approach, rotation_axis, 3, drill if cropped else None, 0.3)
        values = rng.integers(1, 200, volume.shape)
        canonical = frame.canonical(values)
        inside = np.zeros(volume.shape, bool)
        inside[tuple(slice(a, z) for a, z in zip(frame.low, frame.high, strict=True))] = True
        assert cropped == (not inside.all())
        assert np.array_equal(frame.original(canonical), np.where(inside, values, 0))
        positions = np.argwhere(canonical)
        indices = frame.to_indices(positions)
        assert np.allclose(frame.from_indices(indices), positions)
        assert np.array_equal(values[tuple(indices.astype(int).T)], canonical[tuple(positions.T)])
        # depth grows into the bone
        deeper = frame.to_indices(positions[:1] + np.array([0, 1, 0])) - indices[:1]
        assert (deeper[0] * volume.spacing) @ approach > 0
        assert np.allclose(frame.shaft_axes(np.zeros(1), volume.directions), -approach)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("flip", [False, True])
def test_approach_points_from_the_open_side_into_the_target(axis, flip):
    volume = small_cone()
    labels = np.moveaxis(volume.labels, 0, axis)
    if flip:
        labels = np.flip(labels, axis)
    affine = np.diag([0.4, -0.4, 0.4, 1.0])
    turned = LabelVolume(labels, affine, volume.names)
    expected = turned.directions[:, axis] * (-1 if flip else 1)
    assert np.allclose(find_approach(turned), expected, atol=0.05)


def test_frames_refuse_what_they_cannot_use():
    volume = small_cone()
    for approach, rotation_axis in [([0, 0, 0], 1), ([1, 0], 1), ([np.nan, 0, 1], 1), ([1, 0, 0], 0)]:
        with pytest.raises(InputError):
            canonical_frame(volume, approach, rotation_axis, 2)
