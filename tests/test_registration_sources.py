"""Error sources: what they draw agrees with what they say of themselves, alone and combined."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from study.errors import InputError
from study.registration import (
    CombinedErrors,
    DisplacementMoments,
    ErrorSource,
    ImageError,
    PointRegistration,
    RobotError,
    displacement_moments,
    sampled_moments,
)

POINTS = np.array([[0, 0, 0], [30, -10, 5], [-20, 40, 60], [5, 5, -45.0]])
FIDUCIALS = np.array([[0, 0, 0], [50, 2, 5], [10, 45, -8], [-20, 25, 12.0]])
STIFF = np.array([[0.02, 0.005, 0], [0.005, 0.03, -0.004], [0, -0.004, 0.01]])


class OnlyDrawn:
    """A source without moments of its own."""

    def __init__(self, source):
        self.source = source

    def sample(self, n, rng=None):
        return self.source.sample(n, rng)


SOURCES = {
    "registration": PointRegistration(FIDUCIALS, (0.2, 0.3), weights=[1, 2, 3, 1]),
    "image scale": ImageError((10, 20, 30), scale_std=(0.002, 0.004, 0.001)),
    "image position": ImageError((0, 0, 0), position_std=(0.1, 0.2, 0.05)),
    "image": ImageError((10, 20, 30), scale_std=0.002, position_std=0.1),
    "robot pose": RobotError((5, 0, -70), position_std=(0.1, 0.05, 0.2), rotation_std=(0.002, 0.004, 0.001)),
    "robot under force": RobotError((5, 0, 0), compliance=STIFF, force_mean=(5, -3, 8), force_std=(2, 3, 4)),
    "robot": RobotError((5, 0, 0), 0.1, 0.003, STIFF, (5, 0, 0), 2),
}
SOURCES["all"] = CombinedErrors(list(SOURCES.values()))
SOURCES["nested"] = CombinedErrors((CombinedErrors([SOURCES["image"]]), OnlyDrawn(SOURCES["robot"])))


@pytest.mark.parametrize("name", SOURCES)
def test_moments_are_those_of_many_draws(name):
    source = SOURCES[name]
    assert isinstance(source, ErrorSource)
    drawn = source.sample(100_000, 21)
    assert drawn.shape == (100_000, 4, 4) and np.array_equal(drawn[:, 3], np.tile([0, 0, 0, 1], (100_000, 1)))
    stated, sampled = displacement_moments(source), sampled_moments(drawn)
    # A part of it is estimated from 20 000 draws where a source does not know its moments.
    close = 0.05 if name == "nested" else 0.02
    for point, covariance in zip(POINTS, stated.at(POINTS), strict=True):
        miss = drawn[:, :3, :3] @ point + drawn[:, :3, 3] - point
        measured = np.cov(miss, rowvar=False)
        scale = covariance.max()
        np.testing.assert_allclose(
            sampled.at(point[None])[0], measured, atol=1e-9 * max(scale, 1e-9), rtol=1e-6
        )
        np.testing.assert_allclose(measured, covariance, atol=close * scale)
        np.testing.assert_allclose(
            np.linalg.eigvalsh(measured), np.linalg.eigvalsh(covariance), rtol=close, atol=0.002 * scale
        )


@pytest.mark.parametrize("name", SOURCES)
def test_moments_about_another_centre_say_the_same(name):
    moments = displacement_moments(SOURCES[name])
    for centre in ([0, 0, 0], [100, -200, 50]):
        other = moments.about(centre)
        assert np.array_equal(other.centre, centre)
        np.testing.assert_allclose(other.at(POINTS), moments.at(POINTS), rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(other.about(moments.centre).covariance, moments.covariance, atol=1e-9)


@pytest.mark.parametrize("name", SOURCES)
def test_same_seed_same_bytes(name):
    source = SOURCES[name]
    assert source.sample(50, 3).tobytes() == source.sample(50, np.random.default_rng(3)).tobytes()
    assert not np.array_equal(source.sample(50, 3), source.sample(50, 4))
    assert np.array_equal(displacement_moments(source).covariance, displacement_moments(source).covariance)


def test_scale_errs_about_its_centre_and_along_the_axes():
    drawn = ImageError((10, 20, 30), scale_std=0.01).sample(500, 0)
    np.testing.assert_allclose(drawn @ [10, 20, 30, 1], np.tile([10, 20, 30, 1], (500, 1)), atol=1e-12)
    ahead = drawn @ [110, 20, 30, 1] - [110, 20, 30, 1]
    assert ahead[:, 0].std() == pytest.approx(1, rel=0.1)
    np.testing.assert_allclose(ahead[:, 1:], 0, atol=1e-12)


def test_compliance_is_a_force_times_a_softness():
    still = RobotError((0, 0, 0), compliance=STIFF, force_mean=(10, 0, 0)).sample(4, 0)
    np.testing.assert_allclose(still[:, :3, 3], np.tile([0.2, 0.05, 0], (4, 1)), atol=1e-12)
    np.testing.assert_allclose(still[:, :3, :3], np.tile(np.eye(3), (4, 1, 1)), atol=1e-15)
    # A mean deflection is an offset: it does not scatter.
    assert not displacement_moments(
        RobotError((0, 0, 0), compliance=STIFF, force_mean=(10, 0, 0))
    ).covariance.any()


def test_a_robot_turns_about_its_centre():
    drawn = RobotError((5, 6, 7), rotation_std=(0, 0, 0.5)).sample(200, 1)
    np.testing.assert_allclose(drawn @ [5, 6, 7, 1], np.tile([5, 6, 7, 1], (200, 1)), atol=1e-12)
    turns = Rotation.from_matrix(drawn[:, :3, :3]).as_rotvec()
    assert turns[:, 2].std() == pytest.approx(0.5, rel=0.15) and np.abs(turns[:, :2]).max() < 1e-12


def test_sources_act_one_after_the_other():
    class Always:
        def __init__(self, transform):
            self.transform = np.array(transform, dtype=float)

        def sample(self, n, rng=None):
            return np.tile(self.transform, (n, 1, 1))

    turn = Always([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    shift = Always([[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    np.testing.assert_allclose(CombinedErrors([turn, shift]).sample(1)[0] @ [1, 0, 0, 1], [5, 1, 0, 1])
    np.testing.assert_allclose(CombinedErrors([shift, turn]).sample(1)[0] @ [1, 0, 0, 1], [0, 6, 0, 1])


def test_independent_sources_add_their_covariances():
    alone = [displacement_moments(SOURCES[name]).at(POINTS) for name in ("registration", "image", "robot")]
    both = CombinedErrors([SOURCES[name] for name in ("registration", "image", "robot")])
    np.testing.assert_allclose(both.moments().at(POINTS), sum(alone), rtol=1e-9)
    # The same source twice is two independent errors.
    twice = CombinedErrors([SOURCES["image"]] * 2)
    np.testing.assert_allclose(twice.moments().at(POINTS), 2 * alone[1], rtol=1e-9)
    first, second = np.cov(twice.sample(20_000, 0)[:, :3, 3], rowvar=False), alone[1]
    assert np.trace(first) == pytest.approx(2 * np.trace(second[0]), rel=0.05)


def test_moments_of_a_motion_are_those_of_its_points():
    motion = np.diag([1e-4, 4e-4, 9e-4, 0.01, 0.02, 0.03])
    at = DisplacementMoments.of_motion([1, 2, 3], motion).at([[1, 2, 3], [11, 2, 3]])
    np.testing.assert_allclose(at[0], np.diag([0.01, 0.02, 0.03]))
    np.testing.assert_allclose(at[1], np.diag([0.01, 0.02 + 100 * 9e-4, 0.03 + 100 * 4e-4]))


# --- bad input --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: ImageError((0, 0)), r"centre: expected three finite numbers in mm, got \[0, 0\]"),
        (lambda: ImageError([[0, 0, 0], [1, 1, 1]]), "centre: expected three finite numbers"),
        (lambda: ImageError((0, 0, np.inf)), "centre.*inf"),
        (lambda: ImageError((0, 0, 0), scale_std=-0.1), "scale_std: expected .* at least 0.*got -0.1"),
        (lambda: ImageError((0, 0, 0), position_std=(1, 2)), r"position_std.*\(3,\).*got \[1, 2\]"),
        (lambda: ImageError((0, 0, 0), position_std=np.nan), "position_std.*nan"),
        (lambda: RobotError((0, 0, 0), rotation_std=(0, 0, -1)), "rotation_std.*rad.*-1"),
        (lambda: RobotError((0, 0, 0), compliance=np.eye(2)), r"compliance: expected a symmetric \(3, 3\)"),
        (
            lambda: RobotError((0, 0, 0), compliance=[[1, 2, 0], [0, 1, 0], [0, 0, 1]]),
            "compliance.*symmetric.*2",
        ),
        (lambda: RobotError((0, 0, 0), force_mean=(1, 2)), r"force_mean: .* in N, got \[1, 2\]"),
        (lambda: RobotError((0, 0, 0), force_std=-2), "force_std.*N, got -2"),
        (lambda: CombinedErrors([]), "sources: expected error sources.*got none"),
        (lambda: CombinedErrors([SOURCES["image"], 3]), "sources.*int"),
        (lambda: displacement_moments(object()), "sample.*got object"),
    ],
)
def test_bad_sources(make, said):
    with pytest.raises(InputError, match=said):
        make()


@pytest.mark.parametrize(
    "drawn, said",
    [
        (np.eye(4), r"Fixed.sample: expected shape \(20000, 4, 4\), got \(4, 4\)"),
        (np.zeros((20_000, 3, 4)), r"got \(20000, 3, 4\)"),
        (np.full((20_000, 4, 4), np.nan), "Fixed.sample: expected finite"),
        (np.zeros((20_000, 4, 4)), "last row 0 0 0 1"),
    ],
)
def test_sources_that_draw_nonsense(drawn, said):
    class Fixed:
        def sample(self, n, rng=None):
            return drawn

    with pytest.raises(InputError, match=said):
        displacement_moments(Fixed())


def test_one_source_need_not_be_in_a_list():
    assert CombinedErrors(SOURCES["image"]).sources == (SOURCES["image"],)
