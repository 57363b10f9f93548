"""The margin to be removed as an order statistic: against brute force, and against a simulated resection."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from margin_cases import Shifts, affine_of, shell, volume_of
from removal_cases import (
    FEW,
    REMOVALS,
    SHAPES,
    appearing_voxels,
    box_of,
    drawn,
    in_given,
    leaves,
    looked_up,
    printed,
    ranks_of,
    turning,
    wide,
    without_cavities,
)
from scipy.ndimage import gaussian_filter
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from study.errors import PaddedVolumeWarning
from study.margins import GrowthSettings, allowed_hits, grow_margin
from study.registration import RobotError
from study.volumes import LabelVolume

pytestmark = pytest.mark.filterwarnings("ignore::study.errors.PaddedVolumeWarning")
ALLOWED = allowed_hits(300, 0.05, 0.95)


@cache
def grown(name, shape, risk=0.05, seed=3):
    volume, model = REMOVALS[name]
    return grow_margin(volume, "nerve", model, risk, shape, FEW, seed, purpose="remove")


@cache
def registered(name, seed=3):
    """Where the boundary appears, in voxels of the volume that is given: to grow on, to validate on."""
    volume, model = REMOVALS[name]
    return tuple(appearing_voxels(volume, volume.mask("nerve"), some) for some in drawn(model, seed))


def whole_union(margin, volume):
    """Structure and margin in a volume wide enough for both, and how much wider it is on each side."""
    at = in_given(margin, volume)
    room = int(max(0, -at.min(initial=0), (at - volume.shape).max(initial=-1) + 1))
    union = wide(volume, volume.mask("nerve"), room)
    assert not union[tuple((at + room).T)].any()
    union[tuple((at + room).T)] = True
    return union, room


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("name", REMOVALS)
def test_needs_margin_and_risks_are_those_of_brute_force(name, shape):
    volume, _ = REMOVALS[name]
    margin = grown(name, shape)
    landed, fresh = registered(name)
    ranks, low = ranks_of(margin, volume)
    solid = np.argwhere(volume.mask("nerve")) - low
    ranks[tuple(solid.T)] = 0
    ranked = len(margin.choice.ranking.order)
    needs = looked_up(ranks, landed - low, ranked + 1).max(axis=1)
    assert np.array_equal(margin.needs, needs)
    # The curve goes to a third of what is allowed: what is beyond the box needs more.
    assert np.count_nonzero(needs > ranked) <= ALLOWED // 3
    size = np.sort(needs)[299 - ALLOWED]
    cavity = without_cavities(volume.mask("nerve")) & ~volume.mask("nerve")
    size = max(size, cavity.sum())
    union, room = whole_union(margin, volume)
    by_rank = np.zeros_like(union)
    by_rank[tuple((np.argwhere(ranks <= size) + low + room).T)] = True
    assert np.array_equal(union, without_cavities(by_rank))
    assert margin.estimate.hits == leaves(union, landed + room).sum() <= ALLOWED
    assert margin.validation.hits == leaves(union, fresh + room).sum()
    if margin.voxels == size > cavity.sum():  # one voxel less would be too little
        by_rank[tuple((np.argwhere(ranks == size) + low + room).T)] = False
        assert leaves(by_rank, landed + room).sum() > ALLOWED


def ranking_by_hand(volume, solid, outside, model, shape, seed, how):
    """Voxels outside in the order in which they enter a margin, and how far they are from the structure, mm.

    What the structure encloses; then, varying with place, by the share of registrations of a set of their
    own that bring any voxel of the structure there, smoothed; then by distance; then by place.
    """
    points = volume.points(outside.astype(float))
    far = cKDTree(volume.points(np.argwhere(solid).astype(float))).query(points)[0].round(9)
    enclosed = (without_cavities(solid) & ~solid)[tuple(outside.T)]
    far[enclosed] = 0
    risk = np.zeros(len(outside))
    if shape == SHAPES[0]:
        own = np.random.default_rng(seed).spawn(3)[2]
        counts = np.zeros(solid.shape)
        homogeneous = np.column_stack([volume.points(np.argwhere(solid).astype(float)), np.ones(solid.sum())])
        for transform in model.sample(how.violation_registrations, own):
            appears = volume.indices(np.linalg.solve(transform, homogeneous.T).T[:, :3])
            voxels = np.unique(np.floor(appears + 0.5).astype(int), axis=0)
            voxels = voxels[((voxels >= 0) & (voxels < solid.shape)).all(axis=1)]
            counts[tuple(voxels.T)] += 1
        risk = gaussian_filter(counts / how.violation_registrations, 1.0, mode="constant")
        risk = risk[tuple(outside.T)].round(9)
    order = np.lexsort((np.arange(len(outside)), far, -risk, ~enclosed))
    return outside[order], far[order]


RANKED = GrowthSettings(registrations=300, validation_registrations=200, violation_registrations=250)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "name",
    [
        "tube",
        "oblique, anisotropic, several parts",
        "at the edge on all sides",
        "many voxels",
        "ball, oblique and flipped",
        "thick shell with a cavity",
        "farther than it is thick",
    ],
)
def test_the_whole_margin_by_brute_force_without_any_of_the_engine(name, shape):
    # Own boundary, own ranking, own order statistic over a volume padded by hand.
    given, model = REMOVALS[name]
    seed = 6
    margin = grow_margin(given, "nerve", model, 0.05, shape, RANKED, seed, purpose="remove")
    beyond = margin.choice.region.shape - np.array(given.shape)
    room = int(max(0, -box_of(margin, given).min(), beyond.max()))
    solid = wide(given, given.mask("nerve"), room + 4)
    big = LabelVolume(solid.astype(np.uint8), affine_of_corner(given, -room - 4), given.names)
    transforms, fresh = drawn(model, seed)
    outside, far = ranking_by_hand(big, solid, np.argwhere(~solid), model, shape, seed, RANKED)
    ranks = np.zeros(big.shape, int)
    ranks[tuple(outside.T)] = np.arange(1, len(outside) + 1)
    landed = appearing_voxels(big, solid, transforms)
    # A registration beyond this volume needs more than all of it.
    needs = looked_up(ranks, landed, len(outside) + 1).max(axis=1)
    size = max(np.sort(needs)[299 - ALLOWED], (without_cavities(solid) & ~solid).sum())
    union = without_cavities(ranks <= size)
    mine = solid.copy()
    mine[tuple((in_given(margin, given) + room + 4).T)] = True
    assert np.count_nonzero(mine ^ union) <= 0.002 * union.sum()  # ties of a rounded share
    same = np.array_equal(mine, union)
    assert same or shape == SHAPES[0]
    if same:
        assert margin.distance == pytest.approx(far[:size].max(initial=0))
        assert margin.estimate.hits == leaves(union, landed).sum()
        assert margin.validation.hits == leaves(union, appearing_voxels(big, solid, fresh)).sum()


def affine_of_corner(volume, index):
    affine = volume.affine.copy()
    affine[:3, 3] = volume.points(np.full((1, 3), float(index)))[0]
    return affine


@pytest.mark.parametrize("shape", SHAPES)
def test_curve_is_the_risk_of_margins_made_by_hand(shape):
    for name in ("ball, oblique and flipped", "thick shell with a cavity", "cut off by the edge"):
        volume, _ = REMOVALS[name]
        margin, (landed, _) = grown(name, shape), registered(name)
        ranks, low = ranks_of(margin, volume)
        ranks[tuple((np.argwhere(volume.mask("nerve")) - low).T)] = 0
        curve = margin.curve()
        assert (np.diff(curve["risk"]) < 0).all() and (np.diff(curve["margin_voxels"]) > 0).all()
        assert curve["risk"].iloc[-1] <= 0.05 / 3
        for row in curve.iloc[:: max(1, len(curve) // 10)].itertuples():
            assert row.risk == leaves(ranks <= row.margin_voxels, landed - low).mean()
            assert row.volume_mm3 == pytest.approx(row.margin_voxels * volume.voxel_volume)
        far = curve["distance"].to_numpy()
        assert (np.diff(far) >= -1e-8).all() and far[0] == 0


def test_the_margin_grows_to_where_the_tumour_appears():
    # An image point lands 3 mm further along x than it should, so what is cut lies 3 mm further than planned:
    # the patient's tumour appears at x - 3, and a plan has to hold that place.
    solid = np.zeros((30, 20, 20), bool)
    solid[12:18, 8:12, 8:12] = True
    for affine in (affine_of((1, 1, 1)), affine_of((1, 1, 1), flip=(-1, 1, 1), origin=(9, 9, 9))):
        volume = volume_of(solid, affine)
        shifted = Shifts((3.0, 0, 0), 0.05)
        few = GrowthSettings(registrations=300, validation_registrations=300)
        margin = grow_margin(volume, "nerve", shifted, 0.05, settings=few, rng=0, purpose="remove")
        must = np.roll(solid, -3 if affine[0, 0] > 0 else 3, axis=0) & ~solid
        assert margin.mask[must].all() and margin.validation.risk <= 0.05
        steps = GrowthSettings.for_removal("published", registrations=300, least_transfer=5)
        counted = grow_margin(volume, "nerve", shifted, 0.05, settings=steps, rng=0, purpose="remove")
        # counted violations know the side: nothing is taken from the tumour's other end
        assert np.array_equal(counted.mask, must)


def patient_points(volume, solid, rng, each=4):
    """Points of a tumour, several a voxel, mm."""
    voxels = np.repeat(np.argwhere(solid), each, axis=0)
    return volume.points(voxels + rng.uniform(-0.5, 0.5, (len(voxels), 3)))


def left_behind(margin, points, transform):
    """Which points of a patient are left when all that appears inside tumour and margin is gone."""
    appears = np.linalg.solve(transform, np.column_stack([points, np.ones(len(points))]).T).T[:, :3]
    voxels = np.floor(margin.volume.indices(appears) + 0.5).astype(int)
    return ~looked_up(margin.inside, voxels, False)


@pytest.mark.parametrize(
    "method, shape", [("exact", SHAPES[0]), ("exact", SHAPES[1]), ("published", SHAPES[0])]
)
def test_a_simulated_resection_leaves_no_tumour_behind(method, shape):
    volume = volume_of(shell((30, 30, 30), (15, 14, 15), 0, 5.3), affine_of((1, 1, 1), (0.2, 0.4, 0.1)))
    # A mean error as well, so that a transform and its inverse do not do the same.
    model = RobotError(volume.points(np.array([[15.0, 14, 60]]))[0], 0.7, 0.02, np.eye(3), (2.0, 0, -1.5))
    how = GrowthSettings.for_removal(
        method, registrations=2000, validation_registrations=500, least_transfer=20
    )
    margin = grow_margin(volume, "nerve", model, 0.05, shape, how, 5, purpose="remove")
    rng = np.random.default_rng(77)
    centres = margin.volume.points(np.argwhere(margin.structure_mask).astype(float))
    everywhere = patient_points(margin.volume, margin.structure_mask, rng)
    transforms = model.sample(400, rng)
    any_centre = np.mean([left_behind(margin, centres, one).any() for one in transforms])
    shares = [left_behind(margin, everywhere, one).mean() for one in transforms]
    turned_round = np.mean([left_behind(margin, centres, np.linalg.inv(one)).any() for one in transforms])
    # 0.05 and three standard errors, and what stopping where one ranks adds
    assert 0 < any_centre <= (0.085 if method == "exact" else 0.12)
    assert np.mean(shares) < 0.01  # of the tumour, on average
    assert turned_round > 0.9 if method == "published" else True


def test_protecting_and_removing_ask_for_about_the_same_tissue():
    volume = volume_of(shell((44, 44, 44), (22, 21, 22), 0, 8), affine_of((0.5, 0.5, 0.5)))
    model = turning(volume, 0.8, 0.03)
    settings = GrowthSettings(registrations=3000, validation_registrations=0)
    for shape in SHAPES:
        protect, remove = (
            grow_margin(volume, "nerve", model, 0.02, shape, settings, 1, purpose=purpose)
            for purpose in ("protect", "remove")
        )
        thick = [np.cbrt(3 / (4 * np.pi) * m.inside.sum()) for m in (protect, remove)]
        assert 0 < thick[0] - thick[1] < 1  # voxels: corners of voxels reach farther than their centres
        overlap = (protect.inside & remove.inside).sum() / (protect.inside | remove.inside).sum()
        assert overlap > 0.8


def test_the_three_sets_of_registrations_are_disjoint():
    class Recorded:
        def __init__(self, model):
            self.model, self.sets = model, []

        def sample(self, n, rng=None):
            self.sets.append(self.model.sample(n, rng))
            return self.sets[-1]

    volume, model = REMOVALS["ball, oblique and flipped"]
    for how in (FEW, printed(violation_registrations=700)):
        recorded = Recorded(model)
        margin = grow_margin(volume, "nerve", recorded, 0.05, settings=how, rng=0, purpose="remove")
        sizes = [len(some) for some in recorded.sets]
        assert sizes[0] == 300 and margin.validation.registrations in sizes
        every = np.concatenate(recorded.sets).reshape(sum(sizes), 16)
        assert len(np.unique(every, axis=0)) == len(every)
        hits = [margin._estimated(some).hits for some in recorded.sets]
        assert hits[0] == margin.estimate.hits
        assert margin.validation.hits in hits[1:]


class Prepared:
    """Registrations that were drawn before, whoever asks."""

    def __init__(self, transforms):
        self.transforms = transforms

    def sample(self, n, rng=None):
        return self.transforms[:n]


BALL = volume_of(shell((13, 13, 13), (6, 6, 6), 0, 2.3), affine_of((0.5, 0.5, 0.5)))
BALL_ERROR = RobotError((3.0, 3.0, 37.0), 1.0, 0.02)
TOLERANCE = 0.03


@cache
def true_over_tolerance(method, shape, runs, registrations=1000):
    judges = Prepared(BALL_ERROR.sample(40_000, 999))
    changes = {"registrations": registrations, "validation_registrations": 0}
    if method == "published":
        changes |= {"least_transfer": 1, "violation_registrations": registrations}
    settings = GrowthSettings.for_removal(method, **changes)
    out = []
    for seed in range(runs):
        margin = grow_margin(BALL, "nerve", BALL_ERROR, TOLERANCE, shape, settings, seed, purpose="remove")
        assert margin.damage_risk <= TOLERANCE
        out.append(margin.risk_on(40_000, model=judges).risk / TOLERANCE)
    return np.array(out)


@pytest.mark.parametrize("shape", SHAPES)
def test_exact_margins_keep_the_tolerance_with_the_confidence_that_is_asked_for(shape):
    found = true_over_tolerance("exact", shape, 20)
    assert (found > 1).sum() <= 4  # of 20 at 5 %: more in one of 390 series
    assert np.median(found) > 0.5  # nor are they needlessly large


def test_ranking_and_stopping_on_the_same_registrations_overshoots():
    found = true_over_tolerance("published", SHAPES[0], 6)
    assert np.median(found) > 1.2
    # much less so where distance ranks and the same registrations only stop
    assert np.median(true_over_tolerance("published", SHAPES[1], 6)) < 0.8 * np.median(found)


def test_a_larger_risk_never_needs_a_larger_margin():
    volume, model = REMOVALS["ball, oblique and flipped"]
    for shape in SHAPES:
        few = replace(FEW, registrations=400, validation_registrations=0)
        masks = [
            grow_margin(volume, "nerve", model, risk, shape, few, 1, purpose="remove")
            for risk in (0.01, 0.02, 0.05, 0.1, 0.3, 0.9)
        ]
        sets = [set(map(tuple, in_given(margin, volume))) for margin in masks]
        assert all(small <= large for large, small in pairwise(sets))
        assert len(sets[-1]) < len(sets[0])


class Moved:
    """An error source in a frame that was moved."""

    def __init__(self, model, frame):
        self.model, self.frame = model, frame

    def sample(self, n, rng=None):
        return self.frame @ self.model.sample(n, rng) @ np.linalg.inv(self.frame)


@given(st.integers(0, 10_000), st.sampled_from(SHAPES))
@settings(max_examples=8, deadline=None)
def test_moving_volume_and_error_together_changes_nothing(seed, shape):
    rng = np.random.default_rng(seed)
    volume, model = REMOVALS["rod"]
    frame = np.eye(4)
    frame[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    frame[:3, 3] = rng.normal(size=3) * 100
    turned = LabelVolume(volume.labels, frame @ volume.affine, volume.names)
    few = replace(FEW, registrations=200, validation_registrations=100)
    here = grow_margin(volume, "nerve", Moved(model, np.eye(4)), 0.05, shape, few, seed, purpose="remove")
    there = grow_margin(turned, "nerve", Moved(model, frame), 0.05, shape, few, seed, purpose="remove")
    one, two = (set(map(tuple, in_given(m, v))) for m, v in ((here, volume), (there, turned)))
    assert len(one ^ two) <= 2 + 0.01 * len(one)  # rounding breaks ties another way
    assert abs(here.estimate.hits - there.estimate.hits) <= 1
    assert abs(here.validation.hits - there.validation.hits) <= 1


@given(st.permutations([0, 1, 2, 3, 4, 5]), st.permutations(range(3)))
@settings(max_examples=5, deadline=None)
def test_labels_and_axes_may_be_permuted(values, axes):
    volume, model = REMOVALS["blobs, mirrored"]
    solid = volume.mask("nerve")
    plain = grow_margin(volume, "nerve", model, 0.05, settings=FEW, rng=2, purpose="remove")
    names = dict(zip(("background", "kidney", "nerve", "vein", "air", "cyst"), values, strict=True))
    labels = np.where(
        solid, names["nerve"], np.where(np.indices(solid.shape)[0] > 9, names["kidney"], values[0])
    )
    other = LabelVolume(labels.astype(np.uint8), volume.affine, names)
    margin = grow_margin(other, "nerve", model, 0.05, settings=FEW, rng=2, purpose="remove")
    assert np.array_equal(in_given(margin, other), in_given(plain, volume))
    affine = volume.affine.copy()
    affine[:, :3] = affine[:, axes]
    moved = LabelVolume(volume.labels.transpose(axes), affine, volume.names)
    margin = grow_margin(moved, "nerve", model, 0.05, settings=FEW, rng=2, purpose="remove")
    here, there = (set(map(tuple, in_given(m, v))) for m, v in ((plain, volume), (margin, moved)))
    there = {tuple(np.array(v)[np.argsort(axes)]) for v in there}
    assert len(here ^ there) <= 4
    assert abs(margin.estimate.hits - plain.estimate.hits) <= 1


@pytest.mark.parametrize("name", ["cut off by the edge", "at the edge on all sides"])
def test_a_margin_beyond_the_volume_pads_it_and_says_so(name):
    volume, model = REMOVALS[name]
    with pytest.warns(
        PaddedVolumeWarning, match=r"nerve: the margin leaves the volume, .* padded by \["
    ) as said:
        margin = grow_margin(volume, "nerve", model, 0.05, settings=FEW, rng=3, purpose="remove")
    first = np.rint(volume.indices(margin.volume.points(np.zeros((1, 3))))[0]).astype(int)
    above = np.array(margin.volume.shape) + first - volume.shape
    assert str((-first).tolist()) in str(said[0].message) and str(above.tolist()) in str(said[0].message)
    assert str(margin.volume.shape) in str(said[0].message)
    given = tuple(slice(a, a + n) for a, n in zip(-first, volume.shape, strict=True))
    assert np.array_equal(margin.volume.labels[given], volume.labels)
    assert np.array_equal(margin.structure_mask[given], volume.mask("nerve"))
    assert margin.structure_mask.sum() == volume.mask("nerve").sum() == margin.volume.mask("nerve").sum()
    outside = margin.mask.copy()
    outside[given] = False
    assert outside.any() and (margin.volume.labels[outside] == volume.names["air"]).all()
    np.testing.assert_allclose(margin.volume.affine[:3, :3], volume.affine[:3, :3])
    assert margin.volume_mm3 == pytest.approx(margin.mask.sum() * volume.voxel_volume)
    assert len(margin.final_shell) == len(margin.shell_distances)


def test_a_margin_within_the_volume_keeps_it(recwarn):
    volume, model = REMOVALS["tube"]
    margin = grow_margin(volume, "nerve", model, 0.05, settings=FEW, rng=3, purpose="remove")
    assert margin.volume is volume and margin.mask.shape == volume.shape
    assert not [w for w in recwarn if w.category is PaddedVolumeWarning]


@pytest.mark.parametrize("shape", SHAPES)
def test_same_seed_same_bytes(shape):
    volume, model = REMOVALS["blobs, mirrored"]
    first, second = (
        grow_margin(volume, "nerve", model, 0.05, shape, FEW, 8, purpose="remove") for _ in range(2)
    )
    assert first.mask.tobytes() == second.mask.tobytes() and first.needs.tobytes() == second.needs.tobytes()
    assert first.validation == second.validation and first.curve().equals(second.curve())
    assert first.risk_on(200, np.random.default_rng(8).spawn(2)[1]) == first.validation
    third = grow_margin(volume, "nerve", model, 0.05, shape, FEW, 9, purpose="remove")
    assert not np.array_equal(first.needs, third.needs)
