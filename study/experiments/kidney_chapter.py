"""The margins of one kidney: what chapter 4 of Siebold is read along with."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from scipy import ndimage

from study.errors import MarginError, PaddedVolumeWarning
from study.experiments.kidney_draws import RememberedRegistrations
from study.margins import PURPOSES, GrowthSettings, SafetyMargin, grow_margin, union_of_margins
from study.registration import ErrorSource, SurfaceRegistration
from study.specimens import KidneyCase

#: What is grown for each stopping rule: method and shape of `grow_margin`.
GROWTHS = {
    "published growth": ("published", "spatially_varying"),
    "exact, spatially varying": ("exact", "spatially_varying"),
    "exact, constant thickness": ("exact", "constant_thickness"),
}
#: How often they are counted at most before a step of the published growth takes what it has.
_MOST_BATCHES = 2
#: Risks that are tried when nothing is left to stay inside of.
LARGER_RISKS = (0.02, 0.05, 0.1, 0.2)


def removal_settings(registrations: int, method: str = "exact", validated: bool = True) -> GrowthSettings:
    """Settings of chapter 4 with another number of registrations: to rank, to grow on, to validate on."""
    return GrowthSettings.for_removal(
        method,
        registrations=registrations,
        violation_registrations=registrations,
        most_batches=_MOST_BATCHES,
        validation_registrations=registrations if validated else 0,
    )


def grow_all(
    case: KidneyCase,
    model: RememberedRegistrations,
    acceptable_risk: float,
    registrations: int,
    seed: int = 0,
) -> dict[str, SafetyMargin]:
    """Margins to remove a tumour with, by every one of `GROWTHS`, on the same registrations.

    Parameters
    ----------
    case : KidneyCase
    model : RememberedRegistrations
    acceptable_risk : float
    registrations : int
        To grow on, and as many fresh ones for validation.
    seed : int
    """
    grown = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PaddedVolumeWarning)  # the table says so
        for name, (method, shape) in GROWTHS.items():
            settings = removal_settings(registrations, method)
            grown[name] = grow_margin(
                case.anatomy, "tumour", model, acceptable_risk, shape, settings, seed, purpose="remove"
            )
    return grown


def removal_table(groups: Mapping[str, Mapping[str, SafetyMargin]], case: KidneyCase) -> pd.DataFrame:
    """One row a margin: how much it takes, what it promises and what it keeps.

    Parameters
    ----------
    groups : mapping of str to mapping of str to SafetyMargin
        Stopping rule, then growth.
    case : KidneyCase

    Returns
    -------
    DataFrame
        Indexed by fit and growth. ``margin_mm3``; ``healthy_kidney_mm3`` of it; ``thickest_mm`` from the
        tumour; ``risk_at_stop`` on the registrations that growth stopped on; ``validated_risk`` on fresh
        ones with its 95 % interval; ``beyond_image``: the margin needed room beyond it.
    """
    rows = {}
    for fit, margins in groups.items():
        for growth, margin in margins.items():
            low, high = margin.validation.interval if margin.validation else (np.nan, np.nan)
            rows[fit, growth] = {
                "margin_mm3": margin.volume_mm3,
                "healthy_kidney_mm3": float(
                    np.count_nonzero(margin.mask & margin.volume.mask("kidney")) * margin.volume.voxel_volume
                ),
                "thickest_mm": thickest(margin),
                "risk_at_stop": margin.damage_risk,
                "validated_risk": margin.validation.risk if margin.validation else np.nan,
                "validated_low": low,
                "validated_high": high,
                "beyond_image": margin.volume.shape != case.anatomy.shape,
            }
    table = pd.DataFrame.from_dict(rows, orient="index")
    table.index = pd.MultiIndex.from_tuples(list(rows), names=["fit", "growth"])
    return table


def thickest(margin: SafetyMargin) -> float:
    """Largest distance from a voxel of a margin to the structure's nearest voxel, mm."""
    if not margin.voxels:
        return 0.0
    away = ndimage.distance_transform_edt(~margin.structure_mask, sampling=margin.volume.spacing)
    return float(away[margin.mask].max())


def growth_words(table: pd.DataFrame, acceptable_risk: float, registrations: int) -> str:
    """What a table of margins says, in words that follow from its numbers (Markdown).

    Parameters
    ----------
    table : DataFrame
        Of `removal_table`.
    acceptable_risk : float
    registrations : int
        On which each margin was grown.
    """
    text = [f"Each margin was grown on {registrations} registrations and looked at on as many fresh ones."]
    for fit, rows in table.groupby(level="fit", sort=False):
        rows = rows.droplevel("fit")
        printed = rows.loc["published growth"]
        exact = rows.drop(index="published growth")
        said = (
            f"*{fit}*: published growth stops at a risk of {printed['risk_at_stop']:.3g} and does damage in "
            f"{printed['validated_risk']:.3g} of fresh registrations ({printed['validated_low']:.3g} to "
            f"{printed['validated_high']:.3g})"
        )
        if printed["validated_low"] > acceptable_risk:
            said += f": **more than the accepted {acceptable_risk:g}, beyond chance**"
        elif printed["validated_risk"] > acceptable_risk:
            said += f": more than the accepted {acceptable_risk:g}, though that many may be chance"
        else:
            said += f", within the accepted {acceptable_risk:g}"
        above = exact.index[exact["validated_low"] > acceptable_risk].tolist()
        said += (
            f". Of the exact margins {' and '.join(above)} exceed it too"
            if above
            else ". The exact margins keep what they promise, as far as these registrations can tell"
        )
        sizes = exact["margin_mm3"]
        if (sizes > 0).all():
            said += (
                f"; spatially varying takes {sizes.iloc[0]:.0f} mm³, "
                f"{sizes.iloc[0] / sizes.iloc[1]:.2f} times what constant thickness takes"
            )
        text.append(said + ".")
    first, last = (
        table.xs("exact, spatially varying", level="growth")["margin_mm3"].iloc[k] for k in (0, -1)
    )
    fits = table.index.unique("fit")
    if len(fits) > 1:
        text.append(
            f"The same tumour and swab: {first:.0f} mm³ *{fits[0]}*, {last:.0f} mm³ *{fits[-1]}*"
            + (
                "."
                if last > 0
                else ", no margin at all: no boundary voxel's centre leaves its voxel that often."
            )
        )
    return "\n\n".join(text)


def grow_inside(
    case: KidneyCase,
    model: ErrorSource,
    acceptable_risk: float,
    registrations: int,
    seed: int = 0,
) -> SafetyMargin:
    """The rim of a tumour to stay clear of, at the first of a few risks that leaves anything inside.

    Parameters
    ----------
    case : KidneyCase
    model : ErrorSource
    acceptable_risk : float
        Tried first, then `LARGER_RISKS`.
    registrations : int
    seed : int

    Raises
    ------
    MarginError
        If nothing is left at any of them.
    """
    settings = removal_settings(registrations)
    risks = [acceptable_risk, *(risk for risk in LARGER_RISKS if risk > acceptable_risk)]
    for risk in risks:
        try:
            return grow_margin(
                case.anatomy, "tumour", model, risk, settings=settings, rng=seed, purpose="stay_inside"
            )
        except MarginError:
            if risk == risks[-1]:
                raise
    raise AssertionError  # there is one risk at least


def grow_for_purposes(
    case: KidneyCase,
    model: ErrorSource,
    acceptable_risk: float,
    registrations: int,
    seed: int = 0,
    purposes: Sequence[str] = PURPOSES,
) -> dict[str, SafetyMargin]:
    """Margins of a tumour that is to be removed, spared, or stayed inside of, by the exact method.

    Parameters
    ----------
    case : KidneyCase
    model : ErrorSource
        To protect, one whose errors are about normal: `grow_margin` ranks by their covariance then.
    acceptable_risk : float
        To stay inside, the least that is tried; see `grow_inside`.
    registrations : int
    seed : int
    purposes : sequence of str
        Of `study.margins.PURPOSES`.
    """
    settings = removal_settings(registrations)
    grown = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PaddedVolumeWarning)
        for purpose in purposes:
            if purpose == "stay_inside":
                grown[purpose] = grow_inside(case, model, acceptable_risk, registrations, seed)
            else:
                grown[purpose] = grow_margin(
                    case.anatomy,
                    "tumour",
                    model,
                    acceptable_risk,
                    settings=settings,
                    rng=seed,
                    purpose=purpose,
                )
    return grown


def purposes_table(groups: Mapping[str, Mapping[str, SafetyMargin]]) -> pd.DataFrame:
    """One row an error and a purpose: how much is in the margin and how much inside, and at what risk."""
    rows = {}
    for error, margins in groups.items():
        for purpose, margin in margins.items():
            low, high = margin.validation.interval
            rows[error, purpose] = {
                "acceptable_risk": margin.acceptable_risk,
                "margin_mm3": margin.volume_mm3,
                "inside_mm3": float(np.count_nonzero(margin.inside) * margin.volume.voxel_volume),
                "validated_risk": margin.validation.risk,
                "validated_low": low,
                "validated_high": high,
            }
    table = pd.DataFrame.from_dict(rows, orient="index")
    table.index = pd.MultiIndex.from_tuples(list(rows), names=["error", "to"])
    return table


def purposes_words(table: pd.DataFrame, acceptable_risk: float) -> str:
    """What `purposes_table` says (Markdown)."""
    text = []
    for error, rows in table.groupby(level="error", sort=False):
        rows = rows.droplevel("error")
        said = f"*{error}*: "
        if {"remove", "protect"} <= set(rows.index):
            removed, spared = rows.loc["remove"], rows.loc["protect"]
            said += (
                f"to protect takes {spared['margin_mm3']:.0f} mm³ around the tumour where to remove takes "
                f"{removed['margin_mm3']:.0f} mm³. "
            )
        if "stay_inside" in rows.index:
            inside = rows.loc["stay_inside"]
            whole = inside["inside_mm3"] + inside["margin_mm3"]
            said += (
                f"Of the tumour's {whole:.0f} mm³, {inside['inside_mm3']:.0f} mm³ "
                f"({inside['inside_mm3'] / whole:.0%}) land in it, all together, in at least "
                f"{1 - inside['acceptable_risk']:.0%} of registrations."
            )
            if inside["acceptable_risk"] > acceptable_risk:
                said += f" Of what shall do so in all but {acceptable_risk:g} of them nothing would be left."
        text.append(said)
    return "\n\n".join(text)


def grow_for_tracings(
    case: KidneyCase,
    model: SurfaceRegistration,
    tracings: int,
    acceptable_risk: float,
    registrations: int,
    seed: int = 0,
) -> list[SafetyMargin]:
    """A margin for each of several sampled tracings of the patch, whose digitiser errors stay what they are.

    Parameters
    ----------
    case : KidneyCase
    model : SurfaceRegistration
        Says how far a digitiser errs.
    tracings : int
    acceptable_risk : float
        Of each margin.
    registrations : int
        To grow each margin on.
    seed : int

    See Also
    --------
    study.margins.union_of_margins
    """
    settings = removal_settings(registrations, validated=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PaddedVolumeWarning)
        return [
            grow_margin(
                case.anatomy, "tumour", RememberedRegistrations(traced), acceptable_risk,
                settings=settings, rng=seed, purpose="remove",
            )
            for traced in model.digitised(tracings, seed)
        ]  # fmt: skip


def tracing_table(
    tracings: Sequence[SafetyMargin], drawn: SafetyMargin, registrations: int, seed: int = 0
) -> pd.DataFrame:
    """Margins of single tracings, their union, and the margin that draws a tracing for every registration.

    Parameters
    ----------
    tracings : sequence of SafetyMargin
        Of `grow_for_tracings`.
    drawn : SafetyMargin
        Its model is the one that all are judged on.
    registrations : int
        To judge on: those that `drawn` was validated on, if its seed was the same.
    seed : int

    Returns
    -------
    DataFrame
        ``margin_mm3``, ``risk`` with all errors at once and its 95 % interval.
    """

    def judging() -> np.random.Generator:
        return np.random.default_rng(seed).spawn(2)[1]

    both = union_of_margins(tracings, drawn.model, registrations, judging())
    named = {f"tracing {k}": one for k, one in enumerate(tracings, start=1)}
    named |= {f"union of the {len(tracings)}": both, "every registration its own tracing": drawn}
    rows = {}
    for name, margin in named.items():
        found = margin.risk_on(registrations, judging(), drawn.model)
        low, high = found.interval
        rows[name] = {
            "margin_mm3": margin.volume_mm3, "risk": found.risk, "risk_low": low, "risk_high": high
        }  # fmt: skip
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("margin")


def tracing_words(table: pd.DataFrame, acceptable_risk: float) -> str:
    """What `tracing_table` says (Markdown)."""
    *single, union, drawn = table.index
    one, both, every = table.loc[single], table.loc[union], table.loc[drawn]
    worst = f"{one['risk'].min():.3g}"
    if one["risk"].max() > one["risk"].min():
        worst += f" to {one['risk'].max():.3g}"
    text = (
        f"A margin grown for one tracing does damage in {worst} of registrations once the tracing is drawn "
        f"too, the union in {both['risk']:.3g}, the margin that draws a tracing for every registration in "
        f"{every['risk']:.3g} (accepted: {acceptable_risk:g}). "
    )
    if both["margin_mm3"] <= 0 and every["margin_mm3"] <= 0:
        return text + "None of them needs a voxel: the digitiser's error is lost in the size of a voxel."
    if both["risk_high"] < acceptable_risk and both["margin_mm3"] > every["margin_mm3"]:
        text += (
            f"The union is safer than asked for and pays for it with "
            f"{both['margin_mm3'] / max(every['margin_mm3'], 1e-9):.2f} times the volume; "
        )
    else:
        text += (
            f"The union takes {both['margin_mm3']:.0f} mm³, the margin that draws them "
            f"{every['margin_mm3']:.0f} mm³; "
        )
    text += (
        "and it has no stated risk of its own: each of its margins holds the accepted risk for its own "
        "tracing, all of them together hold less, and the more tracings, the larger the union."
    )
    return text
