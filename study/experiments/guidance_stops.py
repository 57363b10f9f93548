"""What goes wrong in mid-drilling, when the robot stops, and how far off its line the tip is by then."""

from __future__ import annotations

import numpy as np
import pandas as pd

from study.guidance import DrilledHole, Faults, HoleRun, aluminium_block, set_up, system

#: When the fault comes, s: the drill is in the block.
AT_S = 22.0
#: How long a run is watched after that.
_WATCHED_S = 1.5


def faults(at: float = AT_S) -> dict[str, Faults]:
    """Faults by what they are called."""
    long = at + 10.0
    return {
        "drill's marker out of sight": Faults(occluded=[("tool", at, long)]),
        "patient's marker out of sight": Faults(occluded=[("patient", at, long)]),
        "frozen tracker": Faults(frozen=[(at, long)]),
        "silent tracker": Faults(silent=[(at, long)]),
        "one spike of 5 mm": Faults(spikes=[(at, (5.0, 0.0, 0.0))]),
        "patient jumps 3 mm": Faults(patient_moves=[(at, at, (3.0, 0.0, 0.0))]),
        "patient moves 3 mm in 1 s": Faults(patient_moves=[(at, at + 1.0, (3.0, 0.0, 0.0))]),
        "lost handshake": Faults(no_handshake=[(at, long)]),
    }


def stopped_holes(seed: int = 0, name: str = "vanderbilt") -> dict[str, DrilledHole]:
    """The same hole with each fault, as far as it came."""
    found = {}
    for fault, what in faults().items():
        rng = np.random.default_rng(seed)
        ready = set_up(system(name), aluminium_block(), rng)
        run = HoleRun(ready, int(rng.integers(24)), rng, faults=what)
        run.run(until_s=AT_S + _WATCHED_S)
        found[fault] = run.result
    return found


def stops(holes: int = 10, seed: int = 6, name: str = "vanderbilt") -> pd.DataFrame:
    """When and why the robot stops, and how far off its line the tip was at most.

    Returns
    -------
    pandas.DataFrame
        A row a fault: ``fault``, ``holes``, ``reason`` (all that occurred), ``time_to_stop_ms`` (longest),
        ``before_mm`` and ``after_mm``: largest true distance from the line in the 1.5 s before the fault and
        from the fault on, over all holes. A patient's own shift is in the latter.
    """
    rows: dict[str, list[tuple[str, float, float, float]]] = {}
    for k in range(holes):
        for fault, hole in stopped_holes(seed + k, name).items():
            halted = np.flatnonzero(hole.status > 1)
            reason = hole.end.name if len(halted) else "goes on"
            wait = 1000.0 * (hole.time_s[halted[0]] - AT_S) if len(halted) else np.nan
            after = hole.time_s >= AT_S
            before = (hole.time_s >= AT_S - _WATCHED_S) & ~after
            rows.setdefault(fault, []).append(
                (reason, wait, hole.across[before].max(), hole.across[after].max())
            )
    table = []
    for fault, found in rows.items():
        waits = [wait for _, wait, *_ in found if np.isfinite(wait)]
        table.append(
            {
                "fault": fault,
                "holes": len(found),
                "reason": ", ".join(sorted({reason for reason, *_ in found})),
                "time_to_stop_ms": max(waits) if waits else np.nan,
                "before_mm": max(f[2] for f in found),
                "after_mm": max(f[3] for f in found),
            }
        )
    return pd.DataFrame(table)
