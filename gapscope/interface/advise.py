"""Design the next recording, which separates what a diagnosis leaves open."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from gapscope.diagnosis.next_recording import Advice, AdviceRequest, lines
from gapscope.diagnosis.next_recording import advise as design_recording
from gapscope.ident.excitation.design import LimitPlan
from gapscope.interface.diagnose import DiagnosisResult, diagnose
from gapscope.interface.excite import ExcitationResult
from gapscope.interface.result import Result


@dataclass(frozen=True, repr=False)
class AdviceResult(Result):
    """The next recording of a case.

    Attributes:
        diagnosis: what was found so far.
        advice: open questions, hypotheses, and the motion that separates them.
    """

    COLUMNS = ("found", "other", "probability")

    diagnosis: DiagnosisResult
    advice: Advice

    @property
    def trajectory(self) -> ExcitationResult | None:
        """The motion to record; ``None`` if no recording is needed."""
        plan, excitation = self.advice.plan, self.advice.excitation
        if plan is None or excitation is None:
            return None
        return ExcitationResult(self.diagnosis.case.arm, plan, excitation)

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the motion as ``trajectory.csv``, ROS ``JointTrajectory`` and plot; nothing if none is needed."""
        return () if self.trajectory is None else self.trajectory.save(folder)

    def shown(self) -> str:
        """What is open, and the recording that settles it."""
        return "\n".join(lines(self.advice, self.diagnosis.document))

    def table(self) -> Iterator[tuple[str, str, float]]:
        """A row for each open question: the effect found, what else could explain the data, and its probability."""
        return ((q.found, q.other, q.probability) for q in self.advice.questions)


def advise(
    diagnosis: DiagnosisResult | str | Path,
    request: AdviceRequest | None = None,
    *,
    progress: Callable[[float, float], None] = lambda share, best: None,
) -> AdviceResult:
    """Design the recording on which the explanations that are still open differ most within all limits.

    Args:
        diagnosis: a result of ``diagnose``; or a case's folder, which is diagnosed first.
        request: limits, known payload, fastest motion, effort.
        progress: called with the share of the search's budget spent and the best value so far, or infinity.

    Raises:
        InputError: the limits allow no trajectory.

    Examples:
        >>> import gapscope
        >>> gapscope.advise(gapscope.diagnose("my_arm")).save("next")  # doctest: +SKIP
    """
    result = (
        diagnosis if isinstance(diagnosis, DiagnosisResult) else diagnose(diagnosis)
    )
    asked = request or AdviceRequest(LimitPlan())
    found = (result.document, result.diagnosis.effects)
    return AdviceResult(result, design_recording(result.case, *found, asked, progress))
