"""A diagnosis as a page, on the terminal and as files."""

from __future__ import annotations

import base64
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text
from scipy.spatial.transform import Rotation

from gapscope.arm.display import (
    MISSING,
    display_unit,
    nrmse,
    percent,
    significant,
)
from gapscope.arm.dynamics.link_shapes import link_hulls, reach
from gapscope.arm.dynamics.plain_urdf import moving_links
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.json_file import plain
from gapscope.arm.joint_units import joint_unit
from gapscope.arm.reading import interpolated
from gapscope.diagnosis.document import wording
from gapscope.diagnosis.document.diagnosis_json import validate
from gapscope.diagnosis.document.findings import NOT_YET
from gapscope.diagnosis.document.wording import (
    VERDICTS,
    Document,
    acts_on,
    called,
    capital,
    gap_rows,
    gravity_text,
    holds_in,
    in_text,
    joint_names,
    joint_ranges,
    joint_slides,
    nominal_friction_sentence,
    parameter_texts,
    possible_texts,
    presliding_sentence,
    short_names,
    sides_sentence,
    unexplained_sentence,
    verdict_sentence,
    worst_joint,
)
from gapscope.diagnosis.locate import DRIVES, FREQUENCIES, JointLocalisation, Region
from gapscope.diagnosis.result import Diagnosis, Signature, Trace
from gapscope.effects.catalogue import known_effect, of_quantity
from gapscope.effects.effect import SHEET
from gapscope.model.changes import change_text
from gapscope.reports.expected import expected_rows
from gapscope.reports.pages import terminal_table, write_html

# A diagnosis as a page and on the terminal.


# Curves as text within a page.


def encode(values: np.ndarray, kind: str = "<f4") -> str:
    """Base64 of the values, by default as little-endian float32."""
    # little endian on any machine: the script of the page reads it so
    content = np.ascontiguousarray(values, dtype=kind).tobytes()
    return base64.b64encode(content).decode("ascii")


# What to do after a diagnosis: a sentence each, with the command if there is one.


OF_COLUMNS = (
    "motion",
    "torque",
    "time_factor",
    "torque_delay",
    "gravity",
    "link_shift",
)
"""What a reading changes of a log's columns, or of the robot that goes with them."""


MOUNTED = "If the arm is mounted so, say it in the case file"


class Action(NamedTuple):
    """One thing to do, and the command for it; empty if there is none."""

    text: str
    command: str = ""


def actions(diagnosis: Diagnosis, folder: Path) -> list[Action]:
    """What a reader would do next, the most pressing first, with commands on the files of the case.

    Args:
        diagnosis: the diagnosis.
        folder: of its files.
    """
    document, file = diagnosis.document, diagnosis.case_file
    n, found = len(joint_names(document)), []
    # a case made in memory has no file to name
    case = "CASE" if file is None else shlex.quote(str(file))

    def made(name: str) -> str:
        return shlex.quote(str(folder / name))

    if any(fault.reading(n).differs(*OF_COLUMNS) for fault in diagnosis.faults):
        # what follows is to be done with the mended case
        case = made("mended_case.yaml")
        found.append(
            Action(
                "Read the logs as they are meant: mended_case.yaml, beside this page, does",
                f"gapscope diagnose {case} --out {made('mended')}",
            )
        )
    for entry in document["effects"]:
        # a base that hangs otherwise than the case says
        if "gravity" in entry:
            found.append(Action(MOUNTED, f"gravity: {gravity_text(entry)}"))
    # with a reference effects count from its arm
    counted = made(CASE) if "against" in document else case
    # while a cause is missing, a simulator with the others is no better known
    if diagnosis.effects and document["verdict"] != "unexplained":
        found.append(
            Action(
                "Give the effects found to your simulator",
                f"gapscope export {made(CORRECTED)} --case {counted} --format mjcf --out arm.xml",
            )
        )
    # of another arm there is no gap to look at
    if document["verdict"] == "unexplained" and "misread" not in document:
        found.append(
            Action(
                "Look at what stays unexplained, below: on which joints, when and at which frequencies the gap acts"
            )
        )
    # it may be something to correct first: then no motion is designed
    following = document["next_recording"] or ""
    if following.startswith(NOT_YET):
        found.append(Action(capital(following.removeprefix(NOT_YET))))
    elif following:
        found.append(
            Action(
                f"Record next: {following}", f"gapscope advise {case} --out next.csv"
            )
        )
    if not found:
        found.append(
            Action(
                "Nothing: the arm is as its model says, within what a healthy arm leaves"
            )
        )
    return found


# What the pictures of where a gap lies draw, with the words under them.


def place_curves(diagnosis: Diagnosis) -> list[Document]:
    """All pictures as JSON-ready values: of a rule, of intervals of time, of bands and lines of frequency."""
    out: list[Document] = []
    slides = joint_slides(diagnosis.document)
    for located in diagnosis.located:
        place = located.place
        kinds = {
            "rule": _rule(place, slides[place.joint - 1]),
            "time": _time(place),
            "frequency": _frequency(place),
        }
        for kind, drawn in kinds.items():
            if drawn is not None:
                common = {"stage": located.stage, "joint": place.joint, "kind": kind}
                out.append({"index": len(out), **common, **drawn})
    return out


def _rule(place: JointLocalisation, slides: bool) -> Document | None:
    profile = place.profile
    if profile is None:
        return None
    words = f"{profile.words}. The shaded part is where the rule holds, the dashed line the floor of a healthy arm."
    return {
        "title": f"J{place.joint}: in which part of the motion",
        "words": capital(in_text(words) if slides else words),
        "axis": f"{profile.condition['symbol']} [{joint_unit(profile.condition['unit'], slides)}]",
        "x": encode(profile.x),
        "rms": encode(profile.rms),
        "above": profile.condition["above"],
        "below": profile.condition["below"],
        "floor": place.floor,
    }


def _time(place: JointLocalisation) -> Document | None:
    # without a start or a stop there is nothing to see over time
    told = [region for region in place.regions if region.kind == "interval"]
    if not told:
        return None
    name = told[0].detail["recording"]
    # of several recordings the one with the largest part of the gap
    level = next(level for level in place.levels if level.recording == name)
    return {
        "title": f"J{place.joint}: when",
        "words": f"{_joined(told)}. The line is the RMS of the gap over a quarter of a second, the steps its level.",
        "axis": f"time in {name} [s]",
        "x": encode(level.t),
        "rms": encode(level.rms),
        "steps": encode(level.steps),
        "floor": place.floor,
    }


def _frequency(place: JointLocalisation) -> Document | None:
    told = [region for region in place.regions if region.kind in ("line", "coherence")]
    if not told:
        return None
    # a line stands before coherent bands
    if told[0].kind == "line":
        meaning = "What has a frequency of its own does not follow the motion: vibration, a resonance, a ripple."
    else:
        meaning = (
            "Coherence is the share of the gap that follows a signal: 1 all of it, 0 none. A gap that follows the "
            "torque is a matter of the drive or of the load, one that follows velocity of friction or delay, one that "
            "follows acceleration of inertia."
        )
    found = place.spectra
    return {
        "title": f"J{place.joint}: at which frequencies",
        "words": f"{_joined(told)}. {meaning}",
        "x": encode(FREQUENCIES),
        # over its peak: where it lies is shown, not how large it is
        "gap": encode(found.gap / max(float(found.gap.max()), 1e-300)),
        "coherence": [
            {"name": name, "y": encode(np.clip(row, 0.0, 1.0))}
            for name, row in zip(DRIVES, found.coherence, strict=True)
        ],
    }


def _joined(regions: list[Region]) -> str:
    return capital("; ".join(region.regime for region in regions))


WHITE = 1e-3
"""With a larger p-value what stays of a joint's gap may be noise."""


def guess_curves(diagnosis: Diagnosis) -> list[Document]:
    """A picture for each joint left above the floor as JSON-ready values."""
    entries = diagnosis.document["unexplained"].get("predictable", [])
    return [
        {
            "joint": entry["joint"] - 1,
            "axis": f"{entry['curve']['variable']} [{entry['curve']['unit']}]",
            "amplitude": entry["curve"]["variable"] == "frequency",
            "x": encode(entry["curve"]["x"]),
            "y": encode(entry["curve"]["y"]),
        }
        for entry in entries
    ]


# What the figures of the report draw: decimated curves as base64 of float32, little endian.


POINTS_PER_CURVE = 4000
"""Most points of one curve over time."""

POINTS_OF_ALL_TRACES = 180_000
"""Most points of all curves over time together, 1 MB; many recordings share them."""

POINTS_PER_SIGNATURE = 700


def payload(diagnosis: Diagnosis) -> dict[str, Any]:
    """All that the script of the report draws, as JSON-ready values."""
    names = joint_names(diagnosis.document)
    # a document need not list its recordings
    roles = {r["name"]: r["role"] for r in diagnosis.document.get("recordings", [])}
    # four curves for each joint of each recording
    most = POINTS_OF_ALL_TRACES // max(1, 4 * len(names) * len(diagnosis.traces))
    points = int(np.clip(most, 400, POINTS_PER_CURVE))
    spectrum = diagnosis.spectrum
    return {
        "joints": [
            f"J{number} {name}".strip()
            for number, name in enumerate(short_names(names), 1)
        ],
        "worst": (worst_joint(diagnosis.document, "before") or 1) - 1,
        "recordings": [
            {
                "name": trace.recording,
                "role": roles.get(trace.recording, ""),
                "joints": _curves(trace, points),
            }
            for trace in diagnosis.traces
        ],
        "spectrum": {
            "frequency": encode(spectrum.frequency),
            "before": [*map(encode, np.atleast_2d(spectrum.before.T))],
            "after": [*map(encode, np.atleast_2d(spectrum.after.T))],
        },
        "places": place_curves(diagnosis),
        "guesses": guess_curves(diagnosis),
        "slides": joint_slides(diagnosis.document),
        "signatures": [_signature(signature) for signature in diagnosis.signatures],
    }


def _curves(trace: Trace, points: int) -> list[dict[str, str]]:
    """Per joint the curves of one recording, all four at the same samples."""
    joints = []
    for joint in range(trace.measured.shape[1]):
        names = ("measured", "nominal", "corrected")
        curves = {name: getattr(trace, name)[:, joint] for name in names}
        left = curves["measured"] - curves["corrected"]
        # peaks of the torque and of what is left are what a reader looks for
        keep = keep_extremes([curves["measured"], left], points)
        curves["t"] = trace.t
        joints.append({name: encode(curve[keep]) for name, curve in curves.items()})
    return joints


def keep_extremes(series: list[np.ndarray], points: int) -> np.ndarray:
    """Indices of at most ``points`` samples that keep the peaks: of each series the extremes of equal stretches."""
    n = len(series[0])
    if n <= points:
        return np.arange(n)
    # least and largest of each series are kept from each stretch
    edges = np.linspace(0, n, max(1, points // (2 * len(series))) + 1).astype(int)
    pairs = list(pairwise(edges))
    kept = [
        a + pick(np.nan_to_num(x[a:b]))
        for x in series
        for a, b in pairs
        for pick in (np.argmin, np.argmax)
    ]
    return np.unique(kept)


def _signature(signature: Signature) -> Document:
    """A signature with its samples thinned evenly; ``line`` if the axis only grows, as time does."""
    n = len(signature.x)
    keep = np.unique(np.linspace(0, n - 1, min(n, POINTS_PER_SIGNATURE)).astype(int))
    return {
        "joint": signature.joint - 1,
        "axis": signature.axis,
        "unit": signature.unit,
        "line": bool(n > 1 and np.all(np.diff(signature.x) > 0)),
        "x": encode(signature.x[keep]),
        "gap": encode(signature.gap[keep]),
        "explained": encode(signature.explained[keep]),
    }


# The arm in 3D, as the page draws it: bodies, joints, and the motions that were recorded and replayed.


FRAMES_PER_SECOND = 40.0
"""Samples of a motion that are kept per second."""
MAX_FRAMES = 2400
"""Most samples of a motion: a minute."""


def arm_scene(diagnosis: Diagnosis) -> Document | None:
    """Bodies, joints and motion as JSON-ready values; ``None`` if the arm or its motion is not known.

    The motion is the one that was replayed, with the simulated arms beside the recorded one; without a replay the first
    recording alone.
    """
    # of a diagnosis that is read again neither need be known
    if diagnosis.arm is None or not diagnosis.traces:
        return None
    body = RigidBody(diagnosis.arm)
    links = moving_links(body, movable=False)
    names = [link.joint for link in links]
    joints = []
    for link in links:
        turn = Rotation.from_matrix(link.origin.rotation).as_quat()
        joints.append(
            {
                "parent": names.index(link.parent) if link.parent else -1,
                "place": link.origin.translation.tolist(),
                "turn": turn.tolist(),
                "axis": link.axis.tolist(),
                "slides": link.kind == "prismatic",
                # the URDF may list the joints in another order than the case
                "column": diagnosis.arm.joints.index(link.joint),
            }
        )
    # times, positions of each arm, and the gap of each joint over its recorded torque's deviation
    first, replayed = diagnosis.traces[0], diagnosis.replayed
    name, t, arms = first.recording, first.t, {"recorded": first.q}
    if replayed is not None:
        moved = {"nominal": replayed.nominal, "corrected": replayed.corrected}
        simulated = {arm: q for arm, q in moved.items() if q is not None}
        # without a simulated arm the first recording alone
        if simulated:
            name, t = replayed.recording, replayed.t
            arms = {"recorded": replayed.recorded, **simulated}
    rate = 1.0 / float(np.median(np.diff(t)))
    kept = slice(0, None, max(1, round(rate / FRAMES_PER_SECOND)))
    times = t[kept][:MAX_FRAMES]
    # colours follow the gap of the same recording, if it is drawn at all
    trace = next((x for x in diagnosis.traces if x.recording == name), first)
    motion = {
        "recording": name,
        "t": encode(times),
        "arms": {arm: encode(q[kept][:MAX_FRAMES].ravel()) for arm, q in arms.items()},
        "gaps": {
            stage: encode(_gap(trace, stage, times).ravel())
            for stage in ("before", "after")
        },
    }
    return {
        "joints": joints,
        "reach": reach(body),
        "hulls": [
            {
                "joint": hull.body - 1,
                "vertices": encode(hull.vertices.ravel()),
                # two bytes hold the number of any vertex of a hull
                "faces": encode(hull.faces, "<u2"),
            }
            for hull in link_hulls(body)
        ],
        "motion": motion,
    }


def _gap(trace: Trace, stage: str, times: np.ndarray) -> np.ndarray:
    """Size of the gap at given times over the largest recorded deviation of each joint, (M, n)."""
    predicted = trace.nominal if stage == "before" else trace.corrected
    error = np.abs(trace.measured - predicted)
    deviation = trace.measured.std(axis=0)
    # a joint with hardly any torque would always glow
    scale = np.maximum(deviation, 0.05 * deviation.max())
    return interpolated(times, trace.t, error) / np.maximum(scale, 1e-12)


ADDING = {key: of_quantity(quantity)[0] for quantity, key in SHEET.items()}
"""Effects that add to an entry of the data sheet, by its key."""


def changed(before: float, after: float) -> str:
    """A value, and by how much it differs from that of before."""
    # no share of nothing
    if not before:
        return significant(after)
    share = round(100.0 * (after / before - 1.0))
    sign = "−" if share < 0 else "+"
    return f"{significant(after)} ({f'{sign}{abs(share)} %' if share else 'same'})"


# Parts of the report: what a part of the template shows beside the document.


FIRST_SCREEN_EFFECTS = 4
"""Effects shown with their parameters on the first screen; all of them follow below."""

LEARNT = ("rule", "interval", "line")
"""Kinds of regions that were learnt from the gap and hold a part of the motion."""

ENGINE_NAMES = {"mujoco": "MuJoCo"}
"""Engines as their makers write them."""

FLOOR_SCALE = 4.0
"""The bars' axis reaches at least this many times the highest floor, so that a healthy arm's bars look small."""


def where(document: Document) -> Document:
    """Replay gaps per joint in words, before and after, and the regions that hold most of the torque gap."""
    slides, gap = joint_slides(document), document["gap"]
    replays = [gap[stage]["replay_rmse"] or [None] * len(slides) for stage in STAGES]
    regions = document.get("where", [])
    # of each joint the region that holds most of the gap in least of the time; a band of frequency if it is all
    out: dict[int, dict[str, Any]] = {}
    # and what was learnt from its gap, and without a rule the first that was cut in advance
    known = {region["joint"] for region in regions if region.get("kind") == "rule"}
    shown = []
    for region in regions:
        joint = region["joint"]
        if region.get("kind") in LEARNT or joint not in known:
            shown.append(region)
        known.add(joint)
        out[joint] = max(out.get(joint, region), region, key=_telling)
    return {
        "regions": shown,
        "telling": list(out.values()),
        "replays": _motions(slides, *replays),
        "replayed": any(rmse is not None for rmse in replays[0]),
    }


STAGES = ("before", "after")
GAPS = (*STAGES, "floor")


def bars_end(*gaps: Mapping[str, Any], of_floor: float = 1.0) -> float:
    """End of the axis of bars: the largest gap of any joint, or so many times the highest floor [1]."""
    ends = [
        value
        for gap in gaps
        for stage in STAGES
        for value in gap[stage]["torque_nrmse"]
    ]
    floors = [value for gap in gaps for value in gap["before"]["floor"]]
    return (
        max(*(x or 0.0 for x in ends), *(of_floor * (x or 0.0) for x in floors)) or 1.0
    )


def how_far(document: Document) -> Document:
    """Means over the joints of the gap before, after and of the floor; replay gaps before and after, by engine."""
    stages = [document["gap"][stage] for stage in STAGES]
    # a joint of which one of them is not known counts in no mean
    rows = [row for row in gap_rows(document) if None not in row]
    replays = {"Replay RMSE": [stage["replay_rmse"] for stage in stages]}
    # a second engine shows whether the gap is the simulator's own
    for engine in stages[0].get("replay_elsewhere", {}):
        label = f"in {ENGINE_NAMES.get(engine, engine)}"
        replays[label] = [stage["replay_elsewhere"].get(engine) for stage in stages]
    slides = joint_slides(document)
    # over the joints that turn, or over slides if all slide: one mean over both would mean nothing
    kept = [j for j, slid in enumerate(slides) if not slid or all(slides)]
    texts = {}
    for label, gaps in replays.items():
        columns = [[_mean([gap[j] for j in kept] if gap else ())] for gap in gaps]
        texts[label] = [text for (text,) in _motions([all(slides)], *columns)]
    means = (_mean([row[i] for row in rows]) for i in range(len(GAPS)))
    return {"mean": dict(zip(GAPS, means, strict=True)), "replays": texts}


def _telling(region: Document) -> float:
    """Share times log concentration; less than any other for what only a specialist reads."""
    if region.get("kind") in ("frequency", "coherence"):
        return -1.0
    return float(region["share"] * np.log(max(region.get("enrichment") or 1.0, 1.0)))


def _mean(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _motions(slides: list[bool], *columns: list[float | None]) -> list[list[str]]:
    """Columns of angles [rad] and, of joints that slide, distances [m] as text."""
    shown = [[MISSING] * len(slides) for _ in columns]
    # one unit for all that turns, and one for all that slides
    for sliding, si_unit in ((False, "rad"), (True, "m")):
        places = [j for j, slid in enumerate(slides) if slid == sliding]
        known = [column[j] or 0.0 for column in columns for j in places]
        # the one that suits the largest
        factor, unit = display_unit(si_unit, max(known, default=0.0))
        name = unit if unit == "°" else f" {unit}"
        for texts, column in zip(shown, columns, strict=True):
            for j in places:
                value = column[j]
                if value is not None:
                    texts[j] = significant(factor * value, 2) + name
    return shown


# Renders a diagnosis into one self-contained HTML file.


def render(diagnosis: Diagnosis, path: Path | str) -> None:
    """Write the report of a diagnosis; the file loads nothing from elsewhere.

    Raises:
        GapscopeError: the document is not valid, or ``path`` cannot be written.
    """
    validate(diagnosis.document)
    # the templates take lists, not arrays
    document = plain(diagnosis.document)
    diagnosis = replace(diagnosis, document=document)

    def signatures(entry: Document) -> list[int]:
        """Numbers of the pictures of an effect."""
        return [
            index
            for index, one in enumerate(diagnosis.signatures)
            if one.effect == entry["effect"]
            # an effect without joints is drawn where it is strongest
            and (one.joint in entry["joints"] or not entry["joints"])
        ]

    # a document need not say of everything
    sides, reference = document.get("sides"), document.get("against")
    charts = sides and [sides["actuator"], sides["link"]]
    names = joint_names(document)
    # with a reference sizes are those of changes
    expected = (reference or document).get("expected", ())
    write_html(
        "diagnosis/report.html",
        path,
        words=wording,
        known_effect=known_effect,
        document=document,
        curves=payload(diagnosis) | {"arm": arm_scene(diagnosis)},
        actions=actions(diagnosis, Path(path).parent),
        changes=[capital(change_text(one)) for one in document.get("changes", ())],
        first=FIRST_SCREEN_EFFECTS,
        white=WHITE,
        signatures=signatures,
        joints=list(zip(names, short_names(names), strict=True)),
        scale=bars_end(document["gap"], of_floor=FLOOR_SCALE),
        where=where(document),
        how_far=how_far(document),
        against=reference,
        adding=ADDING,
        changed=changed,
        expected=expected_rows(expected, len(names)),
        sides=sides,
        sides_scale=charts and bars_end(*charts),
    )


# The summary of a diagnosis for a terminal, 80 columns wide.


_COLOURS = {
    "effects_found": "bold cyan",
    "no_gap": "bold green",
    "unexplained": "bold yellow",
}


def summary(document: Document) -> Group:
    """Verdict, effects, gap per joint, what is possible, what is open and the warnings."""
    parts: list[RenderableType] = []

    def say(label: str, text: str | None, style: str = "bold") -> None:
        if text:
            parts.append(Text.assemble((f"{label}:", style), " ", text))

    label = Text(VERDICTS[document["verdict"]], style=_COLOURS[document["verdict"]])
    parts.append(Text.assemble((document["case"], "bold"), ": ", label))
    parts.append(Text(verdict_sentence(document)))
    # with a reference effects are changes, which has to be said first
    if "against" in document:
        name = document["against"]["reference"]
        count = len(document["against"]["recordings"])
        text = f"{name} ({count} recording{'s' if count != 1 else ''}); effects are changes since then"
        say("Compared with", text)
    for entry in document.get("changes", []):
        say("Changed during a recording", change_text(entry))
    if document["effects"]:
        parts += ["", _effects(document)]
    # of a table of few columns a title would be cut
    title = Text("Torque gap (NRMSE, on data not used to fit)", style="bold")
    # torque NRMSE of each joint before, after, and its floor
    columns = zip(joint_names(document), gap_rows(document), strict=True)
    rows: list[Sequence[str | Text]] = [
        (str(joint), Text(name, overflow="ellipsis"), *map(nrmse, gaps))
        for joint, (name, gaps) in enumerate(columns, 1)
    ]
    table = terminal_table(("Joint", "", *GAPS), rows, 2, slice(None), **STYLE)
    table.columns[1].max_width = 30
    parts += ["", title, table]
    # without a gap a share of it means nothing
    closed = document["closed"]
    if closed is not None and document["verdict"] != "no_gap":
        parts.append(f"{percent(closed)} of the gap above the floor is closed")
    if "sides" in document:
        parts.append("")
        say("By the torque sensors", sides_sentence(document))
    if document["possible"]:
        parts.append("")
    for text in possible_texts(document):
        say("Possible, not confirmed", text)
    if document["verdict"] != "no_gap":
        parts.append("")
        say("Unexplained", unexplained_sentence(document))
    say("Nominal friction", nominal_friction_sentence(document))
    say("Dry friction builds up over", presliding_sentence(document))
    for effect in document["effects"]:
        if "gravity" in effect:
            say(MOUNTED, f"gravity: {gravity_text(effect)}")
    say("Next recording", document["next_recording"])
    for warning in document.get("warnings", []):
        say("Warning", warning, "yellow")
    return Group(*parts)


def _effects(document: Document) -> Table:
    """One row per parameter of each effect."""
    rows: list[Sequence[str | Text]] = []
    for effect in document["effects"]:
        # 'arm' for the whole arm: the column is narrow
        place = acts_on(effect).removeprefix("the whole ")
        joints = ", ".join(joint_ranges(effect["joints"]))
        if not joints or place.startswith("motor"):
            joints = place
        lines = [f"{value.name} {value.text}" for value in parameter_texts(effect)]
        texts = (capital(called(effect)), joints)
        values = "\n".join([*lines, *holds_in(effect)])
        shares = (percent(effect[key]) for key in ("probability", "share"))
        rows.append([*map(Text, (*texts, values)), *shares])
    heads = ("Effect", "Joints", "Value ± std", "Prob.", "Share")
    table = terminal_table(heads, rows, 3, slice(3, None), **STYLE)
    table.columns[0].max_width, table.columns[1].max_width = 22, 9
    return table


STYLE: dict[str, Any] = {"box": None, "padding": (0, 2, 0, 0), "header_style": "dim"}


# Names of the files of a diagnosis.


DOCUMENT, REPORT, CORRECTED = "diagnosis.json", "report.html", "corrected.yaml"
CASE, URDF = "identified_case.yaml", "identified.urdf"
"""The nominal arm that was identified on a reference."""
