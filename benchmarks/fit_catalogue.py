"""Fit the sizes of the catalogued specimens to the printed volumes and write ``data/catalogue.csv``.

``python benchmarks/fit_catalogue.py [names]`` refits all specimens, or those named and keeps the rest.
It takes a few minutes. Side and seed of a specimen follow from its place in the list; only the size is
fitted.
"""

import sys

import pandas as pd

from study import published
from study.files import written_whole
from study.paths import PROJECT
from study.planners.modified import modified_volume
from study.specimens.named_specimens import Entry, build, fit_size

BURR_RADIUS = 2.5
COLUMN = "modified_initial_target_cm3"


def measure(planning):
    return modified_volume(planning, BURR_RADIUS).target_cm3


def main(names):
    printed = published.table("A.1").set_index("specimen")[COLUMN]
    path = PROJECT / "data" / "catalogue.csv"
    kept = pd.read_csv(path).set_index("name") if names else None
    rows = []
    for place, (name, wanted) in enumerate(printed.items()):
        entry = Entry(name, ("right", "left")[place % 2], seed=101 + place, size=1.0)
        if names and name not in names:
            entry = Entry(name, kept.side[name], int(kept.seed[name]), float(kept["size"][name]))
        else:
            entry = fit_size(entry, float(wanted), measure)
        got = measure(build(entry).planning)
        share = got / wanted - 1
        print(
            f"{name} {entry.side} size {entry.size:.5f}: {got:.3f} cm^3, printed {wanted:.2f} ({share:+.2%})"
        )
        rows.append((entry.name, entry.side, entry.seed, entry.size))
    with written_whole(path) as temporary:
        pd.DataFrame(rows, columns=["name", "side", "seed", "size"]).to_csv(temporary, index=False)


if __name__ == "__main__":
    main(sys.argv[1:])
