"""The union of margins: by brute force in mm, on grids that were padded differently."""

import warnings

import numpy as np
import pytest
from margin_cases import affine_of, shell, volume_of

from study.errors import InputError, MarginError, PaddedVolumeWarning
from study.margins import GrowthSettings, grow_margin, union_of_margins
from study.registration import RobotError

FEW = GrowthSettings.for_removal(
    registrations=400, validation_registrations=0, violation_registrations=400, confidence=None
)


@pytest.fixture(scope="module")
def margins():
    """Three margins of one ball near a corner, of which two leave the volume on different sides."""
    affine = affine_of((0.5, 0.8, 0.6), (0.7, -0.3, 2.1), (-80, 33, 410), (1, 2, 0), (-1, 1, 1))
    volume = volume_of(shell((22, 22, 22), (5, 8, 9), 0, 4.3), affine)
    axes = affine[:3, :3] / np.linalg.norm(affine[:3, :3], axis=0)
    centre = volume.points(np.array([[5.0, 8, 9]]))[0]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PaddedVolumeWarning)
        return [
            grow_margin(
                volume, "nerve", Along(axes @ spread, centre), 0.02, settings=FEW, rng=3, purpose="remove"
            )
            for spread in np.diag([1.6, 2.6, 0.1]) + 0.1
        ]


class Along:
    """Shifts along one direction (mm) with a little of all others."""

    def __init__(self, direction, centre):
        self.direction, self.rest = direction, RobotError(centre, 0.1, 0.01)

    def sample(self, n, rng=None):
        rng = np.random.default_rng(rng)
        out = self.rest.sample(n, rng)
        out[:, :3, 3] += rng.standard_normal((n, 1)) * self.direction
        return out


def millimetres(volume, mask):
    """Set of the mask's voxel centres, rounded."""
    return {tuple(point) for point in np.round(volume.points(np.argwhere(mask)), 3) + 0.0}


def test_union_is_all_that_any_holds(margins):
    whole = union_of_margins(margins, margins[0].model, 500, rng=1)
    assert len({margin.volume.shape for margin in margins}) > 1, "the case shall be padded differently"
    every = [millimetres(margin.volume, margin.mask) for margin in margins]
    assert millimetres(whole.volume, whole.mask) == set.union(*every)
    assert not any(part == set.union(*every) for part in every)
    body = millimetres(margins[0].volume, margins[0].structure_mask)
    assert millimetres(whole.volume, whole.structure_mask) == body
    assert whole.volume.volume_mm3("nerve") == pytest.approx(margins[0].volume.volume_mm3("nerve"))


def test_union_is_no_riskier_than_any(margins):
    for margin in margins:
        whole = union_of_margins(margins, margin.model, 2000, rng=5)
        assert whole.validation.risk <= margin.risk_on(2000, rng=5).risk
        assert whole.validation == whole.estimate == whole.risk_on(2000, rng=5)


def test_one_margin_is_its_own_union(margins):
    whole = union_of_margins(margins[:1], margins[0].model, 100, rng=0)
    assert np.array_equal(whole.mask, margins[0].mask)
    assert np.array_equal(whole.volume.labels, margins[0].volume.labels)


def test_order_does_not_matter(margins):
    one = union_of_margins(margins, margins[0].model, 100, rng=0)
    other = union_of_margins(margins[::-1], margins[0].model, 100, rng=0)
    assert millimetres(one.volume, one.mask) == millimetres(other.volume, other.mask)
    assert one.volume_mm3 == pytest.approx(other.volume_mm3)


def test_union_has_no_curve(margins):
    whole = union_of_margins(margins, margins[0].model, 100, rng=0)
    with pytest.raises(MarginError, match="union"):
        whole.curve()


def test_what_does_not_go_together_is_refused(margins):
    model = margins[0].model
    with pytest.raises(InputError, match="at least one"):
        union_of_margins([], model)
    inside = grow_margin(
        margins[0].volume,
        "nerve",
        RobotError([0, 0, 0], 0.05),
        0.02,
        settings=FEW,
        rng=0,
        purpose="stay_inside",
    )
    with pytest.raises(InputError, match="stay_inside"):
        union_of_margins([margins[0], inside], model)
    shifted = volume_of(shell((22, 22, 22), (10, 10, 10), 0, 4.3), affine_of((0.5, 0.8, 0.61)))
    other = grow_margin(
        shifted, "nerve", RobotError([0, 0, 0], 0.1), 0.02, settings=FEW, rng=0, purpose="remove"
    )
    with pytest.raises(InputError, match="one grid"):
        union_of_margins([margins[0], other], model)
