"""From a `Plan` to joints and seconds: the robot, its trajectory, its feed rate (Siebold, 2.4.1)."""

from study.robots.ansr import Ansr
from study.robots.feed import FeedSettings, relative_density
from study.robots.fitting import fit_feed_constant
from study.robots.five_axis import FiveAxis
from study.robots.milling import Milling, Motion, predict_milling
from study.robots.rounding import RoundedPath, RoundingSettings, round_corners, rounding_is_safe
from study.robots.trajectory import JointTrajectory

__all__ = [
    "Ansr",
    "FeedSettings",
    "FiveAxis",
    "JointTrajectory",
    "Milling",
    "Motion",
    "RoundedPath",
    "RoundingSettings",
    "fit_feed_constant",
    "predict_milling",
    "relative_density",
    "round_corners",
    "rounding_is_safe",
]
