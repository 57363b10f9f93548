"""The 36 named specimens: their printed volumes, and that they are fit to be planned on."""

import time

import numpy as np
import pytest
from scipy import ndimage

from study import published
from study.errors import InputError
from study.planners.modified import modified_volume
from study.specimens import catalogue, specimen
from study.specimens.catalogue import Entry, build, fit_size

PRINTED = published.table("A.1").set_index("specimen")["modified_initial_target_cm3"]


def test_names_are_the_printed_ones_in_order():
    assert catalogue() == tuple(PRINTED.index)
    assert catalogue() == (*(f"CH{k:02d}" for k in range(1, 20)), *(f"TB{k:02d}" for k in range(1, 18)))


@pytest.mark.parametrize("name", catalogue())
def test_volume_is_the_printed_one_and_the_target_can_be_milled(name):
    found = specimen(name)
    modified = modified_volume(found.planning, 2.5)
    assert modified.target_cm3 == pytest.approx(PRINTED[name], rel=0.02)
    # One cavity, open to the side: its largest part meets the air that the burr comes from.
    parts, count = ndimage.label(modified.target, np.ones((3, 3, 3)))
    sizes = np.bincount(parts.ravel())[1:]
    assert sizes.max() > 0.97 * sizes.sum(), f"{count} parts"
    air = found.planning.mask("air") & modified.allowed
    beside = ndimage.binary_dilation(air, np.ones((3, 3, 3))) & modified.target
    assert np.count_nonzero(parts[beside] == 1 + int(np.argmax(sizes))) > 100
    # A burr with its shaft may start outside.
    lateral = 0 if found.side == "right" else found.planning.shape[0] - 1
    target = np.flatnonzero(found.planning.mask("target").any(axis=(1, 2)))
    assert np.abs(target - lateral).min() * 0.4 >= 12
    assert 10 <= np.ptp(target) * 0.4 <= 36


def test_a_specimen_is_cheap_cached_and_frozen():
    start = time.process_time()
    first = specimen("TB05")
    # Under a second for a lone process; four allow for a busy machine.
    assert time.process_time() - start < 4
    assert specimen("TB05") is first
    with pytest.raises(ValueError, match="read-only"):
        first.fiducials[0, 0] = 0
    assert first.planning.shape == first.anatomy.shape
    assert first.fiducials.shape == (6, 3)
    assert first.approach.tolist() == [1 if first.side == "right" else -1, 0, 0]


def test_rebuilding_gives_the_same_bytes():
    first = specimen("TB14")
    again = build(Entry("TB14", first.side, 101 + catalogue().index("TB14"), first.parameters.size))
    assert again.planning.labels.tobytes() == first.planning.labels.tobytes()
    assert again.parameters == first.parameters


def test_bones_are_different_ones_of_both_sides():
    chosen = [specimen(name) for name in ("CH01", "CH02", "TB01")]
    assert {one.side for one in chosen} == {"right", "left"}
    drawn = [one.parameters.scaled(1.0).tegmen_height for one in chosen]
    assert len(set(drawn)) == 3


@pytest.mark.parametrize("name", ["CH00", "", "ch01", "TB18"])
def test_unknown_specimen_is_refused(name):
    with pytest.raises(InputError, match="CH01-CH19"):
        specimen(name)


def test_fitting_finds_the_size_and_says_when_it_cannot():
    entry = Entry("TB99", "right", 5, 1.0)

    def measure(planning):
        return planning.volume_mm3("target") / 1000

    fitted = fit_size(entry, 4.0, measure, bounds=(0.6, 1.1), tolerance=0.02)
    assert measure(build(fitted).planning) == pytest.approx(4.0, rel=0.02)
    with pytest.raises(InputError, match="TB99"):
        fit_size(entry, 400.0, measure, bounds=(0.6, 0.7))
