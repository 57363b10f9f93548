"""The guided robot, tick by tick: one hole at a time."""

from study.guidance.loop.hole import DrilledHole
from study.guidance.loop.run import HoleRun
from study.guidance.loop.settings import LoopSettings

__all__ = ["DrilledHole", "HoleRun", "LoopSettings"]
