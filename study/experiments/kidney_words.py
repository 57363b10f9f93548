"""What Tables B.1 to B.9 and ours say about the errors of the start, in words made from the numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from study.experiments.kidney_claims import VOLUME, WHICH, exponents_text, law_of, range_text
from study.experiments.kidney_margins import STOPS
from study.experiments.kidney_scaling import ERRORS, PowerLaw, exponents_table

#: Share of the loose scatter below which words call the rest nothing, and above which they call it the same.
_NOTHING, _SAME = 0.1, 0.9


def laws(rows: pd.DataFrame, quantity: str = VOLUME) -> dict[str, PowerLaw]:
    """Power law of each shape that has one."""
    found = {variant: law_of(part, quantity) for variant, part in rows.groupby("variant", sort=False)}
    return {variant: law for variant, law in found.items() if law is not None}


def exponents_of(sources: Mapping[str, pd.DataFrame]) -> pd.DataFrame:
    """Exponents of volume of each source, and of the scatter at each way to stop.

    Parameters
    ----------
    sources : mapping of str to DataFrame
        Print and runs, by what to call them.

    Returns
    -------
    DataFrame
        ``whose`` (of the scatter the way to stop), then the columns of
        `study.experiments.kidney_scaling.exponents_table`; ``variant`` of the scatter is "both".
    """
    volumes = pd.concat([rows.assign(whose=whose) for whose, rows in sources.items()])
    parts = [exponents_table(volumes, by=("whose", "variant"))]
    ours = [rows for rows in sources.values() if "scatter_mm" in rows]
    if ours:
        each = pd.concat(ours).drop_duplicates(["stop", *WHICH])
        each = each.assign(whose=each["stop"].map(STOPS), variant="both")
        parts.append(exponents_table(each, ["scatter_mm"], ("whose", "variant")))
    return pd.concat(parts, ignore_index=True)


def volumes_in_words(whose: str, rows: pd.DataFrame) -> str:
    """How margin volumes go with both errors, and whether the tables can tell that rotation matters."""
    empty = int((rows[VOLUME] == 0).sum())
    found = laws(rows)
    if not found:
        if empty:
            return (
                f"**{whose}**: {empty} of {len(rows)} margins are empty, so that volumes have no exponents."
            )
        return f"**{whose}**: the errors of the start do not vary, so that nothing can be said about them."
    text = f"**{whose}**: the volume goes with the errors of the start to the powers "
    text += "; ".join(f"{exponents_text(law)} ({variant})" for variant, law in found.items()) + "."
    text += _which_matters(found)
    left_out = sorted({name for law in found.values() for name in law.left_out})
    if left_out:
        text += f" Tumours with empty margins are left out ({', '.join(map(str, left_out))})."
    return text


def _which_matters(found: Mapping[str, PowerLaw]) -> str:
    sides = {error: [law.exponents.get(error) for law in found.values()] for error in ERRORS}
    if any(None in exponents for exponents in sides.values()):
        return ""
    shown = {error: [exponent.low > 0 for exponent in exponents] for error, exponents in sides.items()}
    said = {
        (True, True): "shows in both shapes",
        (False, False): "cannot be told from none in either shape",
    }
    texts = []
    for error, name in zip(ERRORS, ("position", "rotation"), strict=True):
        both = tuple(shown[error]) * (2 if len(found) == 1 else 1)
        texts.append(f"the {name} error {said.get(both, 'shows in one shape of two')}")
    larger = [law.difference.low > 0 for law in found.values()]
    order = "more than" if all(larger) else "not surely more than"
    return f" The effect of {texts[0]}, that of {texts[1]}; position counts {order} rotation."


def stopping_in_words(rows: pd.DataFrame) -> str:
    """What letting the fits converge changes: scatter over the tumours, margins, dependence on the start."""
    each = rows.drop_duplicates(["stop", *WHICH])
    scatter = {stop: part.set_index(WHICH)["scatter_mm"] for stop, part in each.groupby("stop")}
    if len(scatter) < 2:
        return "Only one stopping rule was run, so nothing can be said about what it changes."
    ratio = (scatter["converged"] / scatter["loose"]).median()
    text = (
        f"**Stopping**: stopped loosely, registrations scatter by {range_text(scatter['loose'], '.2g')} mm "
        f"(rms over the tumour); converged, by {range_text(scatter['converged'], '.2g')} mm, "
        f"{ratio:.2f} times as much (median over tumours and starts). "
    )
    margins = rows.set_index([*WHICH, "variant"])
    exact = {run: margins.loc[margins["run"] == run, VOLUME] for run in ("loose", "converged")}
    empty = int((exact["converged"] == 0).sum())
    if empty:
        text += f"{empty} of {len(exact['converged'])} converged margins are empty. "
    if len(exact["loose"]):
        change = (exact["converged"] / exact["loose"]).median()
        text += (
            f"By the same method, converged margins have {_percent(change)} of the loose volume (median). "
        )
    return text + _starts_in_words(each) + _verdict(ratio)


def _starts_in_words(each: pd.DataFrame) -> str:
    found = {stop: law_of(part, "scatter_mm") for stop, part in each.groupby("stop")}
    if None in found.values():  # the errors do not vary
        return ""
    text = "The scatter goes with the errors of the start to the powers "
    text += "; ".join(f"{exponents_text(found[stop])} ({title})" for stop, title in STOPS.items()) + ". "
    end = found["converged"].exponents
    if any(np.isnan(exponent.half_width) for exponent in end.values()):
        return text
    names = zip(ERRORS, ("position", "rotation"), strict=True)
    remains = [name for error, name in names if error in end and end[error].low > 0]
    if remains:
        return text + (
            f"So even converged fits still know how wrong they started ({' and '.join(remains)}): they come "
            "to rest in more than one place. "
        )
    return text + "So converged fits cannot be seen to know how wrong they started. "


def _verdict(ratio: float) -> str:
    if ratio < _NOTHING:
        return "What the loose margins pay for is the stopping rule, and next to nothing else."
    if ratio > _SAME:
        return "At these starts the stopping rule makes little difference."
    return (
        f"Of a loose margin's cause, the scatter, {_percent(1 - ratio)} is the stopping rule; the rest stays "
        "when no fit is stopped early."
    )


def _where_print_lies(printed: Mapping[str, PowerLaw], rows: pd.DataFrame) -> list[str]:
    """Between which of our exponents of the position error the printed ones are."""
    of_run = {run: laws(part) for run, part in rows.groupby("run")}
    # the growth of the text's run is the printed one
    loose = of_run.get("published") or of_run.get("loose") or {}
    error, texts = ERRORS[0], []
    for variant, law in printed.items():
        ends = [side.get(variant) for side in (of_run.get("converged") or {}, loose)]
        if any(end is None or error not in end.exponents for end in ends):
            continue
        low, high = (end.exponents[error].mean for end in ends)
        value = law.exponents[error].mean
        place = "below both" if value < min(low, high) else "above both"
        if min(low, high) <= value <= max(low, high):
            place = "between them"
        texts.append(f"{variant} {value:.2f}, {place} ({low:.2f} converged, {high:.2f} loose)")
    if not texts:
        return []
    return ["**Where print lies** by the exponent of the position error: " + "; ".join(texts) + "."]


def _percent(share: float) -> str:
    return "–" if np.isnan(share) else f"{100 * share:.0f} %"


def conclusion(rows: pd.DataFrame, printed: pd.DataFrame, titles: Mapping[str, str]) -> str:
    """The final page in words (Markdown): print, ours run by run, and what stopping changes.

    Parameters
    ----------
    rows : DataFrame
        Of `study.experiments.kidney_margins.run_kidney_margins`.
    printed : DataFrame
        Of `study.experiments.kidney_claims.printed_rows`.
    titles : mapping of str to str
        Runs and what to call them.
    """
    texts = [volumes_in_words("Print", printed)]
    texts += [
        volumes_in_words(f"Ours, {title}", rows[rows["run"] == run])
        for run, title in titles.items()
        if (rows["run"] == run).any()
    ]
    texts.append(stopping_in_words(rows))
    texts += _where_print_lies(laws(printed), rows)
    return "\n\n".join(texts)
