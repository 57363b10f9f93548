"""What a margin refuses, and what it takes that looks unusual."""

import numpy as np
import pytest
from margin_cases import CASES, Shifts, affine_of, around, tube, volume_of

from study.errors import InputError, LabelError, StudyError
from study.margins import GrowthSettings, allowed_hits, grow_margin, least_registrations
from study.registration import CombinedErrors, ImageError, PointRegistration, RobotError
from study.volumes import LabelVolume

VOLUME, MODEL = CASES["tube"]
QUICK = GrowthSettings(registrations=400, validation_registrations=200)


def grown(structure="nerve", model=MODEL, risk=0.05, volume=VOLUME, settings=QUICK, **given):
    return grow_margin(volume, structure, model, risk, settings=settings, **{"rng": 0, **given})


@pytest.mark.parametrize("risk", [0, 1, -0.1, 1.5, float("nan"), float("inf"), "0.01", True, [0.01]])
def test_risks_that_are_none(risk):
    with pytest.raises(
        InputError, match="acceptable_risk: expected a number between 0 and 1, both excluded, got"
    ):
        grown(risk=risk)


@pytest.mark.parametrize("confidence", [0, 1, -1, 95, float("nan"), "high"])
def test_confidences_that_are_none(confidence):
    with pytest.raises(
        InputError, match=f"confidence: expected a number between 0 and 1.*got {confidence!r}"
    ):
        GrowthSettings(confidence=confidence)


def test_too_few_registrations_say_how_many_it_takes():
    few = GrowthSettings(registrations=2994)
    with pytest.raises(InputError, match=r"at least 2995 .*0\.001 .*0\.95, got 2994"):
        grown(risk=0.001, settings=few)
    with pytest.raises(InputError, match="at least 459 "):
        allowed_hits(10, 0.01, 0.99)
    enough = GrowthSettings(registrations=2995, validation_registrations=0)
    assert grown(risk=0.001, settings=enough).estimate.hits == 0


@pytest.mark.parametrize(
    "name, value",
    [
        ("method", "fast"),
        ("registrations", 0),
        ("registrations", 2.5),
        ("registrations", "25000"),
        ("registrations", None),
        ("registrations", True),
        ("validation_registrations", -1),
        ("least_transfer", 0),
        ("most_steps", 0),
        ("initial_transfer", 0),
        ("initial_transfer", 1.2),
        ("initial_transfer", "20 %"),
        ("decay_start", 0),
        ("decay_start", 1.01),
        ("decay_start", "late"),
    ],
)
def test_settings_that_cannot_be(name, value):
    with pytest.raises(InputError, match=f"{name}: expected .* got {value!r}"):
        GrowthSettings(**{name: value})


@pytest.mark.parametrize("risk, confidence", [(0, 0.95), (1, 0.95), (0.01, 0), (0.01, 1), (0.01, 1.2)])
def test_least_registrations_of_nothing(risk, confidence):
    with pytest.raises(InputError, match="between 0 and 1"):
        least_registrations(risk, confidence)
    with pytest.raises(InputError, match="between 0 and 1"):
        allowed_hits(5000, risk, confidence)


def test_allowed_hits_of_no_registrations():
    for confidence in (None, 0.95):
        with pytest.raises(InputError, match="registrations: expected at least 1, got 0"):
            allowed_hits(0, 0.01, confidence)


def test_structures_that_are_not_there():
    with pytest.raises(LabelError, match=r"\['air', 'nerve'\], got \['nerv'\]"):
        grown("nerv")
    with pytest.raises(LabelError, match=r"got .*'vein'"):
        grown(["nerve", "vein"])
    with pytest.raises(LabelError, match="got none"):
        grown([])
    named = VOLUME.with_labels(VOLUME.labels, {**VOLUME.names, "sinus": 7})
    with pytest.raises(LabelError, match="sinus: expected a structure of the volume, got no voxel"):
        grown("sinus", volume=named)


@pytest.mark.parametrize(
    "mask, said",
    [
        (np.zeros((16, 15, 17), bool), "facial: expected a structure of at least 10 voxels, got 0"),
        (tube((16, 15, 17), (3, 3, 3), (3, 3, 11)), "at least 10 voxels, got 9"),
        (np.ones((16, 15, 17), bool), "a volume full of it"),
        (np.zeros((16, 15, 18), bool), r"shape \(16, 15, 17\), got bool of shape \(16, 15, 18\)"),
        (np.zeros((16, 15, 17)), r"bool mask .* got float64"),
        (VOLUME.labels, r"bool mask .* got uint8"),
    ],
)
def test_masks_that_are_no_structure(mask, said):
    with pytest.raises(InputError, match=said):
        grown(mask, name="facial")


def test_ten_voxels_in_a_row_are_a_structure():
    margin = grown(tube((16, 15, 17), (3, 3, 3), (3, 3, 12)), name="chorda")
    assert margin.structure == "chorda" and margin.voxels > 0 and margin.damage_risk <= 0.05


def test_printed_risks_are_for_printed_structures_only():
    with pytest.raises(InputError, match=r"acceptable_risk: expected a number for 'nerve'.*chorda_tympani"):
        grown(risk=None)
    assert grown(VOLUME.mask("nerve"), risk=None, name="chorda_tympani").acceptable_risk == 0.05


def test_shapes_that_are_none():
    with pytest.raises(InputError, match=r"shape: expected one of .*got 'round'"):
        grown(shape="round")


@pytest.mark.parametrize("method", ["exact", "published"])
@pytest.mark.parametrize("model", [None, 0.176, "registration", np.eye(4), PointRegistration])
def test_models_that_cannot_be_drawn(method, model):
    settings = GrowthSettings(method=method, registrations=100, validation_registrations=0)
    with pytest.raises(InputError, match="model: expected an error source"):
        grown(model=model, settings=settings)


def test_models_that_move_nothing():
    for still in (Shifts((0, 0, 0), 0), ImageError((0, 0, 0)), Shifts((1, 0, 0), 0)):
        with pytest.raises(InputError, match="model: expected an error that moves something"):
            grown(model=still)


MIDDLE = VOLUME.points(np.array([[8.0, 8, 8]]))[0]
N = np.array([1, 2, 3]) / np.sqrt(14)
FLAT = {
    "one axis": ImageError(MIDDLE, position_std=(0.3, 0, 0)),
    "two axes": ImageError(MIDDLE, position_std=(0.3, 0.3, 0)),
    "scale only": ImageError(MIDDLE, scale_std=0.05),
    "turns only": RobotError(MIDDLE, rotation_std=0.1),
    "turns about one axis": RobotError(MIDDLE, rotation_std=(0.1, 0, 0)),
    "one oblique direction": RobotError(MIDDLE, compliance=np.outer(N, N), force_std=(0.3, 0, 0)),
    "hardly any error": PointRegistration(MIDDLE + np.eye(3) * 9, 1e-6),
    "mean far from 0": Shifts((0.0, 3.0, 0.0), (0.01, 0.3, 0.01)),
}


@pytest.mark.parametrize("shape", ["spatially_varying", "constant_thickness"])
@pytest.mark.parametrize("turn", [(0, 0, 0), (0.3, 0.5, 0.2)])
@pytest.mark.parametrize("kind", FLAT)
def test_errors_that_scatter_in_some_directions_only(kind, turn, shape):
    volume = volume_of(VOLUME.mask("nerve"), affine_of(turn=turn))
    margin = grown(model=FLAT[kind], volume=volume, shape=shape)
    assert margin.estimate.risk <= 0.05 and margin.validation.interval[0] <= 0.05
    assert margin.validation == margin.risk_on(200, np.random.default_rng(0).spawn(2)[1])
    assert np.isfinite(margin.summary()["mahalanobis_mean"])
    assert (np.diff(margin.curve()["risk"]) < 0).all()


def test_numbers_may_be_numpy_ones_and_seeds_of_any_kind():
    plain = grown()
    settings = GrowthSettings(
        registrations=np.int64(400), validation_registrations=np.int32(200), confidence=np.float64(0.95)
    )
    for rng in (0, np.int64(0), np.random.SeedSequence(0), np.random.default_rng(0), np.random.PCG64(0)):
        assert np.array_equal(grown(settings=settings, rng=rng, risk=np.float64(0.05)).mask, plain.mask)
    assert np.array_equal(grown(risk=np.float32(0.05)).mask, plain.mask)
    assert grown(rng=None).voxels > 0
    assert not np.array_equal(grown(rng=[1, 2]).needs, plain.needs)


def test_several_labels_or_a_mask_are_one_structure():
    labels = VOLUME.labels.copy()
    labels[:8][labels[:8] == 1] = 2
    parts = LabelVolume(labels, VOLUME.affine, {"air": 0, "far": 1, "near": 2})
    plain = grown()
    for structure in (["far", "near"], ("near", "far"), np.array(["near", "far"])):
        margin = grown(structure, volume=parts)
        assert np.array_equal(margin.mask, plain.mask) and margin.voxels == plain.voxels
    assert grown(["far", "near"], volume=parts).structure == "far + near"
    assert np.array_equal(grown(np.asfortranarray(VOLUME.mask("nerve"))).mask, plain.mask)


def test_the_edge_of_the_volume_is_no_surface():
    def by_hand(mask):
        padded = np.pad(mask, 1)
        whole = sum(np.count_nonzero(padded != np.roll(padded, 1, axis)) for axis in range(3))
        edge = sum(np.count_nonzero(mask.take(i, axis)) for axis in range(3) for i in (0, -1))
        return edge / whole

    cut = np.zeros((16, 15, 17), bool)
    cut[:5, 6:9, 6:9] = True
    for mask in (cut, VOLUME.mask("nerve"), CASES["at the edge on all sides"][0].mask("nerve")):
        volume = volume_of(mask)
        margin = grown(volume=volume)
        assert margin.edge_share == pytest.approx(by_hand(mask))
    assert grown().edge_share == 0
    assert grown(volume=volume_of(cut)).edge_share == pytest.approx(9 / 78)
    one_slice = np.zeros((16, 15, 1), bool)
    one_slice[4:9, 4:9] = True
    flat = volume_of(one_slice)
    assert grown(volume=flat, model=around(flat)).edge_share == pytest.approx(50 / 70)


def test_margins_that_fill_the_volume():
    volume = volume_of(np.pad(np.ones((5, 5, 5), bool), 1))
    for method in ("exact", "published"):
        settings = GrowthSettings(method=method, registrations=400, validation_registrations=400)
        margin = grown(volume=volume, model=Shifts((0, 0, 0), 0.5), risk=0.01, settings=settings)
        assert margin.voxels + margin.structure_mask.sum() == 343
        assert margin.damage_risk == 0 and margin.validation.hits == 0
        assert len(margin.final_shell) == 0
        assert margin.summary()["safety_margin_volume_mm3"] == pytest.approx(margin.voxels * 0.064)


def test_nothing_is_changed_and_nothing_can_be(tmp_path):
    labels = VOLUME.labels.copy()
    margin = grown()
    assert np.array_equal(VOLUME.labels, labels)
    with pytest.raises(AttributeError):
        margin.mask = None


def test_enclosed_tissue_of_another_label_is_spared():
    # A nerve in its canal is not the canal's; the registration that moves nothing already reaches it.
    labels = np.zeros((15, 15, 15), np.uint8)
    labels[4:11, 4:11, 3:12] = 1
    labels[7, 7, 3:12] = 2
    volume = LabelVolume(labels, affine_of(), {"air": 0, "canal": 1, "nerve": 2})
    apart, together = (
        grown(s, volume=volume, model=around(volume, 0.2)) for s in ("canal", ["canal", "nerve"])
    )
    assert apart.mask[7, 7, 3:12].all() and not (apart.mask & apart.structure_mask).any()
    assert together.voxels < apart.voxels


def test_every_error_is_one_of_the_package():
    for call in (lambda: grown(model=CombinedErrors([])), lambda: grown(risk=2), lambda: grown("x")):
        with pytest.raises(StudyError):
            call()
