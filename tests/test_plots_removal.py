"""What the figures of chapter 4 show is what its margins are made of."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure
from small_kidney import loose, small_kidney

from study.errors import InputError
from study.experiments.kidney_chapter import removal_settings
from study.margins import RiskEstimate, grow_margin
from study.margins.removal_steps import outermost, protruding, removal_step, typical_protrusion
from study.plots.removal import axial_plane, coronal_plane, removal_risks, removal_transfer_figure
from study.plots.surface_registration import fits_figure, scatter_figure
from study.registration import RobotError

SEED = 4
SETTINGS = replace(
    removal_settings(200, "published"), least_transfer=20, initial_transfer=0.3, violation_registrations=120
)


@pytest.fixture(scope="module")
def grown():
    return grow_margin(
        small_kidney().anatomy, "tumour", loose(), 0.02, settings=SETTINGS, rng=SEED, purpose="remove"
    )


@pytest.fixture(scope="module")
def exact():
    settings = removal_settings(300)
    return grow_margin(
        small_kidney().anatomy, "tumour", loose(), 0.02, settings=settings, rng=SEED, purpose="remove"
    )


def boundary_by_hand(mask):
    """Centres of voxels with a face outside, looked at one by one."""
    out = []
    for voxel in np.argwhere(mask):
        for step in np.vstack([np.eye(3, dtype=int), -np.eye(3, dtype=int)]):
            near = voxel + step
            if (near < 0).any() or (near >= mask.shape).any() or not mask[tuple(near)]:
                out.append(voxel)
                break
    return np.array(out)


def test_step_counts_each_registration_once_a_voxel(grown):
    step = removal_step(grown, 0.4, SEED)
    volume, union = grown.volume, grown.structure_mask | step.before
    growing = np.random.default_rng(SEED).spawn(1)[0]
    transforms = grown.model.sample(SETTINGS.registrations, growing)
    centres = volume.points(boundary_by_hand(grown.structure_mask).astype(float))
    while len(transforms) < step.counted:
        more = grown.model.sample(SETTINGS.violation_registrations, growing)
        transforms = np.concatenate([transforms, more])
    counts = np.zeros(volume.shape, int)
    for transform in transforms[: step.counted]:
        back = np.linalg.inv(transform)
        index = np.floor(volume.indices(centres @ back[:3, :3].T + back[:3, 3]) + 0.5).astype(int)
        index = index[((index >= 0) & (index < volume.shape)).all(axis=1)]
        counts[tuple(np.unique(index, axis=0).T)] += 1
    counts[union] = 0
    assert counts.max() > 0
    np.testing.assert_array_equal(step.violations, counts)


def test_step_takes_the_worst_and_what_they_enclose(grown):
    step = removal_step(grown, 0.4, SEED)
    history = grown.history
    taken, left = step.violations[step.chosen], step.violations.copy()
    left[step.chosen | step.before | grown.structure_mask] = 0
    assert taken.min() >= max(1, left.max())
    assert not (step.chosen & (step.before | grown.structure_mask)).any()
    assert not (step.enclosed & step.chosen).any()
    assert np.count_nonzero(step.before) == history["margin_voxels"].iloc[step.number]
    assert np.count_nonzero(step.after) == history["margin_voxels"].iloc[step.number + 1]
    assert step.risk == history["risk"].iloc[step.number]
    voxels, shares = step.shell(grown.structure_mask)
    assert shares.max() == step.violations.max() / step.counted
    assert len(voxels) >= np.count_nonzero(step.violations)


def test_last_step_leads_to_the_margin_itself(grown):
    last = removal_step(grown, float(grown.history["risk"].iloc[-2]), SEED)
    assert last.number == len(grown.history) - 2
    np.testing.assert_array_equal(last.after, grown.mask)


def test_another_seed_is_noticed(grown):
    with pytest.raises(InputError, match=r"rng: expected what the margin was grown with"):
        removal_step(grown, 0.0, SEED + 1)


def test_margins_without_steps_are_refused(exact, grown):
    with pytest.raises(InputError, match="grown in steps; got spatially_varying to remove by method 'exact'"):
        removal_step(exact, 0.4, SEED)
    with pytest.raises(InputError, match="expected a margin to remove, grown in steps"):
        removal_transfer_figure(exact)
    idle = replace(grown, history=grown.history.iloc[-1:])
    with pytest.raises(InputError, match="got one that needed none"):
        removal_step(idle, 0.4, SEED)


def test_share_of_protruding_registrations_in_plain_python_is_the_risk_of_the_kernels(exact):
    transforms = exact.model.sample(150, np.random.default_rng(8))
    for margin in (exact, replace(exact, mask=np.zeros_like(exact.mask))):
        union = margin.structure_mask | margin.mask
        centres = margin.volume.points(boundary_by_hand(margin.structure_mask).astype(float))
        hits = sum(protruding(margin.volume, union, centres, np.linalg.inv(one)).any() for one in transforms)
        assert hits == margin.risk_on(150, 8).hits
    assert hits > 0


def test_typical_protrusion_is_the_one_asked_for(grown):
    step = removal_step(grown, 0.4, SEED)
    args = grown.volume, grown.structure_mask, step.before, loose(), 60, 3
    median, worse = typical_protrusion(*args), typical_protrusion(*args, share=0.9)
    assert 0 < median.hits == worse.hits < median.registrations == 60
    assert 0 < median.outside.sum() <= worse.outside.sum()
    union = grown.structure_mask | step.before
    again = protruding(grown.volume, union, median.centres, median.transform)
    np.testing.assert_array_equal(again, median.outside)


def test_without_error_nothing_protrudes():
    volume = small_kidney().anatomy
    mask = volume.mask("tumour")
    shown = typical_protrusion(volume, mask, np.zeros_like(mask), RobotError((0, 0, 0)), 5, 0)
    assert shown.hits == 0 and not shown.outside.any()


def test_outermost_voxels_have_a_face_outside():
    mask = small_kidney().anatomy.mask("tumour")
    np.testing.assert_array_equal(np.argwhere(outermost(mask)), boundary_by_hand(mask))


def test_sections_lie_as_scans_do():
    axial, coronal = axial_plane(np.zeros(3), 10), coronal_plane(np.zeros(3), 10)
    left_behind_above = np.array([[1.0, 2.0, 3.0]])  # LPS
    np.testing.assert_allclose(axial.place(left_behind_above)[0, :2], [1, 2])  # posterior is down
    np.testing.assert_allclose(coronal.place(left_behind_above)[0, :2], [1, -3])  # superior is up


def drawn_figures(grown, exact):
    stops, rng = (0, 1, 5, 500), np.random.default_rng(0)
    errors = rng.uniform(0.1, 5, (4, 20))
    residual = np.vstack([np.full(20, np.nan), rng.uniform(0.3, 2, (3, 20))])
    iterations = np.tile([[0], [1], [5], [60]], 20)
    return {
        "transfer": removal_transfer_figure(grown),
        "risks": removal_risks({"loose": {"published growth": grown, "exact": exact}}),
        "fits": fits_figure(stops, errors, residual, iterations),
        "scatter": scatter_figure(
            {"after 5": rng.normal(size=(20, 3)), "converged": np.zeros((20, 3))}, 500.0
        ),
    }


def test_charts_are_drawn(grown, exact, tmp_path):
    for name, figure in drawn_figures(grown, exact).items():
        assert isinstance(figure, Figure)
        figure.savefig(tmp_path / f"{name}.png", dpi=40)


@pytest.mark.parametrize(("hits", "shown"), [(3, 3 / 200), (0, 0.5 / 200)])
def test_risk_chart_marks_the_stop_and_the_validated_risk(grown, hits, shown):
    """None of the registrations has a level of its own on the logarithmic axis."""
    margin = replace(grown, estimate=RiskEstimate(hits, 200), validation=RiskEstimate(9, 200))
    (axes,) = removal_risks({"loose": {"published growth": margin}}).axes
    marked = [tuple(line.get_xydata()[0]) for line in axes.lines if len(line.get_xydata()) == 1]
    assert marked == [(margin.volume_mm3, shown), (margin.volume_mm3, 9 / 200)]
    assert axes.get_ylim()[0] < 0.5 / 200
    assert [label.get_text() for label in axes.get_yticklabels()][-1] == "none"
