"""How long Tables B.1 to B.9 take: nine starts, several kidneys, two ways to stop, both shapes.

Run with ``python benchmarks/kidney_margins.py [kidneys] [--registrations 5000] [--starts 9]``; kidneys as of
the notebooks (``all``, how many, names, a folder). With fewer starts the time of all nine is estimated, which
is exact up to what starts differ in. The printed times (44 cores) stand beside ours.
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time

import pandas as pd

from study.experiments.kidney_claims import printed_rows
from study.experiments.kidney_margins import RUNS, TABLES, run_kidney_margins, select_kidneys
from study.prepare import warm_margins
from study.specimens import load_kidney

GOAL_MINUTES = 15.0
"""For four tumours and nine starts, on two cores."""


def main() -> int:
    """Print the times of every start and of all."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("kidneys", nargs="?", default="all")
    parser.add_argument("--registrations", type=int, default=5000)
    parser.add_argument("--validation", type=int, default=1000)
    parser.add_argument("--starts", type=int, default=len(TABLES), help="of the nine, evenly spread")
    given = parser.parse_args()
    warm_margins()
    kidneys = select_kidneys(given.kidneys)
    for name in kidneys:  # surfaces and swabs are no part of a margin
        case = load_kidney(name)
        print(f"{case.name}: {len(case.surface.vertices)} vertices, {len(case.swab)} swab points")
    starts = list(TABLES)[:: -(-len(TABLES) // max(1, min(given.starts, len(TABLES))))]
    rows, begun = [], time.perf_counter()
    for position, rotation in starts:
        clock = time.perf_counter()
        part = run_kidney_margins(
            kidneys, [position], [rotation], tuple(RUNS), given.registrations, given.validation
        ).rows
        rows.append(part)
        print(
            f"Table {TABLES[position, rotation]} ({position:g} mm, {rotation:g} degrees): "
            f"{time.perf_counter() - clock:.1f} s for {len(part)} margins",
            flush=True,
        )
    spent = time.perf_counter() - begun
    rows = pd.concat(rows)
    fits = rows.drop_duplicates(["kidney", "pos_std_mm", "rot_std_deg", "stop"])
    each = fits.groupby("stop").agg(
        registration_s=("registration_s", "mean"), iterations=("iterations_mean", "mean")
    )
    each["growth_s"] = rows.groupby("stop")["growth_s"].mean()
    print("\nSeconds a kidney and start (registrations for all its margins, growth of one margin):")
    print(each.round(2).to_string())
    minutes = spent / 60 * len(TABLES) / len(starts) * 4 / len(kidneys)
    what = "measured" if len(starts) == len(TABLES) and len(kidneys) == 4 else "estimated from these"
    print(
        f"\nAll nine tables for four tumours, {what}: {minutes:.1f} min on {os.cpu_count()} cores "
        f"(goal {GOAL_MINUTES:g} min; load while running {os.getloadavg()[0]:.1f}); "
        f"printed, on 44 cores: {printed_rows()['time_min'].sum() / 60:.0f} h"
    )
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
