"""How long margins to be removed take once registrations are drawn, exact beside the printed loop.
loop.

Run with ``python benchmarks/removal.py [case folders] [--registrations 5000]``. Without folders the real
kidneys are used when they are there, else the procedural ones. Registrations (as many each to rank on, to
stop on and to validate on) are drawn before the clock starts; `benchmarks/surface_registration.py` says how
long that takes.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from pathlib import Path

import pandas as pd

from study.errors import PaddedVolumeWarning
from study.experiments.kidney_draws import RememberedRegistrations
from study.margins import SHAPES, GrowthSettings, grow_margin
from study.prepare import warm_margins
from study.registration import SurfaceRegistration
from study.specimens import kidney_case, kidney_catalogue, read_kidney_case

ROOT = Path(__file__).parents[1]
REAL = Path(os.environ.get("STUDY_REAL_DATA", ROOT.parent / "shared" / "real")) / "kidney"
REPEATS = 3


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="*", type=Path)
    parser.add_argument("--registrations", type=int, default=5000)
    asked = parser.parse_args()
    folders = asked.folders or sorted(path.parent for path in REAL.glob("*/case.json"))
    cases = [read_kidney_case(f) for f in folders] or [kidney_case(name) for name in kidney_catalogue()]
    warnings.simplefilter("ignore", PaddedVolumeWarning)
    warm_margins()
    number = asked.registrations
    rows = []
    for case in cases:
        for rule, make in (("loose", SurfaceRegistration.published), ("converged", SurfaceRegistration)):
            model = RememberedRegistrations(make(case.surface, case.swab))
            for shape in SHAPES:
                for method in ("exact", "published"):
                    settings = GrowthSettings.for_removal(
                        method,
                        registrations=number,
                        validation_registrations=number,
                        violation_registrations=number,
                    )
                    best = float("inf")
                    for _ in range(REPEATS + 1):
                        begun, drawing = time.perf_counter(), model.seconds
                        margin = grow_margin(
                            case.anatomy,
                            "tumour",
                            model,
                            shape=shape,
                            settings=settings,
                            rng=0,
                            purpose="remove",
                        )
                        best = min(best, time.perf_counter() - begun - (model.seconds - drawing))
                    rows.append(
                        {
                            "kidney": case.name,
                            "ICP": rule,
                            "shape": shape,
                            "method": method,
                            "seconds": best,
                            "margin_mm3": margin.volume_mm3,
                            "risk_at_stop": margin.damage_risk,
                            "validated_risk": margin.validation.risk,
                        }
                    )
                    print(pd.DataFrame(rows[-1:]).to_string(index=False, header=len(rows) == 1), flush=True)
    table = pd.DataFrame(rows)
    seconds = table.pivot_table(index=["shape", "ICP"], columns="method", values="seconds", aggfunc="max")
    seconds["printed loop / exact"] = seconds["published"] / seconds["exact"]
    print(f"\nslowest of {len(cases)} kidneys, seconds, {number} registrations a set:")
    print(seconds.round(2).to_string())


if __name__ == "__main__":
    main()
