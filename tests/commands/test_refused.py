"""What a command cannot use: exit code 2, and a message that names file, place and remedy; nothing is written."""

from __future__ import annotations

import csv
import os
import re
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Command = Callable[..., Any]
Spoil = Callable[[Path], object]
RECORD = (
    "record kuka_iiwa --effects {corrected} --out {out} --recordings 2 --duration 1.5"
)
PREDICT = "predict {sick} --recording {sick}/recording_0.csv --out {out}.csv"
ADVISE = "advise {sick} --evaluations 150 --no-collisions --singular 0"
QUICK = "--evaluations 25 --seed 1 --optimiser random"

WORDS = {
    "": """
        diagnos |
        diagnose |
        gap |
        gap case --jsn |
        predict c |
        diagnose case --out '' | an argument is empty (after --out)
        gap '{tmp}/[red]case[/red]' | [red]case[/red]
        matter {sick} --task {sick}/recording_0.csv | give --model corrected.yaml
        diagnose {sick} {healthy} --out {out} --backend cluster | --backend; cluster
        diagnose {sick} --out {out} --backend cluster | --backend; cluster
        matter {sick} --task {sick}/recording_0.csv --model {corrected} --diagnosis {sick} | --model; give one
        diagnose {healthy}/case.yaml --against {healthy} --out {out} | is the case itself
        predict {sick} --recording {tmp}/none.csv --out {out}.csv | {tmp}/none.csv
        replay {sick} --recording {sick}/none.csv --out {out}.csv | none.csv
        predict {sick} --recording {sick}/recording_0.csv --out {out}.parquet | .csv
        replay {sick} --recording {sick}/recording_0.csv --out {out}.npz | .csv
        view {sick} --recording no.csv --out {out} | no.csv
        serve {tmp}/none | is not a folder
        serve {tmp} --units-by robot |
        serve {tmp} --port 70000 |
        audit {tmp}/nothing.urdf | nothing.urdf
        watch {tmp} | --case
        fleet {tmp} --out {out} --keep all | --keep
        fleet {tmp} --out {out} --units-by robot | --units-by
        fleet {tmp} --out {out} --backend slurm | --backend
    """,
    RECORD: """
        --trajectory fourrier | fourier
        --engine ode | pybullet
        --format xlsx | npz
        --controller lqr | controller: section of a case
        --rate 300 | divide
        --duration 0.2 | at least
        --rate 1e9 | beyond any robot's log
        --recordings 1000000 | at most 4,000,000
        --recordings 0 | whole number
        --sealed {out}/safe | sealed
    """,
    "identify {healthy} --out {out}": """
        --estimator magic | consistent; remedy
        --judge other.csv | recording_0.csv; remedy
        --keep m9 | m9
        --estimator wls --keep m1 | consistent
        --estimator didim | controller; does not simulate; remedy
    """,
    "excite kuka_iiwa --out {out}.csv": """
        --rate 4 | 10 times; 5 Hz; remedy
        --frequency 0.01 --duration 20 | period; 100 s; remedy
        --rate nan | above zero
        --rate 1e9 | beyond any robot's log
        --frequency 5 --rate 200 | 10 times
        --frequency 0 | frequency; above zero
        --duration 2 | rising and falling; 3 s
        --duration 1e7 | samples
        --kind chirp | fourier; remedy
        --criterion a | condition; remedy
        --optimiser newton | gradient; remedy
        --criterion separation --effects payload,load_friction --optimiser gradient | no analytic gradient
        --effects payload | effects
        --effects payload,payload | effects
        --evaluations 0 | spent at once
        --seconds -1 | spent at once
        --velocity 0 | velocity
        --acceleration -1 | acceleration
        --torque 0 | above zero
        --surface nan | is no height
        --order 0 | order; remedy
        --criterion separation | effects; remedy
        --torque 0.0001 | allow no trajectory; gravity; remedy
        --singular 5 | allow no trajectory; singular; remedy
        --margin 2.5 | allow no trajectory; position; remedy
        --clearance 2 | allow no trajectory; clearance; remedy
        --effects stiction,payload | stiction; remedy
        --acceleration 1e-4 {quick} | acceleration keeps it small; raise --acceleration
        --surface 0.7 {quick} | broken most: distance; lower --surface
        --surface 2 | whole arm lies below; lower --surface; remedy
    """,
    "excite": """
        kuka_iwa --out {out}.csv | kuka_iiwa; remedy
        kuka_iiwa --out {out}.txt | .csv
    """,
    "evaluate --robot {sick} --out {out}": """
        nominal --motions fourie | did you mean 'fourier'
        nominal --motions pick | three joints
        nominal --engine unity | unity
        nominal --law fuzzy | fuzzy
        nominal --disturbances wind | wind
        nominal --bandwidth 0 | above zero
        nominal --damping -1 | above zero
        missing.yaml | missing.yaml
        missing.json | missing.json
        nominl | did you mean 'nominal'
        pd pd | two models
        {tmp}/odd.txt | unknown model
        pd --law computed --motions fourier | inertia
        gravity --law computed --motions fourier | inertia
        nominal --effects missing.yaml | missing.yaml
        pd --env gapscope/ArmTraking-v0 | did you mean 'gapscope/ArmTracking-v0'
    """,
    "train --robot {sick} --out {out}": """
        nominl | did you mean 'nominal'
        missing.yaml | missing.yaml
        nominal --agent pppo | did you mean 'ppo'
        nominal --agent missing.yaml | missing.yaml
        nominal | three joints
        nominal --steps 0 | steps
        nominal --engine unity | unity
        nominal --effects missing.yaml | missing.yaml
    """,
    "export {corrected} --out {out}": """
        --format urdf | one of --case and --robot
        --format urdf --robot kuka_iiwa --case {sick} | one of --case and --robot
        --format urdf --robot kuka_iwa | did you mean 'kuka_iiwa'
        --format urd --case {sick} | did you mean 'urdf'
        --format urdf --case missing | missing
        --format urdf --case {sick} --out {sick}/robot.urdf | overwritten
        --format mjlab --case {sick} --randomise | diagnosis.json
        --format mjlab --case {sick} --unit other | add --randomise
        --format playground --case {sick} | ranges alone
    """,
    "rehearse {sick} --out {out}": """
        --effect torque_scales | did you mean 'torque_scale'?
        --joint 3 | known are 1, 2
        --sizes huge | known are half, nine_of_ten, severity
    """,
    "residual {sick} --out {out}": """
        --form forest | known are best, additive, mlp, tcn
        --apart nothing | known are best, all, effects
        --judge other.csv | no recording is called 'other.csv'
        --model none.yaml | none.yaml
    """,
    ADVISE + " --diagnosis {open_question}": """
        --out {out}.csv --payload -2 | payload; kg; remedy
        --out {out}.csv --payload 2 --payload-com up | --payload-com; x,y,z; remedy
        --out {out}.csv --fastest 0.1 | 0.25 Hz; remedy
        --out {out}.txt | .csv; remedy
        --out {out}.csv --diagnosis {tmp} | diagnosis.json; remedy
    """,
}
"""Beginning of a command: its other words, and what its message has to say."""


def rows(tables: dict[str, str]) -> list[Any]:
    """Each line of the tables: the beginning, the words before its bar, and those that are said."""
    found = []
    for begin, lines in tables.items():
        for line in filter(None, map(str.strip, lines.splitlines())):
            given, _, said = line.rpartition("|")
            row = begin, given.strip(), [x.strip() for x in said.split(";")]
            found.append(pytest.param(*row, id=line))
    return found


@pytest.fixture
def refused(
    request: pytest.FixtureRequest, gapscope: Command, tmp_path: Path
) -> Callable[..., None]:
    """Runs a command whose places are named in braces, and asks for what it has to say."""

    def call(line: str, words: list[str]) -> None:
        for name, package in {
            "train": "stable_baselines3",
            "residual": "torch",
        }.items():
            if line.startswith(name):
                pytest.importorskip(package)
        places = {"out": tmp_path / "out", "tmp": tmp_path}
        places["file"] = tmp_path / "file.yaml"
        for name in set(re.findall(r"{(\w+)}", line)) - set(places):
            places[name] = request.getfixturevalue(name)
        done = gapscope(*(word.format(**places) for word in shlex.split(line)))
        said = " ".join(done.err.split())
        assert done.code == 2, done
        assert "Traceback" not in said and done.err.splitlines()[-1]
        missing = [w for w in words if w.format(tmp=tmp_path) not in said]
        assert not missing, done.err
        assert not list(tmp_path.glob("out*")), "nothing may be written"

    return call


@pytest.mark.parametrize(("begin", "more", "words"), rows(WORDS))
def test_words_that_cannot_be_used(
    begin: str, more: str, words: list[str], refused: Callable[..., None]
) -> None:
    refused(f"{begin} {more}".replace("{quick}", QUICK), words)


# one effect of a file, and gains of seven joints
STICTION = "{effect: stiction, joints: [1], parameters: {torque: [1]}}"
BEYOND = "{effect: coulomb_friction, joints: [3], parameters: {torque: [1]}}"
SLOW = "{effect: actuator_delay, joints: [1], parameters: {delay: [5]}}"
NEGATIVE = "{effect: coulomb_friction, joints: [1], parameters: {torque: [-9]}}"
PUSHED = "{effect: external_force, parameters: {force: [1, 1, 1], start: 0, end: 1}}"
SEVEN = "kp: [9, 9, 9, 9, 9, 9, 9], kd: [1, 1, 1, 1, 1, 1, 1]"
MODELS = f"""
    {{schema: 1, effects: [{STICTION}]}} | file.yaml, effects[0]: unknown effect 'stiction'
    {{schema: 1, effects: [{BEYOND}]}} | file.yaml; joint 3 of an arm with 2 joints
    {{schema: 1, effects: [{SLOW}]}} | file.yaml; outside
"""
FILES = {
    "gap {sick} --model {file}": MODELS,
    f"{PREDICT} --model {{file}}": MODELS,
    "evaluate {file} --robot {sick} --out {out}": f"""
        {{schema: 1, effects: [{BEYOND}]}} | file.yaml; effects[0]
    """,
    "export {file} --case {sick} --format sdf --out {out}": f"""
        {{schema: 1, effects: [{NEGATIVE}]}} | file.yaml; effects[0]
    """,
    "evaluate pd --robot {sick} --motions fourier --effects {file} --out {out}": f"""
        {{schema: 1, effects: [{PUSHED}]}} | external force
    """,
    "evaluate {tmp}/file.json --robot kuka_iiwa --out {out}": """
        {"files": {"case": "sick/case.yaml", "effects": "x.yaml"}} | file.json; yaw, pitch
        { | not valid JSON
        {} | names no files
    """,
    "train nominal --robot {sick} --agent {file} --out {out}": """
        algoritm: ppo | file.yaml; algoritm; did you mean 'algorithm'
        algorithm: a2c | file.yaml; algorithm: unknown algorithm 'a2c'
        steps: many | steps: expected a whole number
        steps: 0 | steps: expected a whole number
        network: 64 | network: expected a list
        bandwidth: -1 | bandwidth: expected a number above zero
        action: torqe | did you mean 'torque'
        motions: [fourie] | did you mean 'fourier'
        hyperparameters: {learning_rat: 0.1} | did you mean 'learning_rate'
        hyperparameters: {n_steps: 1.5} | hyperparameters.n_steps: expected a whole number
        hyperparameters: {learning_rate: fast} | expected a number from 0 on, got 'fast'
        hyperparameters: 3 | expected names with values
        {algorithm: sac, hyperparameters: {ent_coef: automatic_}} | ent_coef
        randomise: [payloads] | did you mean 'payload'
        {randomise: [payload], severity: 2} | severity
        tolerance: 0 | tolerance
        seed: -1 | seed
        parallel: 3 | parallel: expected true or false
        [1, 2] | expected names with values
        a: [ | file.yaml; not valid YAML
    """,
    f"{RECORD} --controller {{file}}": f"""
        {{rate: 500, kp: [9, 9], kd: [1, 1]}} | file.yaml, field kp: expected 7 entries, one per joint, got 2
        {{rate: 500, kp: [9, 9, 9, 9, 9, 9, 9], kd: [.nan, 1, 1, 1, 1, 1, 1]}} | field kd[1]: expected a number
        {{rate: 500, kb: 1, {SEVEN}}} | unknown key 'kb'
        {{rate: 500, feedforward: inverse, {SEVEN}}} | feedforward: expected one of none, gravity, nominal
        {{rate: 0, {SEVEN}}} | field rate: expected a number above 0
        {{rate: 500, kp: [9, 9, 9, 9, 9, 9, 9]}} | lacks the key 'kd'
        null | holds no controller
        [1, 2] | expected a mapping
    """,
    "evaluate pd --env {file} --out {out}": """
        robto: kuka_iiwa | did you mean 'robot'
        seeds: many | a whole number from 1 on
        engine: 3 | a name or a list of names
        {robot: kuka_iiwa, case: sick} | leave sheet: out, and robot:
        {motion: fourier, motions: pick} | says the same as motions
        randomisation: {count: 3} | draws no effects
        - robot | expected names with values
        robot: [ | not valid YAML
        robot: kuka_iwa | did you mean 'kuka_iiwa'
        effects: missing.yaml | missing.yaml
        law: fuzzy | fuzzy
        {robot: sick/robot.urdf, sheet: {viscous: [3.0]}} | expected 2 numbers; file.yaml
    """,
    ADVISE + " --diagnosis {tmp} --out {out}.csv": """
        {"schema": 1} | required
    """,
    "diagnose {file} --out {out}": """
        {name: x, robot: kuka_iiwa} | file.yaml; recordings
    """,
}
"""Command that reads a file: what stands in it, and what the message has to say."""


@pytest.mark.parametrize(("begin", "content", "words"), rows(FILES))
def test_files_that_cannot_be_used(
    begin: str,
    content: str,
    words: list[str],
    refused: Callable[..., None],
    sick: Path,
    tmp_path: Path,
) -> None:
    for name in ("file.yaml", "file.json", "diagnosis.json"):
        (tmp_path / name).write_text(content)
    refused(begin, words)


def in_file(name: str, old: str, new: str) -> Spoil:
    """What replaces text in a file of a case."""

    def spoil(case: Path) -> None:
        text = (case / name).read_text(encoding="utf-8")
        assert old in text
        (case / name).write_text(text.replace(old, new))

    return spoil


def added(text: str) -> Spoil:
    """What adds a line to the case file."""
    return lambda case: (case / "case.yaml").open("a").write(f"\n{text}\n")


def rewritten(name: str, change: Callable[[str], str], every: int = 1) -> Spoil:
    """What changes the cells of columns whose name begins so, in every so many rows of each recording."""

    def spoil(case: Path) -> None:
        for path in sorted(case.glob("recording_*.csv")):
            header, *lines = csv.reader(path.open(encoding="utf-8"))
            places = [i for i, label in enumerate(header) if label.startswith(name)]
            for line in lines[::every]:
                for i in places:
                    line[i] = change(line[i])
            with path.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerows([header, *lines])

    return spoil


def times(factor: float) -> Spoil:
    """The torque in another unit."""
    return rewritten("tau", lambda cell: repr(factor * float(cell)))


def cut(rows: int) -> Spoil:
    """The first rows of each recording alone."""

    def spoil(case: Path) -> None:
        for path in case.glob("recording_*.csv"):
            lines = path.read_text().splitlines(keepends=True)
            path.write_text("".join(lines[:rows]))

    return spoil


FIRST, URDF = "recording_0.csv", "robot.urdf"
READ = ("diagnose {sick} --out {out}", "gap {sick}")
IDENTIFY = ("identify {sick} --out {out}",)
DIDIM = ("identify {sick} --out {out} --estimator didim",)
LOGS = [f"identify {{sick}}/{name} --out {{out}}" for name in (FIRST, "log.db3")]
ALONE = "one recording agrees with itself; remedy"
PID = "controller: {kind: pid, rate: 250, kp: [9, 9], ki: [1, 1], kd: [1, 1]}"
OTHER_LOAD = "payloads: {recording_9.csv: {mass: 1.5, com: [0, 0, 0]}}"
UNNAMED = "no recording is called 'recording_9.csv'; did you mean 'recording_"
CASES = [
    (shutil.rmtree, READ, "sick; no such file; case.yaml"),
    (lambda case: os.renames(case / "case.yaml", case / "a/case.yaml"), READ, "are cases; fleet"),
    (lambda case: (case / FIRST).unlink(), READ, f"sick/{FIRST}; no such file"),
    (in_file(FIRST, "tau2", "torque2"), READ, f"sick/{FIRST}; tau2"),
    (in_file(URDF, "</robot>", ""), READ, "sick/robot.urdf; not valid XML"),
    (lambda case: (case / URDF).write_text("<robot name='r'/>"), READ, "sick"),
    (lambda case: (case / URDF).unlink(), READ, "sick/robot.urdf"),
    (in_file("case.yaml", "pitch", "elbow"), READ, "case.yaml; elbow; yaw, pitch"),
    (rewritten("q1", lambda cell: "oops"), READ, "recording_0.csv; line 2; q1"),
    (cut(200), READ, "recording_0.csv; least 1 s"),
    (in_file(URDF, "</robot>", ""), ("audit {sick}/robot.urdf",), "line "),
    (added(PID), DIDIM, "knows the law pd, not pid"),
    (cut(451), (f"{IDENTIFY[0]} --cutoff 2",), "too few; base parameters; record for"),
    (cut(202), IDENTIFY, "expected at least 1 s"),
    (rewritten("q", lambda cell: "0.5"), IDENTIFY, "the arm stands still"),
    (rewritten("tau1", lambda cell: "nan", 5), IDENTIFY, "recording_0.csv; tau1"),
    (times(1e3), IDENTIFY, "Torque unit; mend: {{torque: {{scale: 0.001}}}}"),
    # torque constant 0.1 N m/A and gear ratio 100 make 0.1 A of 1 N m
    (times(0.1), IDENTIFY, "Torque unit (current); mend: {{torque: {{scale: 10"),
    (in_file(FIRST, "tau", "current"), IDENTIFY, "tau1"),
    (added(OTHER_LOAD), (*READ, *IDENTIFY), UNNAMED),
    (added("import: {tau: null}"), ("rehearse {sick} --out {out}",), "has no torque"),
    (added("import: {tau: null}"), IDENTIFY, "no recording holds a torque"),
    (in_file("case.yaml", ", recording_1.csv, recording_2.csv", ""), ("agree {sick}",), ALONE),
    (in_file(FIRST, "q2", "elbow"), (PREDICT,), "recording_0.csv; q2"),
    (lambda case: (case / "log.db3").touch(), LOGS, "is a log; gapscope inspect"),
]  # fmt: skip
"""What was done to a case, commands that read it, and what their messages have to say."""


@pytest.mark.parametrize(
    ("spoil", "commands", "words"), CASES, ids=[row[2] for row in CASES]
)
def test_cases_that_cannot_be_used(
    spoil: Spoil,
    commands: tuple[str, ...],
    words: str,
    refused: Callable[..., None],
    sick: Path,
) -> None:
    spoil(sick)
    for command in commands:
        refused(command, words.split("; "))


@pytest.mark.parametrize(
    ("package", "extra", "line"),
    [
        ("ray", "cluster", "diagnose {sick} --out {out} --backend ray"),
        ("ray", "cluster", "fleet {sick} --out {out} --backend ray"),
        ("torch", "learn", "residual {sick} --out {out}"),
        ("onnx", "learn", "matter {sick} --task a.onnx --model {corrected}"),
        ("numba", "blind", "blind make --out {out} --healthy 1 --robots small {none}"),
    ],
)
def test_a_package_that_is_missing_is_asked_for_in_one_way(
    package: str,
    extra: str,
    line: str,
    gapscope: Command,
    sick: Path,
    corrected: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.setitem(sys.modules, "onnx.reference", None)
    none = " ".join(f"--{kind} 0" for kind in KINDS)
    places = {"sick": sick, "corrected": corrected, "out": tmp_path / "out"}
    done = gapscope(*line.format(**places, none=none).split())
    assert done.code == 2 and f"pip install 'gapscope[{extra}]'" in done.err
    assert f"needs {package}" in done.err and "which is not installed" in done.err


KINDS = ("singles", "pairs", "triples", "outside", "ladder")
"""Of the cases of a blind set, but for healthy ones."""
