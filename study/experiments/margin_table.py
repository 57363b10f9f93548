"""Table 3.2 of Siebold: margins of five structures in several bones, at two voxel sizes, in two shapes.

A row is one margin. Shapes go by the letters of the printed table's file: SV, spatially varying; UT,
uniformly thick (constant thickness).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from study import published
from study.cases import load_case
from study.errors import InputError
from study.experiments.appendix import over_specimens, select_specimens
from study.experiments.equal_risk import equal_risk_ratio
from study.experiments.margin_survey import at_voxel_size, reason_to_skip
from study.margins import ACCEPTABLE_RISKS, GrowthSettings, SafetyMargin, grow_margin
from study.margins.published import shell_of
from study.margins.region import Region
from study.paths import PROJECT
from study.prepare import warm_margins
from study.registration import PointRegistration
from study.specimens import structure_mask
from study.tables import t_interval
from study.volumes import LabelVolume

#: Letters of the printed table and what `grow_margin` calls the shape.
VARIANTS = {"SV": "spatially_varying", "UT": "constant_thickness"}

#: Printed quantities, as the columns of Table 3.2 are called without their ending.
QUANTITIES = (
    "safety_margin_volume_mm3",
    "final_damage_probability",
    "mahalanobis_mean",
    "mahalanobis_std",
)


@dataclass(frozen=True, eq=False)
class MarginTable:
    """Margins of several bones.

    Attributes
    ----------
    rows : DataFrame
        See `margin_row`; ``specimen, structure, variant, voxel_size_mm`` say which margin;
        ``first_layer_mm3`` and ``sv_over_ut_at_equal_risk`` belong to both shapes (see the functions).
    skipped : DataFrame
        ``specimen, structure, reason``: structures that got no margin at any voxel size.
    curves : dict
        ``(structure, variant, voxel_size_mm)`` to `SafetyMargin.curve`, of the first bone.
    """

    rows: pd.DataFrame
    skipped: pd.DataFrame
    curves: dict[tuple[str, str, float], pd.DataFrame]


def select_bones(specimens: str) -> list[str]:
    """What a notebook's parameter asks for, each of it something `study.cases.load_case` takes.

    Parameters
    ----------
    specimens : str
        A folder of a bone or one that holds such folders; else as of
        `study.experiments.appendix.select_specimens`.

    Raises
    ------
    InputError
        If the folder holds no bone, or a name is none of the catalogue.
    """
    text = str(specimens).strip()
    folder = next((p for p in (Path(text), PROJECT / text) if text and p.is_dir()), None)
    if folder is None:
        return select_specimens(text)
    found = [str(f) for f in (folder, *sorted(folder.iterdir())) if f.is_dir() and _holds_labels(f)]
    if not found:
        raise InputError(f"{folder}: expected a folder of a segmented bone, or of several, found no labels")
    return found


def _holds_labels(folder: Path) -> bool:
    return any(folder.glob("*.nrrd")) or any(folder.glob("*.nii*"))


def margin_row(margin: SafetyMargin) -> dict[str, object]:
    """One margin in the columns of Table 3.2 and some that say how good it is.

    Returns
    -------
    dict
        The printed quantities (`QUANTITIES`); ``validated_risk`` on registrations not used before;
        ``mean_point_risk`` of the final shell; ``risk_one_voxel_less``, what the in-sample risk would be
        without the last voxel (exact method, else NaN); ``structure_mm3``; ``edge_share`` of the
        structure's surface; ``time_s``, validation included.
    """
    values = margin.summary()
    curve = margin.curve()
    before = curve.loc[curve["margin_voxels"] < margin.voxels, "risk"]
    exact = margin.settings.method == "exact" and len(before)
    return {
        **{name: values[name] for name in QUANTITIES},
        "acceptable_risk": margin.acceptable_risk,
        "registrations": margin.settings.registrations,
        "validated_risk": values.get("validation_risk", np.nan),
        "validated_low": values.get("validation_low", np.nan),
        "mean_point_risk": float(margin.shell_point_risks.mean()),
        "risk_one_voxel_less": float(before.iloc[-1]) if exact else np.nan,
        "structure_mm3": np.count_nonzero(margin.structure_mask) * margin.volume.voxel_volume,
        "edge_share": margin.edge_share,
        "time_s": margin.time_s,
    }


def first_layer_mm3(mask: np.ndarray, volume: LabelVolume) -> float:
    """mm^3 of the voxels that touch a structure; a margin needs them all, for their corners lie on it."""
    return np.count_nonzero(shell_of(Region.around(mask, volume, 0.0).solid)) * volume.voxel_volume


def _margins_of(
    name: str, voxel_sizes: Sequence[float], structures: Sequence[str], settings: GrowthSettings, seed: int
) -> tuple[list[dict], list[dict], dict]:
    case = load_case(name)
    skipped = [
        {"specimen": case.name, "structure": structure, "reason": reason}
        for structure in structures
        if (reason := reason_to_skip(case, structure))
    ]
    if case.fiducials is None:
        raise InputError(f"{case.name}: expected a bone with fiducials")
    model = PointRegistration(case.fiducials)
    left_out = {entry["structure"] for entry in skipped}
    rng = [seed, zlib.crc32(case.name.encode())]  # a bone's own, whichever others are asked for
    rows, curves = [], {}
    for size in voxel_sizes:
        volume = None if len(left_out) == len(structures) else at_voxel_size(case.anatomy, size)
        for structure in (s for s in structures if s not in left_out):
            mask = structure_mask(volume, structure)
            for variant, shape in VARIANTS.items():
                margin = grow_margin(
                    volume, mask, model, shape=shape, settings=settings, rng=rng, name=structure
                )
                curves[structure, variant, size] = margin.curve()
                which = {"specimen": case.name, "structure": structure, "variant": variant}
                rows.append({**which, "voxel_size_mm": size, **margin_row(margin)})
            ratio = float("nan")
            if settings.method == "exact":
                pair = [curves[structure, variant, size] for variant in VARIANTS]
                ratio = equal_risk_ratio(*pair, ACCEPTABLE_RISKS[structure])
            layer = first_layer_mm3(mask, volume)
            for row in rows[-len(VARIANTS) :]:
                row |= {"first_layer_mm3": layer, "sv_over_ut_at_equal_risk": ratio}
    return rows, skipped, curves


def _one_bone(name: str, settings: GrowthSettings, **given) -> tuple[list[dict], list[dict], dict]:
    warm_margins()  # so that no loading of kernels is in the times
    try:
        return _margins_of(name, settings=settings, **given)
    except Exception as error:  # which of many it was is lost otherwise
        error.add_note(f"margins of {name}")
        raise


def run_margin_table(
    bones: Sequence[str],
    voxel_sizes: Iterable[float] = (0.4, 0.2),
    settings: GrowthSettings | None = None,
    structures: Sequence[str] = tuple(ACCEPTABLE_RISKS),
    seed: int = 0,
    workers: int = 1,
) -> MarginTable:
    """Grow the margins of Table 3.2.

    Parameters
    ----------
    bones : sequence of str
        Each as of `study.cases.load_case`, with anatomy and fiducials.
    voxel_sizes : iterable of float
        mm, see `at_voxel_size`.
    settings : GrowthSettings, optional
    structures : sequence of str
        Of `study.margins.ACCEPTABLE_RISKS`.
    seed : int
        The registrations drawn for a bone follow from it and the bone's name, and are the same for all its
        margins, so that shapes and voxel sizes are compared on the same luck.
    workers : int
        Processes. A margin uses the machine's cores by itself, so more than one gains little.

    Returns
    -------
    MarginTable

    Raises
    ------
    InputError
        If there is no bone, a structure has no printed risk, or a bone has no fiducials.
    """
    unknown = sorted(set(structures) - set(ACCEPTABLE_RISKS))
    if not bones or unknown:
        raise InputError(
            f"bones, structures: expected at least one bone and structures of {sorted(ACCEPTABLE_RISKS)}, "
            f"got {list(bones)} and {unknown or list(structures)}"
        )
    one = partial(
        _one_bone,
        settings=settings or GrowthSettings(),
        voxel_sizes=tuple(voxel_sizes),
        structures=tuple(structures),
        seed=seed,
    )
    found = over_specimens(one, list(bones), workers)
    rows = pd.DataFrame([row for part, _, _ in found for row in part])
    skipped = pd.DataFrame(
        [entry for _, part, _ in found for entry in part], columns=["specimen", "structure", "reason"]
    )
    return MarginTable(rows, skipped, found[0][2])


def printed_table() -> pd.DataFrame:
    """Table 3.2 in long form: ``structure, variant, voxel_size_mm, quantity, printed, printed_plus_minus``.

    The ± of this table are Student-t intervals of five bones (finding C1).
    """
    table = published.table("3.2")
    which = ["structure", "variant", "voxel_size_mm"]
    parts = [
        table[which].assign(
            quantity=name, printed=table[f"{name}_mean"], printed_plus_minus=table[f"{name}_plus_minus"]
        )
        for name in QUANTITIES
    ]
    return pd.concat(parts, ignore_index=True)


def measured_table(rows: pd.DataFrame, confidence: float = 0.95) -> pd.DataFrame:
    """Means over the bones with their Student-t intervals, a row for each that `printed_table` has.

    Returns
    -------
    DataFrame
        Columns of `printed_table`, then ``measured, measured_plus_minus`` (NaN for a single bone) and ``n``.
    """
    which = ["structure", "variant", "voxel_size_mm"]
    table = printed_table()
    groups = dict(list(rows.groupby(which))) if len(rows) else {}
    means, halves, counts = [], [], []
    for entry in table.itertuples():
        group = groups.get((entry.structure, entry.variant, entry.voxel_size_mm))
        values = [] if group is None else group[entry.quantity].to_numpy()
        counts.append(len(values))
        means.append(np.mean(values) if len(values) else np.nan)
        halves.append(t_interval(values, confidence).half_width if len(values) > 1 else np.nan)
    return table.assign(measured=means, measured_plus_minus=halves, n=counts)


def structures_table(rows: pd.DataFrame) -> pd.DataFrame:
    """What the margins were grown around: mm^3 of each structure, and the share of its surface at the edge.

    Returns
    -------
    DataFrame
        A row a structure and voxel size: mean and range of the volume over the bones, ``n`` of them, and the
        largest ``edge_share_pct``, per cent of a structure's surface that is only the edge of the image.
    """
    rows = rows[rows["variant"] == "SV"]
    groups = rows.groupby(["structure", "voxel_size_mm"], sort=False)
    return groups.agg(
        n=("structure_mm3", "size"),
        mean_mm3=("structure_mm3", "mean"),
        least_mm3=("structure_mm3", "min"),
        most_mm3=("structure_mm3", "max"),
        edge_share_pct=("edge_share", lambda share: 100 * share.max()),
    )


def times_table(rows: pd.DataFrame, confidence: float = 0.95) -> pd.DataFrame:
    """Minutes a bone for all its structures, printed beside measured (last row of Table 3.2).

    Ours hold the validation.
    """
    spent = rows.groupby(["variant", "voxel_size_mm", "specimen"])["time_s"].sum() / 60
    table = published.table("3.2 time")
    table = table.rename(
        columns={"time_min_mean": "printed_min", "time_min_plus_minus": "printed_plus_minus"}
    )
    measured = [
        spent.get((entry.variant, entry.voxel_size_mm), pd.Series(dtype=float)).to_numpy()
        for entry in table.itertuples()
    ]
    table["measured_min"] = [values.mean() if len(values) else np.nan for values in measured]
    table["measured_plus_minus"] = [
        t_interval(values, confidence).half_width if len(values) > 1 else np.nan for values in measured
    ]
    table["printed_over_measured"] = table["printed_min"] / table["measured_min"]
    return table


def beside_each_other(table: pd.DataFrame) -> pd.DataFrame:
    """`measured_table` laid out as the printed one, each entry as text, printed over ours."""

    def text(mean: float, half: float, probability: bool) -> str:
        if np.isnan(mean):
            return "–"
        plus = "" if np.isnan(half) else f" ± {half:.2g}" if probability else f" ± {half:.2f}"
        return (f"{mean:.2g}" if probability else f"{mean:.2f}") + plus

    out = {}
    for entry in table.itertuples():
        risk = entry.quantity == "final_damage_probability"
        row = (entry.structure, entry.quantity)
        column = f"{entry.variant} {entry.voxel_size_mm:g} mm"
        out.setdefault((*row, "printed"), {})[column] = text(entry.printed, entry.printed_plus_minus, risk)
        out.setdefault((*row, "ours"), {})[column] = text(entry.measured, entry.measured_plus_minus, risk)
    frame = pd.DataFrame.from_dict(out, orient="index")
    frame.index = pd.MultiIndex.from_tuples(frame.index, names=["structure", "quantity", ""])
    order = list(ACCEPTABLE_RISKS)
    keys = sorted(frame.index, key=lambda k: (order.index(k[0]), QUANTITIES.index(k[1]), k[2] != "printed"))
    return frame.loc[keys]
