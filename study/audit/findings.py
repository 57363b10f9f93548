"""A finding about the printed numbers: what was stated when it was found, what the tables give now."""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation

import pandas as pd

from study import published
from study.errors import InputError


@dataclass(frozen=True)
class Check:
    """One number (or yes/no) of a finding.

    Attributes
    ----------
    what : str
        What was counted or computed, with its unit.
    stated : str
        The value stated for the finding, with the digits given there; ``"yes"`` or ``"no"`` for a plain fact.
    found : float or bool
        The value recomputed from the tables.
    """

    what: str
    stated: str
    found: float | bool

    def __post_init__(self) -> None:
        if self.stated not in ("yes", "no"):
            printed_step(self.stated)
        elif not isinstance(self.found, bool):
            raise InputError(
                f"check {self.what!r} states {self.stated!r}, so a bool is needed, got {self.found!r}"
            )

    @property
    def agrees(self) -> bool:
        """Whether `found`, rounded to the digits of `stated`, is `stated`."""
        if self.stated in ("yes", "no"):
            return self.found == (self.stated == "yes")
        return rounds_to(float(self.found), self.stated)


@dataclass(frozen=True)
class Finding:
    """A finding with its checks and the rows it rests on.

    Attributes
    ----------
    id : str
        Number in ``data/published/findings.csv``.
    checks : tuple of Check
        What was recomputed; the finding is confirmed if all agree.
    evidence : pandas.DataFrame
        Rows a reader may look at.
    remark : str
        What the recomputation adds, or cannot show.
    """

    id: str
    checks: tuple[Check, ...]
    evidence: pd.DataFrame = field(default_factory=pd.DataFrame, repr=False, compare=False)
    remark: str = ""

    @property
    def statement(self) -> str:
        """The finding in words."""
        known = published.findings().set_index("id")["statement"]
        if self.id not in known.index:
            raise InputError(f"no finding {self.id!r}; there are: {', '.join(known.index)}")
        return str(known[self.id])

    @property
    def confirmed(self) -> str:
        """``"yes"``, ``"partly"`` or ``"no"``: whether all, some or none of the checks agree."""
        agreeing = sum(check.agrees for check in self.checks)
        return "yes" if agreeing == len(self.checks) else "partly" if agreeing else "no"

    def table(self) -> pd.DataFrame:
        """Return a row per check: ``what, stated, recomputed, agrees``."""
        rows = [(c.what, c.stated, shown(c.found), "yes" if c.agrees else "no") for c in self.checks]
        return pd.DataFrame(rows, columns=["what", "stated", "recomputed", "agrees"])


def findings_table(findings: list[Finding]) -> pd.DataFrame:
    """Return a row per finding: ``id, statement, recomputed, confirmed, differs, remark``."""
    rows = []
    for finding in findings:
        values = "; ".join(f"{c.what}: {shown(c.found)}" for c in finding.checks)
        differs = "; ".join(
            f"{c.what}: {shown(c.found)}, stated {c.stated}" for c in finding.checks if not c.agrees
        )
        rows.append((finding.id, finding.statement, values, finding.confirmed, differs, finding.remark))
    return pd.DataFrame(rows, columns=["id", "statement", "recomputed", "confirmed", "differs", "remark"])


def shown(value: float | bool) -> str:
    """Return a recomputed value as text: yes or no, others to five significant digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.0f}" if float(value).is_integer() and abs(value) < 1e9 else f"{value:.5g}"


def printed_step(text: str) -> float:
    """Return the value of the last printed digit: 0.01 for ``"3.15"``, 1e-5 for ``"1.8e-4"``.

    Raises
    ------
    InputError
        If the text is no number.
    """
    try:
        return float(Decimal(1).scaleb(int(Decimal(text).as_tuple().exponent)))
    except (InvalidOperation, TypeError, ValueError) as error:
        raise InputError(f"expected a printed number, got {text!r}") from error


def rounds_to(value: float, text: str) -> bool:
    """Return whether a value, rounded either way at a tie, is the printed number."""
    step = printed_step(text)
    return abs(value - float(text)) <= step / 2 * (1 + 1e-9)
