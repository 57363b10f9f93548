"""The tracker's stream: when samples come, what faults do to them, and what the reader refuses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from study.errors import InputError
from study.guidance.frames import rigid
from study.guidance.tracker import (
    MarkerBody,
    SampleReader,
    Tracker,
    TrackerSample,
    TrackerSettings,
    TrackerStream,
    facing_pose,
)

QUIET = TrackerSettings(cycle_s=0.04, delay_s=0.05, jitter_mm=(0, 0, 0), distortion_mm=0.0, quantum_mm=0.0)


def moving(time: float) -> np.ndarray:
    return facing_pose([0.0, 0.0, 1500.0]) @ rigid(translation=[100.0 * time, 0.0, 0.0])


def stream(settings: TrackerSettings = QUIET, **faults: object) -> TrackerStream:
    return TrackerStream(Tracker(settings, 0), MarkerBody.plate(), moving, 0, **faults)


def test_samples_are_late_and_of_their_exposure():
    samples = list(stream(start_s=1.0).until(1.2))
    assert [s.exposure_s for s in samples] == pytest.approx([1.0, 1.04, 1.08, 1.12])
    assert [s.time_s - s.exposure_s for s in samples] == pytest.approx([0.05] * 4)
    for sample in samples:
        assert np.allclose(sample.pose, moving(sample.exposure_s), atol=1e-9)


def test_hidden_markers_have_no_pose():
    reader = SampleReader()
    seen = []
    for sample in stream(occluded=[(0.1, 0.2)]).until(0.4):
        assert sample.visible == (reader.read(sample) is not None)
        seen.append(reader.missing)
    assert seen == [0, 0, 0, 1, 2, 3, 0, 0, 0]
    assert np.allclose(reader.pose, moving(0.32), atol=1e-9)


def test_a_frozen_tracker_repeats_itself():
    settings = TrackerSettings()
    reader = SampleReader()
    repeated = []
    for sample in stream(settings, frozen=[(0.1, 0.2)]).until(0.4):
        reader.read(sample)
        repeated.append(reader.repeated)
    assert repeated == [0, 0, 0, 1, 2, 3, 0, 0, 0, 0]
    reader = SampleReader()
    samples = list(stream(settings, frozen=[(0.1, 0.2)], frozen_stamps=True).until(0.4))
    for sample in samples[:3]:
        reader.read(sample)
    with pytest.raises(InputError, match="out of order or repeated"):
        reader.read(samples[3])
    reader.read(samples[6])  # the refused sample has left no trace
    assert reader.repeated == 0


def test_a_spike_hits_one_sample():
    clean = list(itertools.islice(stream(), 6))
    spiked = list(itertools.islice(stream(spikes=[(0.13, [5.0, 0.0, -1.0])]), 6))
    off = np.array([b.pose[:3, 3] - a.pose[:3, 3] for a, b in zip(clean, spiked, strict=True)])
    assert off[3] == pytest.approx([5.0, 0.0, -1.0]) and not np.delete(off, 3, axis=0).any()


def test_the_same_seed_gives_the_same_samples():
    one, two = (list(itertools.islice(stream(TrackerSettings()), 5)) for _ in range(2))
    assert all(np.array_equal(a.pose, b.pose) for a, b in zip(one, two, strict=True))


@pytest.mark.parametrize(
    ("sample", "word"),
    [
        (TrackerSample(1.0, 0.5, np.eye(4)), "after 0.500000 s, got 0.500000"),
        (TrackerSample(1.0, 0.4, np.eye(4)), "after 0.500000 s, got 0.400000"),
        (TrackerSample(1.0, 1.2, np.eye(4)), "before the arrival"),
        (TrackerSample(1.0, np.nan, np.eye(4)), "finite"),
        (TrackerSample(1.0, 0.9, np.full((4, 4), np.nan)), "finite"),
        (TrackerSample(1.0, 0.9, np.diag([1.0, 1, 2, 1])), "rotation"),
    ],
)
def test_samples_that_cannot_come_next_are_refused(sample, word):
    reader = SampleReader()
    first = facing_pose([0, 0, 1000.0])
    reader.read(TrackerSample(0.6, 0.5, first))
    with pytest.raises(InputError, match=word):
        reader.read(sample)
    assert reader.exposure_s == 0.5 and np.array_equal(reader.pose, first)


@pytest.mark.parametrize(
    ("faults", "word"),
    [
        ({"occluded": [(0.2, 0.1)]}, "occluded"),
        ({"frozen": [(0.2, np.nan)]}, "frozen"),
        ({"spikes": [(0.1, [1.0, 2.0])]}, "spikes"),
        ({"spikes": [(np.inf, [1.0, 2.0, 3.0])]}, "spikes"),
    ],
)
def test_bad_faults_are_named(faults, word):
    with pytest.raises(InputError, match=word):
        stream(**faults)
