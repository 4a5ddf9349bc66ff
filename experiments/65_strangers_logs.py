"""Logs as strangers have them: what inspect, check, diagnose and identify say of each, and whether that is one truth.

    GAPSCOPE_DATA=.../data .venv/bin/python experiments/65_strangers_logs.py --out out/strangers
        [--arms generated,ur10,emps] [--logs "as it is,degrees"]

The arms are one of the blind check's generator with a payload, the UR10 of the bag and the slide of EMPS, or any of
``experiments/cases``. Their recordings are written as tables with names of their own (``pos_1``, ``vel_1``, ``trq_1``),
spoilt in one way each. Of each log `inspect` drafts a case, which the other commands read as it was drafted. What a
command claims is told by its words. It is *true* if it claims what is so and nothing else beside what it says of the
sound log, *silent* if it claims less, and else *FALSE*. The sentences of each log are a file: run it again for the
rest.
"""

from __future__ import annotations

import re
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from common import CASES, command_line, markdown, run_missing
from generator_arms import make_generated

import gapscope
from gapscope.arm.case import load_case
from gapscope.arm.errors import GapscopeError, ModelWarning
from gapscope.blind_check.generator.simulate import STRONG, CaseSpec, Conditions
from gapscope.diagnosis.document.wording import verdict_sentence

as_it_is = import_module("52_data_as_it_is")
COMMANDS = ("inspect", "check", "diagnose", "identify")
NAMES = {"q": "pos", "dq": "vel", "tau": "trq"}
"""A stranger's names of channels."""
CLAIMS = {
    "order": "Joint swap",
    "unit": "Torque unit|Unit mismatch|all torques times about",
    "another fault": "Sign flip|Zero offset|Gravity compensated torque|Late torque",
    "stamps": "Time stamps",
    "other bodies": "another robot's URDF",
    "turned": "mounted turned|Base tilt",
    "rest": "stands still|no joint moves|at rest",
    "two arms": "as of another arm",
    "slow": r"hardly seen at [\d.]+ Hz",
    "pauses": "gaps in time|left out as pauses",
    "damaged": "rows left out that cannot be read",
    "vouches": "no other unit, sign, order or clock",
}
"""What a command may claim of a log, and the words in which it does."""
WRONG_COLUMNS = {"order", "unit", "other bodies", "turned"}
"""Claims beside which nobody may vouch for the columns."""
Columns = dict[str, np.ndarray]
Change = Callable[[Columns], Columns]


def exchanged(r: Columns) -> Columns:
    """Joints 1 and 3 in each other's place."""
    order = [2, 1, *range(r["pos"].shape[-1])]
    order[2:5] = [0]
    return {name: x if name == "t" else x[:, order] for name, x in r.items()}


def paused(r: Columns) -> Columns:
    """Two pauses of the logger, a tenth of the recording each."""
    rng, seconds = np.random.default_rng(65), 0.1 * float(np.ptp(r["t"]))
    for _ in range(2):
        r = as_it_is.gap(r, rng, seconds)
    return r


def resting(r: Columns) -> Columns:
    """The arm at rest: the first row, with noise."""
    rng = np.random.default_rng(len(r["t"]))
    noise = {n: 1e-5 * rng.standard_normal(x.shape) for n, x in r.items() if n != "t"}
    return {"t": r["t"], **{name: r[name][0] + x for name, x in noise.items()}}


def two_arms(r: Columns) -> Columns:
    """A second arm beside the first, which makes the same motion a third of the recording later."""
    own = {f"left_{name}": x for name, x in r.items() if name != "t"}
    right = {f"right_{n[5:]}": np.roll(x, len(x) // 3, axis=0) for n, x in own.items()}
    return {"t": r["t"], **own, **right}


def damaged(lines: list[str]) -> list[str]:
    """A row cut short, one with a number beyond all sizes, and a block of NaN."""
    cells = [line.split(",") for line in lines]
    cells[200] = cells[200][:2]
    cells[300][-1] = "1e154"
    for row in cells[400:440]:
        row[1:] = ["nan"] * (len(row) - 1)
    return [",".join(row) for row in cells]


def on_its_side(urdf: str) -> str:
    """The robot on a stand that is turned by 90 degrees."""
    links = re.findall(r'<link\s+name="([^"]+)"', urdf)
    children = re.findall(r'<child\s+link="([^"]+)"', urdf)
    (root,) = set(links) - set(children)
    stand = (
        '<link name="stand"/><joint name="stand_joint" type="fixed"><parent link="stand"/>'
        f'<child link="{root}"/><origin xyz="0 0 0" rpy="1.5707963 0 0"/></joint></robot>'
    )
    return urdf.replace("</robot>", stand)


class Log(NamedTuple):
    """What is done to recordings, lines and URDF (``None``: another robot's), and what is so then.

    ``all_say``: claims of all commands; ``seen``: of inspect and check; ``may``: of any; ``turns``: not for slides.
    """

    name: str
    change: Change = lambda r: r
    lines: Callable[[list[str]], list[str]] = lambda lines: lines
    robot: Callable[[str], str] | None = lambda urdf: urdf
    all_say: tuple[str, ...] = ()
    seen: tuple[str, ...] = ()
    may: tuple[str, ...] = ()
    turns: bool = False


SOUND = Log("as it is")
MOTORS = np.array([13.0, 13.0, 8.0, 8.0, 8.0, 8.0, 8.0])
"""Constants of the motors at the joints [N m/A]."""
LOGS = (
    SOUND,
    Log("header cut", lines=lambda lines: lines[1:]),
    Log("rows damaged", lines=damaged, all_say=("damaged", "pauses")),
    Log("joints 1 and 3 exchanged", exchanged, all_say=("order",), turns=True),
    Log("another robot's URDF", robot=None, all_say=("other bodies",), may=("unit",), turns=True),
    Log("base turned by 90°", robot=on_its_side, all_say=("turned",), turns=True),
    Log("degrees", lambda r: {n: np.rad2deg(x) if n in ("pos", "vel") else x for n, x in r.items()}, turns=True),
    Log("milliseconds", lambda r: {**r, "t": 1000 * r["t"]}),
    Log("pauses", paused, all_say=("pauses",)),
    Log("10 Hz", lambda r: as_it_is.sampled(r, 10), all_say=("slow",)),
    Log("at rest", resting, all_say=("rest",)),
    Log("two arms", two_arms, seen=("two arms",)),
    Log("amperes as torque", lambda r: {**r, "trq": r["trq"] / MOTORS[: r["trq"].shape[1]]}, all_say=("unit",)),
)  # fmt: skip
OTHER = {"generated": ("small", 2)}
"""Robots of the generator that stand for another one, and their numbers; ``ELSE`` for all real arms."""
ELSE = ("xarm6", 1)


def made_arm(robot: str, number: int, out: Path) -> Path:
    """A case of the generator: an arm with a payload, its controller unknown."""
    conditions = Conditions(robot, bare=True, rate=250, recordings=2)
    spec = CaseSpec("single", ("payload",), STRONG[1], conditions)
    folder = out / "made" / f"{robot}_{number}"
    make_generated(spec, (number, 65), folder)
    return folder


def write(arm: str, log: Log, out: Path, folder: Path) -> tuple[list[Path], Path]:
    """The files of a log and of its robot."""
    generated = arm == "generated"
    case = load_case(made_arm("small", 1, out) if generated else CASES / f"{arm}.yaml")
    other = log.robot is None
    urdf = (
        made_arm(*OTHER.get(arm, ELSE), out) / "robot.urdf" if other else case.arm.urdf
    )
    robot, files = folder / "robot.urdf", []
    text = urdf.read_text(encoding="utf-8")
    robot.write_text(log.robot(text) if log.robot else text, encoding="utf-8")
    for k, recording in enumerate(case.recordings):
        series = {word: getattr(recording, name) for name, word in NAMES.items()}
        series = {word: x for word, x in series.items() if x is not None}
        columns = log.change({"t": recording.t, **series})
        table = {"time": columns.pop("t")}
        for word, x in columns.items():
            table |= {f"{word}_{j}": own for j, own in enumerate(x.T, 1)}
        lines = pd.DataFrame(table).to_csv(index=False, float_format="%.8g").split("\n")
        files.append(folder / f"log_{k}.csv")
        files[-1].write_text("\n".join(log.lines(lines)), encoding="utf-8")
    return files, robot


def sentences(command: str, log: list[Path], urdf: Path, case: Path) -> Iterator[str]:
    """What a command says of a log or its case, the answer first."""
    if command == "inspect":
        result = gapscope.inspect(log, urdf)
        result.save(case)
        found, time = result.found, result.found.main.time
        remarks = *found.misread, *result.checked, *found.notes
        yield from (one.text for one in remarks)
        for _, guess in found.chosen.values():
            yield from (*guess.facts, f"{guess.channel}: {guess.reason}")
        yield f"time: {time.why}, {time.rate:.4g} Hz"
    elif command == "check":
        for one in gapscope.check(case).document["remarks"]:
            yield " ".join(filter(None, (one["place"], one["said"], one["remedy"])))
    elif command == "diagnose":
        document = gapscope.diagnose(case).document
        yield from (verdict_sentence(document), *document["warnings"])
    else:
        arm = gapscope.identify(case).identification
        off = arm.validation[1].every.overall
        yield from (f"identified: off by {off:.0%} of the torque", *arm.warnings)


def said(task: tuple[str, Log, Path]) -> dict[str, Any]:
    """Sentences of each command on a log of an arm."""
    arm, log, out = task
    warnings.simplefilter("ignore", ModelWarning)
    folder = out / "logs" / f"{arm}, {log.name}"
    # inspect writes over no case
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    files, robot = write(arm, log, out, folder)
    answer = {"arm": arm, "log": log.name}
    for command in COMMANDS:
        try:
            answer[command] = list(sentences(command, files, robot, folder / "case"))
        except GapscopeError as error:
            answer[command] = [f"refused: {error}".replace(f"{folder}/", "")]
    return answer


def judged(log: Log, command: str, texts: Sequence[str], sound: Sequence[str]) -> str:
    """``true``, ``silent`` or ``FALSE``, and the sentence that tells most of the log."""
    found, usual = (
        {
            name
            for name, words in CLAIMS.items()
            if re.search(f"(?i){words}", "\n".join(some))
        }
        for some in (texts, sound)
    )
    wanted = {*log.all_say, *(log.seen if command in COMMANDS[:2] else ())}
    false = found - usual - {*log.all_say, *log.seen, *log.may}
    false |= found & {"vouches"} if wanted & WRONG_COLUMNS else set()
    words = "|".join(CLAIMS[name] for name in (false or wanted)) or CLAIMS["vouches"]
    telling = [one for one in texts if re.search(f"(?i){words}", one)]
    kind = "FALSE" if false else "true" if wanted <= found else "silent"
    return f"{kind}: {(telling or list(texts))[0]}".replace("\n", " ")


def main() -> None:
    """Ask all commands of all logs, and print the table."""
    arms, logs = "generated,ur10,emps", ",".join(log.name for log in LOGS)
    folder = Path("out/strangers")
    arguments = command_line(
        __doc__, out=folder, arms=arms, logs=logs, limit=1200.0
    ).parse_args()
    out, chosen = arguments.out, [SOUND.name, *arguments.logs.split(",")]
    tasks = {
        out / "said" / f"{arm}, {log.name}.json": (arm, log, out)
        for arm in arguments.arms.split(",")
        for log in LOGS
        if log.name in chosen and not (log.turns and arm == "emps")
    }
    answers = run_missing(said, tasks, 1, arguments.limit)
    sound = {one["arm"]: one for one in answers if one["log"] == SOUND.name}
    rows = []
    for one in answers:
        log = next(log for log in LOGS if log.name == one["log"])
        usual = sound[one["arm"]]
        cells = [judged(log, x, one[x], usual[x]) for x in COMMANDS]
        rows.append([one["arm"], log.name, *cells])
    table = markdown(("arm", "log", *COMMANDS), rows)
    print(table)
    (out / "table.md").write_text(table + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
