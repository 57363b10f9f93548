"""Recompute the feed constant: fit it to the zigzag plans, then predict the 3-D plans' speed.

``python benchmarks/fit_feed.py [specimens]`` takes ``all`` (the default), a number, or names. It prints
the removal rate at which the zigzag plans average the printed speed of table A.1, which belongs in
`study.robots.FeedSettings`, the speed of the 3-D plans at that rate, which is fitted to nothing, and
what other laws between bone and speed would say.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial

import numpy as np

from study import published
from study.experiments.appendix import motion_of, over_specimens, select_specimens
from study.robots import FeedSettings, fit_feed_constant
from study.robots.feed_laws import LAWS
from study.tables import t_interval, with_interval


def main() -> int:
    names = select_specimens(sys.argv[1] if len(sys.argv) > 1 else "all")
    printed = {
        strategy: published.corrected(table)["average_milling_speed_mm_per_s"].mean()
        for strategy, table in (("zigzag", "A.1"), ("3d", "A.2"))
    }
    motions = {strategy: over_specimens(partial(motion_of, strategy=strategy), names) for strategy in printed}
    rate = fit_feed_constant(motions["zigzag"], round(printed["zigzag"], 1))
    default = FeedSettings()
    fitted = replace(default, removal_rate=rate)
    print(
        f"{len(names)} specimens: removal_rate = {rate:.3f} mm^3/s (FeedSettings has {default.removal_rate})"
    )
    for strategy, speed in printed.items():
        speeds = [motion.mean_speed(fitted) for motion in motions[strategy]]
        role = "fitted" if strategy == "zigzag" else "predicted"
        print(f"{strategy}: {with_interval(t_interval(speeds), 'mm/s')} {role}, printed {speed:.2f} mm/s")
    print("\nOther laws, each fitted to the same zigzag speed (study.robots.feed_laws):")
    for name, law in LAWS.items():
        feed = law()
        feed = replace(
            feed, removal_rate=fit_feed_constant(motions["zigzag"], round(printed["zigzag"], 1), feed)
        )
        times = {
            strategy: np.mean([motion.times(feed).sum() for motion in motions[strategy]])
            for strategy in motions
        }
        speed = t_interval([motion.mean_speed(feed) for motion in motions["3d"]])
        print(
            f"{name:13s} 3-D {with_interval(speed, 'mm/s')}, "
            f"3-D time against zigzag {100 * (times['3d'] / times['zigzag'] - 1):+.1f} %"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
