"""What makes an identification doubtful: warnings, each a sentence with a remedy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from gapscope.ident.checks.fit_evidence import FitEvidence, NominalSimilarity
from gapscope.ident.checks.plausible_samples import resting
from gapscope.ident.checks.table_row import FOUND, Row
from gapscope.ident.checks.torque_gain import torque_gain
from gapscope.ident.estimators.estimate import Estimate
from gapscope.ident.model.physical_parameters import inconsistent
from gapscope.ident.uncertainty.examination import Examination
from gapscope.ident.uncertainty.validation import Validation
from gapscope.model.change_findings import change_findings, change_text
from gapscope.model.changes import Change

BODIES = "unphysical"
"""Row of the table that says whether parameters of no body are certain."""
WORSE = "what was held out is predicted worse than by the nominal arm"
"""How the warning begins that comes before all others."""
SAID_OTHERWISE = (
    "low_speed_friction",
    "resting_joint",
    "torque_gain",
    "condition",
    BODIES,
)
"""Rows of the troubleshooting table that need no warning, or have a fuller one here."""


def identification_warnings(
    evidence: FitEvidence,
    estimate: Estimate,
    examined: Examination,
    changes: Sequence[Change],
    similarity: NominalSimilarity,
    table: Sequence[Row],
    held_out: Validation,
) -> tuple[str, ...]:
    """The warnings, those that concern all results first."""
    return (
        *_worse(held_out),
        *_torque(similarity, held_out),
        *_changed(changes),
        *estimate.warnings,
        *examined.warnings(),
        *_still(evidence),
        *_bodies(evidence, table),
        *_rows(table),
    )


def _worse(held_out: Validation) -> Iterator[str]:
    if held_out.every.overall > held_out.nominal.overall:
        yield (
            f"{WORSE}: {held_out.every.overall:.1%} of the torque against {held_out.nominal.overall:.1%}; use the "
            "nominal arm, record an exciting trajectory (`gapscope excite`), or stay nearer to it: --estimator ridge, "
            "truncated_svd or partial_update, --keep"
        )


def _torque(similarity: NominalSimilarity, held_out: Validation) -> Iterator[str]:
    gain = torque_gain(similarity)
    if gain.found:
        yield gain.warning()
    off = held_out.nominal.overall
    if off > 1.0:
        yield (
            f"the nominal arm's torque is off by {off:.0%} of the recorded one, more than no torque would be: "
            "another unit, another arm, or a load that is not in it; values near it mean little until that is clear"
        )


def _changed(changes: Sequence[Change]) -> Iterator[str]:
    for entry in change_findings(changes):
        yield f"{change_text(entry)}; cut the recording there, and name a known load in payloads:"


def _still(evidence: FitEvidence) -> Iterator[str]:
    still = resting([r for r in evidence.recordings if r.tau is not None])
    if len(still):
        joints = ", ".join(str(j + 1) for j in still)
        yield f"joint {joints} rests in every fitted recording: its own parameters are not identifiable"


def _bodies(evidence: FitEvidence, table: Sequence[Row]) -> Iterator[str]:
    wrong = inconsistent(evidence.physical.before)
    # noise alone takes parameters that the data hardly determine out of what bodies can have
    certain = any(row.entry.key == BODIES and row.verdict == FOUND for row in table)
    if wrong and (certain or len(evidence.zeros.asked)):
        negative = [str(c.link) for c in wrong if not c.positive_mass]
        masses = (
            f"; link {', '.join(negative)} even of negative mass" if negative else ""
        )
        yield (
            f"the parameters nearest to the nominal arm that fit best are those of no body on link "
            f"{', '.join(str(c.link) for c in wrong)}{masses}: the consistent ones are used instead"
        )


def _rows(table: Sequence[Row]) -> Iterator[str]:
    for row in table:
        if row.verdict == FOUND and row.entry.key not in SAID_OTHERWISE:
            where = f" on joint {', '.join(map(str, row.joints))}" if row.joints else ""
            yield f"{row.entry.cause}{where}: {row.entry.remedy}"
