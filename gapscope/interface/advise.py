"""Design an exciting trajectory within an arm's limits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import RenderableType
from threadpoolctl import threadpool_limits

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import InputError
from gapscope.arm.io.atomic_write import make_folder
from gapscope.arm.io.table import numbered
from gapscope.arm.io.write_case import check_csv
from gapscope.arm.known_load import KnownLoad
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.diagnosis.diagnose import diagnose as diagnose_case
from gapscope.diagnosis.document.diagnosis_json import read_document
from gapscope.diagnosis.next_recording import Advice, AdviceRequest, lines
from gapscope.diagnosis.next_recording import advise as design_recording
from gapscope.diagnosis.prepare import Progress, silent
from gapscope.diagnosis.selection.search import could_show
from gapscope.effects.applied import AppliedEffect
from gapscope.effects.corrected_file import read_corrected
from gapscope.ident.excitation.design import (
    Excitation,
    ExcitationPlan,
    LimitPlan,
    design,
    prepare,
)
from gapscope.interface.diagnose import DiagnosisResult
from gapscope.interface.models import make_arm
from gapscope.interface.result import Result
from gapscope.reports.trajectory import shown, summary, write_trajectory


@dataclass(frozen=True, repr=False)
class ExcitationResult(Result):
    """An exciting trajectory that keeps all limits.

    Attributes:
        arm: the arm.
        plan: what was looked for.
        excitation: the trajectory with torque, margins and condition number.
        payload: known body that is mounted on it, or ``None``.
    """

    arm: NominalArm
    plan: ExcitationPlan
    excitation: Excitation
    payload: KnownLoad | None = None

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write ``trajectory.csv``, the ROS ``JointTrajectory``, a page of plots, and a slow version to run first."""
        return self.write(Path(folder) / "trajectory.csv")

    def write(self, file: Path) -> tuple[Path, ...]:
        """Write the CSV ``file``, and ``.yaml`` (ROS ``JointTrajectory``) and ``.html`` (plots) beside it.

        ``NAME_slow.csv`` and ``.yaml`` are the same path at a fifth of the speed, to be run first. All are checked as
        written.
        """
        check_csv(file)
        make_folder(file.resolve().parent)
        return tuple(write_trajectory(self.excitation, self.arm, self.plan, file))

    def shown(self) -> RenderableType:
        """Margins, sizes at which effects would show, condition number and effort of the search."""
        return shown(
            self.excitation, self.expected(), summary(self.excitation, self.plan)
        )

    def expected(self) -> list[dict[str, Any]]:
        """How large an effect would have to be for a recording of the motion to show it, as in ``diagnosis.json``."""
        motion, torque = self.excitation.motion, self.excitation.torque
        # as if it were recorded, with the torque of the nominal arm
        planned = Recording("planned", motion.t, motion.q, torque, payload=self.payload)
        # many small matrices: threads would wait for each other
        with threadpool_limits(1):
            return could_show(self.arm, [planned])

    def table(self) -> dict[str, np.ndarray]:
        """The columns t, q1.., dq1.., ddq1.., tau1.. (nominal torque)."""
        return numbered({**vars(self.excitation.motion), "tau": self.excitation.torque})


def excite(
    robot: str | Path | NominalArm | Case,
    plan: ExcitationPlan | None = None,
    limits: LimitPlan | None = None,
    *,
    seed: int | None = None,
    progress: Callable[[float, float], None] = lambda share, best: None,
) -> ExcitationResult:
    """Find a trajectory that excites the arm's parameters best and keeps all limits.

    Args:
        robot: a name, a URDF, an arm or a case; see ``make_arm``.
        plan: what to look for.
        limits: what to keep.
        seed: of the search; by default another one each time.
        progress: called with the share of the budget spent and the best value so far, or infinity.

    Raises:
        InputError: an argument is at fault, or the limits allow no trajectory.

    Examples:
        >>> import gapscope
        >>> gapscope.excite("kuka_iiwa", seed=1).save("out")  # doctest: +SKIP
    """
    arm, plan = make_arm(robot), plan or ExcitationPlan()
    rng = np.random.default_rng(seed)
    found = design(prepare(arm, plan, limits or LimitPlan(), progress), rng)
    return ExcitationResult(arm, plan, found)


Findings = tuple[Case, Mapping[str, Any], tuple[AppliedEffect, ...]]
"""A case, its ``diagnosis.json``, and the effects found, with values."""


@dataclass(frozen=True, repr=False)
class AdviceResult(Result):
    """The next recording of a case.

    Attributes:
        case: the case.
        document: its ``diagnosis.json``.
        advice: open questions, hypotheses, and the motion that separates them.
    """

    COLUMNS = ("found", "other", "probability")

    case: Case
    document: Mapping[str, Any]
    advice: Advice

    @property
    def trajectory(self) -> ExcitationResult | None:
        """The motion to record; ``None`` if no recording is needed."""
        plan, excitation = self.advice.plan, self.advice.excitation
        if plan is None or excitation is None:
            return None
        # designed with it, so it is part of what is recorded
        load = self.advice.option.payload if self.advice.option else None
        return ExcitationResult(self.case.arm, plan, excitation, load)

    def save(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the motion as ``trajectory.csv``, ROS ``JointTrajectory`` and plot; nothing if none is needed."""
        return () if self.trajectory is None else self.trajectory.save(folder)

    def shown(self) -> RenderableType:
        """What is open, and the recording that settles it."""
        texts, motion = lines(self.advice, self.document), self.trajectory
        if motion is None:
            return "\n".join(texts)
        return shown(motion.excitation, motion.expected(), texts)

    def table(self) -> Iterator[tuple[str, str, float]]:
        """A row for each open question: the effect found, what else could explain the data, and its probability."""
        return ((q.found, q.other, q.probability) for q in self.advice.questions)


def read_findings(
    path: str | Path, folder: Path | None = None, progress: Progress = silent
) -> Findings:
    """A case with its diagnosis and the effects found: from the folder of a diagnosis, or diagnosed now.

    Raises:
        InputError: the case, or the folder, cannot be used.
    """
    progress("reads the case")
    # units may be wrong: the diagnosis tests that
    case = load_case(path, any_unit=True)
    if folder is None:
        result = diagnose_case(case, progress)
        return case, result.document, result.effects
    document = read_document(folder / "diagnosis.json")
    # a diagnosis does not name the files of its case: this much can be compared
    joints = len(document["gap"]["before"]["torque_nrmse"])
    if joints != case.arm.n_joints:
        raise InputError(
            f"is of an arm with {joints} joints, the case {case.name} has {case.arm.n_joints}",
            "give the folder that gapscope diagnose wrote for this case",
            file=folder / "diagnosis.json",
        )
    return case, document, read_corrected(folder / "corrected.yaml")


def advise(
    diagnosis: DiagnosisResult | Findings | str | Path,
    request: AdviceRequest | None = None,
    *,
    progress: Callable[[float, float], None] = lambda share, best: None,
) -> AdviceResult:
    """Design the recording on which the explanations that are still open differ most within all limits.

    Args:
        diagnosis: a result of ``diagnose``; a case's folder, which is diagnosed first; or what ``read_findings`` read.
        request: limits, known payload, fastest motion, effort.
        progress: called with the share of the search's budget spent and the best value so far, or infinity.

    Raises:
        InputError: the limits allow no trajectory.

    Examples:
        >>> import gapscope
        >>> gapscope.advise(gapscope.diagnose("my_arm")).save("next")  # doctest: +SKIP
    """
    # what is named; effects of an identified arm belong to that arm
    if isinstance(diagnosis, DiagnosisResult):
        found = (diagnosis.case, diagnosis.document, diagnosis.diagnosis.effects)
    elif isinstance(diagnosis, tuple):
        found = diagnosis
    else:
        found = read_findings(diagnosis)
    # limits that any arm keeps, unless the user gives others
    asked = request or AdviceRequest(LimitPlan())
    return AdviceResult(found[0], found[1], design_recording(*found, asked, progress))
