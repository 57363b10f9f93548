"""Recomputation of every finding about the printed tables (``data/published/findings.csv``).

One function a finding; each returns a `Finding` that holds the stated numbers, the recomputed ones and the
rows they come from. ``notebooks/published_audit.ipynb`` shows them in order.
"""

from study.audit import baron, chapter2, chapter2_claims, chapter2_confirmed, chapter3, chapter4
from study.audit.chapter2 import corrected_intervals
from study.audit.findings import Check, Finding, findings_table

FINDINGS = (
    chapter2.tables_fit_together,
    chapter2.intervals_are_scaled_means,
    chapter2.lengths_are_centimetres,
    chapter2.milled_intervals_have_one_multiple,
    chapter2.last_cadaver_rows_differ,
    chapter2_claims.speed_is_not_derivable,
    chapter2_claims.contact_columns_disagree,
    chapter2_claims.faster_zigzag_leaves_bone,
    chapter2_claims.simulation_time_is_milling_time,
    chapter2_claims.slopes_compare_other_bones,
    chapter2_claims.paths_of_other_targets,
    chapter2_claims.more_freedom_leaves_more,
    chapter2_claims.averages_hide_bones,
    chapter2_claims.percent_difference_is_symmetric,
    chapter2_claims.boundary_connectivity_differs,
    chapter2_confirmed.summary_table_repeats_appendix,
    chapter2_confirmed.ratio_is_length_over_volume,
    chapter2_confirmed.strategies_share_targets,
    chapter2_confirmed.speed_uses_milling_path,
    chapter2_confirmed.quoted_numbers_follow,
    chapter2_confirmed.smallest_targets,
    chapter2_confirmed.three_d_leaves_less,
    chapter2_confirmed.paired_tests,
    chapter2_confirmed.prediction_errors_differ,
    chapter2_confirmed.small_arithmetic,
    chapter3.intervals_are_student,
    chapter3.facial_nerve_counts,
    chapter3.distances_spread_less,
    chapter3.fle_per_axis,
    chapter3.smaller_margins,
    chapter3.point_risks,
    chapter3.upsampled_risks,
    chapter3.three_decimals,
    chapter3.row_labels,
    chapter4.volumes_are_not_cm3,
    chapter4.risks_above_acceptable,
    chapter4.registrations_per_margin,
    chapter4.tilt_within,
    chapter4.unequal_risks,
    chapter4.one_run_is_wider,
    chapter4.clinical_rates,
    chapter4.chapter_table_repeats_b1,
    chapter4.varying_margins_are_smaller,
    chapter4.distances_spread_less,
    chapter4.growth_times,
    chapter4.position_matters,
    baron.region_uses_one_dimension,
    baron.latencies,
    baron.filter_weights,
    baron.confidence_levels,
    baron.six_trajectories,
    baron.variances_add_up,
    baron.claims_with_right_quantile,
    baron.sums_are_conservative,
    baron.systems_compared,
)
"""One function for each finding, in the order of the works."""


def all_findings() -> list[Finding]:
    """Recompute every finding, in the order of the works."""
    return [finding() for finding in FINDINGS]


__all__ = [
    "FINDINGS",
    "Check",
    "Finding",
    "all_findings",
    "baron",
    "chapter2",
    "chapter2_claims",
    "chapter2_confirmed",
    "chapter3",
    "chapter4",
    "corrected_intervals",
    "findings_table",
]
