"""Samples of a marker as they arrive, late and sometimes wrong, and a reader that minds their time stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from study.errors import InputError
from study.guidance.frames import checked_transform
from study.guidance.tracker.markers import MarkerBody
from study.guidance.tracker.tracker import Tracker
from study.registration.sources import checked_vector

Intervals = Sequence[tuple[float, float]]


@dataclass(frozen=True, eq=False)
class TrackerSample:
    """What the tracker tells of a marker.

    Attributes
    ----------
    time_s : float
        When it arrives.
    exposure_s : float
        When, as its stamp says, the marker was where `pose` says.
    pose : (4, 4) array or None
        ``T_cam_body``; None when the marker was not seen.
    """

    time_s: float
    exposure_s: float
    pose: np.ndarray | None

    @property
    def visible(self) -> bool:
        """Whether the marker was seen."""
        return self.pose is not None


class TrackerStream:
    """Samples of a moving marker in the order of their arrival.

    One every ``cycle_s`` of the tracker's settings, each arriving ``delay_s`` after its exposure.

    Parameters
    ----------
    tracker : Tracker
    body : MarkerBody
    pose_at : callable
        True (4, 4) ``T_cam_body`` at a time in s.
    rng : anything `numpy.random.default_rng` takes
        Jitter.
    start_s : float
        First exposure.
    occluded : sequence of (float, float)
        Intervals of exposure, s, ends included, in which the marker is not seen.
    frozen : sequence of (float, float)
        Intervals in which the tracker repeats the last sample before them.
    frozen_stamps : bool
        Whether the repeated samples also repeat their time stamp.
    spikes : sequence of (float, (3,) array)
        Times, s, and by how much the sample nearest to each is misplaced, mm, camera's axes.

    Raises
    ------
    InputError
        If an interval ends before it begins or a number is not finite.

    Examples
    --------
    >>> from study.guidance.tracker import facing_pose
    >>> stream = TrackerStream(Tracker(rng=0), MarkerBody.plate(), lambda t: facing_pose([t, 0, 1500]), rng=0)
    >>> [round(sample.time_s, 2) for sample in stream.until(0.1)]
    [0.04, 0.08]
    """

    def __init__(
        self,
        tracker: Tracker,
        body: MarkerBody,
        pose_at: Callable[[float], np.ndarray],
        rng: object = None,
        *,
        start_s: float = 0.0,
        occluded: Intervals = (),
        frozen: Intervals = (),
        frozen_stamps: bool = False,
        spikes: Sequence[tuple[float, ArrayLike]] = (),
    ) -> None:
        self._tracker = tracker
        self._body = body
        self._pose_at = pose_at
        self._rng = np.random.default_rng(rng)
        self._start = start_s
        self._occluded = _checked("occluded", occluded)
        self._frozen = _checked("frozen", frozen)
        self._old_stamps = frozen_stamps
        self._spikes = [(float(time), checked_vector("spikes", vector, "mm")) for time, vector in spikes]
        if not np.isfinite([start_s, *(time for time, _ in self._spikes)]).all():
            raise InputError("start_s, spikes: expected finite times in s")

    def __iter__(self) -> Iterator[TrackerSample]:
        """Samples without end; the jitter goes on where it was left."""
        settings = self._tracker.settings
        last: TrackerSample | None = None
        frame = 0
        while True:
            exposure = self._start + frame * settings.cycle_s
            frame += 1
            arrival = exposure + settings.delay_s
            if last is not None and _inside(exposure, self._frozen):
                stamp = last.exposure_s if self._old_stamps else exposure
                yield TrackerSample(arrival, stamp, last.pose)
                continue
            last = TrackerSample(arrival, exposure, self._seen(exposure))
            yield last

    def _seen(self, exposure: float) -> np.ndarray | None:
        if _inside(exposure, self._occluded):
            return None
        pose = self._tracker.measured(self._body, np.asarray(self._pose_at(exposure))[None], self._rng)[0]
        for time, vector in self._spikes:
            if -0.5 <= (time - exposure) / self._tracker.settings.cycle_s < 0.5:
                pose[:3, 3] += vector
        return pose

    def until(self, end_s: float) -> Iterator[TrackerSample]:
        """Samples that arrive up to a time, s."""
        for sample in self:
            if sample.time_s > end_s:
                return
            yield sample


class SampleReader:
    """Takes samples one by one and refuses those that cannot come next.

    Attributes
    ----------
    pose : (4, 4) array or None
        Last seen; kept while the marker is hidden.
    exposure_s : float
        Time stamp of the last sample, minus infinity before the first.
    missing : int
        Samples in a row up to now without a pose.
    repeated : int
        Samples in a row up to now whose pose is to the last bit the one before: jitter never repeats, a
        tracker that hangs does.
    """

    def __init__(self) -> None:
        self.pose: np.ndarray | None = None
        self.exposure_s = -np.inf
        self.missing = 0
        self.repeated = 0

    def read(self, sample: TrackerSample) -> np.ndarray | None:
        """Pose of a sample, None where the marker was not seen.

        Raises
        ------
        InputError
            If its time stamp is not later than the last one's, is later than its arrival, or its pose is not
            rigid. The reader then stays as it was.
        """
        if not np.isfinite([sample.time_s, sample.exposure_s]).all():
            raise InputError(f"time stamp: expected finite s, got {sample.exposure_s}, {sample.time_s}")
        if sample.exposure_s <= self.exposure_s:
            raise InputError(
                f"time stamp: expected one after {self.exposure_s:.6f} s, got {sample.exposure_s:.6f} s: "
                f"samples are out of order or repeated"
            )
        if sample.exposure_s > sample.time_s:
            raise InputError(
                f"time stamp: expected one before the arrival at {sample.time_s:.6f} s, "
                f"got {sample.exposure_s:.6f} s"
            )
        pose = None if sample.pose is None else checked_transform("sample", sample.pose)
        self.exposure_s = sample.exposure_s
        if pose is None:
            self.missing += 1
            return None
        again = self.pose is not None and np.array_equal(pose, self.pose)
        self.repeated = self.repeated + 1 if again else 0
        self.missing = 0
        self.pose = pose
        return pose


def _checked(name: str, intervals: Intervals) -> list[tuple[float, float]]:
    out = []
    for interval in intervals:
        pair = np.array(interval, dtype=float)
        if pair.shape != (2,) or not np.isfinite(pair).all() or pair[1] < pair[0]:
            raise InputError(f"{name}: expected intervals (from, to) in s, got {interval!r}")
        out.append((float(pair[0]), float(pair[1])))
    return out


def _inside(time: float, intervals: list[tuple[float, float]]) -> bool:
    return any(begin <= time <= end for begin, end in intervals)
