"""The commands for recordings to make: ``record``, ``excite``, ``advise``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from gapscope.arm.errors import InputError
from gapscope.commands.options import (
    CasePath,
    Engine,
    File,
    Folder,
    Limits,
    NotNegative,
    Positive,
    Rate,
    RobotArgument,
    SearchSeed,
    Trajectory,
    split_names,
)
from gapscope.terminal import Progress, SearchProgress, note, show, wrote

if TYPE_CHECKING:
    from gapscope.arm.known_load import KnownLoad


def record(
    robot: RobotArgument,
    *,
    effects: File,
    out: Annotated[Path, Option(metavar="CASE")],
    trajectory: str = "fourier",
    recordings: int = 4,
    duration: float = 10.0,
    rate: float = 250.0,
    controller: Annotated[str | None, Option(metavar="KIND|FILE")] = None,
    read_back: bool = False,
    noise: float = 0.01,
    encoder_noise: float = 0.0,
    format_: str = "csv",
    engine: Engine = None,
    seed: NotNegative | None = None,
    sealed: Folder | None = None,
) -> None:
    """Record a simulated arm with effects as a case.

    The truth is kept in truth.yaml, in the case or sealed elsewhere.

    Args:
        effects: effects, in the form of corrected.yaml
        out: folder of the case to make
        trajectory: fourier, point_to_point, weld_seam, pick, place, random, or a CSV that excite wrote
        recordings: how many, from slow to fast
        duration: of each [s]
        rate: samples per second [Hz]
        controller: pd, pid, cascade or computed_torque, with gains that fit the arm, or a YAML file in the form of the
            controller: section of a case; by default as the case ROBOT has it, else pd
        read_back: record the torque that reached the joints, read back from the drives, in place of the torque
            commanded
        noise: noise of the torque, as a share of its standard deviation
        encoder_noise: noise of the encoders [rad]
        format_: csv, parquet or npz
        seed: draw the same motions and noise again
        sealed: folder for the truth, outside the case
    """
    import numpy as np

    from gapscope.arm.io.atomic_write import make_folder
    from gapscope.arm.io.locked_section import locked
    from gapscope.arm.io.write_case import write_case
    from gapscope.arm.nearest_name import check_known
    from gapscope.commands.inputs import (
        ENDINGS,
        TRUTH,
        check_places,
        chosen_controller,
        read_arm_and_controller,
    )
    from gapscope.effects.corrected_file import (
        error_context,
        read_with_faults,
        write_corrected,
    )
    from gapscope.envs.engines import check_engine
    from gapscope.envs.recorder import Plan, hidden_by_reading_back, record_case

    plan = Plan(
        trajectory,
        recordings,
        duration,
        rate,
        read_back,
        noise,
        encoder_noise,
        check_engine(engine),
    )
    check_known("format", format_, ENDINGS, where="format")
    # all that can be refused is, before anything is simulated
    truth, faults = read_with_faults(effects)
    check_places(effects, out, sealed)
    arm, known = read_arm_and_controller(robot)
    law = chosen_controller(controller, arm, known)
    # before the simulation: a seal that cannot be written must not cost one
    if sealed is not None:
        make_folder(sealed)
    rng, name = np.random.default_rng(seed), out.resolve().name

    with Progress(out) as progress, locked(out):
        with error_context(effects, truth):
            made = (name, arm, truth, plan, rng)
            # faults lie in the log, not in the arm: they come after the recording
            case = record_case(*made, controller=law, progress=progress)
            for fault in faults:
                case = fault.in_case(case, rng, arm)
        progress("writes the case")
        # with its truth in it from the start: without, it could not be told from a sealed one
        file = write_case(
            *(case, out),
            ending=format_,
            beside=lambda folder: write_corrected(
                name, truth, (sealed or folder) / TRUTH, faults=faults
            ),
        )
    hidden = hidden_by_reading_back(truth) if read_back else ()
    if hidden:
        note(
            f"note: {', '.join(hidden)}: torque that is read back behind the drive hardly shows this; without "
            "--read-back the torque commanded is recorded"
        )
    wrote(file, (sealed or out) / TRUTH)


def excite(
    robot: RobotArgument,
    *,
    out: Trajectory,
    kind: str = "fourier",
    order: int = 5,
    frequency: float = 0.1,
    duration: float | None = None,
    rate: Rate = 250.0,
    criterion: str = "condition",
    effects: str = "",
    optimiser: str | None = None,
    evaluations: int = 3000,
    seconds: float | None = None,
    limits: Limits,
    seed: SearchSeed = None,
) -> None:
    """Design an exciting trajectory within limits.

    It is written as CSV, as a ROS JointTrajectory, and as a page of plots.

    Args:
        kind: fourier, quintic (through way points) or multisine
        order: number of harmonics; half that of way points
        frequency: of the first harmonic [Hz]
        duration: length [s]; by default 10, or one period
        criterion: condition, d, e or separation (of --effects)
        effects: effects to tell apart, with commas between them
        optimiser: random, swarm, cma or gradient
        evaluations: objective evaluations; a gradient counts as 8
        seconds: time to search, at most [s]
    """
    from gapscope.arm.io.write_case import check_csv
    from gapscope.ident.excitation.design import ExcitationPlan
    from gapscope.ident.excitation.trajectory_search import Budget
    from gapscope.interface.advise import excite as excite_arm

    plan = ExcitationPlan(
        kind,
        order,
        frequency,
        duration,
        rate,
        criterion,
        split_names(effects),
        optimiser=optimiser,
        budget=Budget(evaluations, seconds),
    )
    with SearchProgress(robot, criterion) as progress:
        # before the search, which takes minutes
        check_csv(out)
        result = excite_arm(robot, plan, limits, seed=seed, progress=progress)
        paths = result.write(out)
    show(result, *paths)


def advise(
    case: CasePath,
    *,
    out: Trajectory,
    diagnosis: Folder | None = None,
    payload: float | None = None,
    payload_com: str = "0,0,0",
    fastest: float = 5.0,
    rate: Rate = 250.0,
    evaluations: Positive = 1000,
    limits: Limits,
    seed: SearchSeed = None,
) -> None:
    """Design the recording that separates what is still confounded.

    Args:
        diagnosis: folder that diagnose wrote for this case; default: diagnose it now
        payload: mass of a known body that could be mounted; used if it separates better [kg]
        payload_com: its centre in the frame of the joint that moves the last link, x,y,z [m]
        fastest: highest frequency that the controller follows [Hz]
        evaluations: objective evaluations, over all speeds and loads
    """
    from gapscope.arm.io.write_case import check_csv
    from gapscope.diagnosis.next_recording import AdviceRequest
    from gapscope.interface.advise import advise as advise_case
    from gapscope.interface.advise import read_findings

    check_csv(out)
    load = read_payload(payload, payload_com)
    request = AdviceRequest(limits, load, fastest, rate, evaluations, seed)
    with Progress(case) as progress:
        found = read_findings(case, diagnosis, progress)
    with SearchProgress(progress.label, "separation") as search:
        result = advise_case(found, request, progress=search)
        motion = result.trajectory
        paths = () if motion is None else motion.write(out)
    show(result, *paths)


def read_payload(mass: float | None, centre: str) -> KnownLoad | None:
    """The payload of the options ``--payload`` and ``--payload-com``, or ``None`` if no mass is given.

    Raises:
        InputError: the centre is not three numbers, or the mass is not above zero.
    """
    from gapscope.arm.known_load import KnownLoad

    # without a mass there is no body, whatever its centre
    if mass is None:
        return None
    try:
        x, y, z = (float(part) for part in centre.split(","))
    except ValueError:
        raise InputError(
            f"{centre!r} is no centre of mass",
            "give x,y,z in m, such as 0,0,0.05",
            where="--payload-com",
        ) from None
    if mass == 0:
        raise InputError(
            "a payload of 0 kg is none", "give its mass in kg", where="--payload"
        )
    return KnownLoad(mass, (x, y, z))
