"""The 36 named specimens: their printed volumes, and that they are fit to be planned on."""

import time
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import ndimage

from study import published
from study.errors import InputError
from study.planners.modified import modified_volume
from study.specimens import catalogue, specimen
from study.specimens.named_specimens import Entry, _entries, build, fit_size

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
    box = tuple(slice(i.min() - 1, i.max() + 2) for i in np.nonzero(modified.target))
    parts, count = ndimage.label(modified.target[box], np.ones((3, 3, 3)))
    sizes = np.bincount(parts.ravel())[1:]
    assert sizes.max() > 0.97 * sizes.sum(), f"{count} parts"
    air = found.planning.mask("air")[box] & modified.allowed[box] & (parts == 0)
    from_outside = ndimage.binary_dilation(air) & (parts == 1 + int(np.argmax(sizes)))
    assert np.count_nonzero(from_outside) > 100
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
    entries = [_entries()[name] for name in catalogue()]
    assert {entry.side for entry in entries} == {"right", "left"}
    assert len({entry.parameters.tegmen_height for entry in entries}) == 36
    assert min(entry.size for entry in entries) > 0.5 and max(entry.size for entry in entries) < 1.3


@pytest.mark.parametrize("name", ["CH00", "", "ch01", "TB18"])
def test_unknown_specimen_is_refused(name):
    with pytest.raises(InputError, match="CH01-CH19"):
        specimen(name)


def test_fitting_finds_the_size_and_says_when_it_cannot(monkeypatch):
    # The bone is replaced by its size: what is tested is the search.
    monkeypatch.setattr(
        "study.specimens.named_specimens.build", lambda entry: SimpleNamespace(planning=entry.size)
    )
    entry = Entry("TB99", "right", 5, 1.0)
    fitted = fit_size(entry, 0.7, lambda size: size**3, tolerance=0.001)
    assert fitted.size**3 == pytest.approx(0.7, rel=0.001)
    # Where the volume jumps over the one wanted, the nearest size is taken.
    stepped = fit_size(entry, 0.7, lambda size: 0.69 if size < 0.9 else 0.8, tolerance=0.001)
    assert stepped.size < 0.9
    with pytest.raises(InputError, match="TB99"):
        fit_size(entry, 400.0, lambda size: size**3)
