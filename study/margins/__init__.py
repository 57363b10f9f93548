"""Safety margins: tissue that registration error puts at risk (Siebold, chapters 3 and 4)."""

from study.margins.growth import grow_margin
from study.margins.margin import SafetyMargin
from study.margins.order_statistics import allowed_hits, least_registrations
from study.margins.overall_risk import RiskEstimate
from study.margins.reduced_target import reduced_target
from study.margins.settings import (
    ACCEPTABLE_RISKS,
    DECAY_STARTS,
    PURPOSES,
    REMOVAL_RISK,
    SHAPES,
    GrowthSettings,
)
from study.margins.union import union_of_margins

__all__ = [
    "ACCEPTABLE_RISKS",
    "DECAY_STARTS",
    "PURPOSES",
    "REMOVAL_RISK",
    "SHAPES",
    "GrowthSettings",
    "RiskEstimate",
    "SafetyMargin",
    "allowed_hits",
    "grow_margin",
    "least_registrations",
    "reduced_target",
    "union_of_margins",
]
