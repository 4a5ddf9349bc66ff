"""Recordings of real arms as carriers of known effects: read, put right, cut, identified; see ``26_real_benchmark.py``.

A carrier is a healthy arm whose recordings are as nature made them. What its case states wrongly is put right here, so
that the unchanged recording is a healthy case; references (``q_ref``) are left out, since injected effects would change
them in a way that nobody knows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from zlib import crc32

import numpy as np
import yaml
from real_identified import identified, left, model_residual
from scipy.signal import butter, sosfiltfilt

from gapscope.arm.case import Case, load_case
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.io.json_file import read_json, write_json
from gapscope.arm.io.write_case import write_case
from gapscope.arm.recording import Recording

CASES = Path(__file__).parent / "cases"
ARMS = {
    "tx40": "staubli_tx40",
    "ur10": "ur10",
    "kinova": "kinova_gen3_current",
    "panda": "panda",
    "kuka": "kuka_med7",
    "z1": "unitree_z1",
}
"""Carriers by their short names, each with its file in ``experiments/cases``."""
FASTEST = 1000.0
"""Recordings sampled faster are decimated towards this rate [Hz]; a diagnosis needs no more than 250 Hz."""
REGULAR_WINDOWS = ((0.55, 1.0), (0.0, 0.45))
"""The piece that carries the effect in the first two cuts, as shares of the recording [1]."""
WINDOW = (0.3, 0.5)
"""Share of the recording that this piece is in all other cuts [1]."""
SHORTEST_PIECE = 2.0
"""A piece of a recording is no shorter than this [s]."""
HEALTHY = 2.5
"""The arm identified on the reference leaves at most so many times what a model of the whole motion does [1]."""
CANDIDATES = 8
"""Cuts that are tried for a healthy one; if none is, the best is taken."""
MOVED, REST = 0.02, 1.0
"""An arm rests that moved by less than this [rad]; so much of its rests before and after the motion is kept [s]."""
UNIDENTIFIED = 1e6
"""Ratio of a cut from whose reference nothing can be identified [1]."""
WINDOW_FILE = "window.json"
"""Says which piece was cut out."""
CUT_FILES = ("reference", "identified")
"""Folders of a cut: the reference as a case, and the other piece with the identified arm as its nominal one."""


def load_carrier(arm: str, folder: Path) -> Case:
    """The carrier of a short name, its whole recordings; a copy of its case file is written into a folder."""
    source = CASES / f"{ARMS[arm]}.yaml"
    content = yaml.safe_load(source.read_text(encoding="utf-8"))
    # the whole recording, not only the rows that the case sets aside for fitting and judging
    content.get("import", {}).pop("rows", None)
    file = folder / "whole.yaml"
    with atomic_write(file) as aside:
        aside.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    case = load_case(file)
    recordings = tuple(_prepared(r) for r in case.recordings)
    case = replace(case, name=arm, recordings=recordings, judged=(), controller=None)
    return _put_right(case) if arm == "kuka" else case


def _prepared(recording: Recording) -> Recording:
    """A recording without references and long rests at its ends, at no more than ``FASTEST``."""
    recording = replace(recording, q_ref=None, dq_ref=None, notes=())
    first, last = (recording.q[[k]] for k in (0, -1))
    moved = np.abs(recording.q - first).max(axis=1) > MOVED
    to_move = np.abs(recording.q - last).max(axis=1) > MOVED
    begin = recording.t[moved.argmax()] - REST
    end = recording.t[len(to_move) - 1 - to_move[::-1].argmax()] + REST
    moving = (recording.t >= begin) & (recording.t <= end)
    recording = rows(recording, moving, recording.name)
    every = int(recording.rate / FASTEST + 0.5)
    if every < 2:
        return recording
    sos = butter(4, 0.4 / every * 2, output="sos")

    def fewer(series: np.ndarray | None) -> np.ndarray | None:
        return None if series is None else sosfiltfilt(sos, series, axis=0)[::every]

    names = ("q", "dq", "tau", "tau_sensor", "temperature")
    changed = {name: fewer(getattr(recording, name)) for name in names}
    return replace(recording, t=recording.t[::every], **changed)


def _put_right(case: Case) -> Case:
    """The KUKA: its torques count the other way than its URDF, whose friction is a placeholder."""
    n = case.arm.n_joints
    arm = replace(case.arm, coulomb=np.zeros(n), viscous=np.zeros(n))
    turned = tuple(replace(r, tau=-np.asarray(r.tau)) for r in case.recordings)
    return replace(case, arm=arm, recordings=turned)


Window = tuple[float, float]
"""Begin and end of a piece, as shares of the recording [1]."""


def windows(case: Case, number: int, seed: int) -> list[Window]:
    """Candidates for a cut of the longest recording: the pieces that may carry the effect.

    The first two cuts try the end and the beginning first; all else is drawn.
    """
    rng = np.random.default_rng([seed, crc32(case.name.encode()), number])
    length = max(r.duration for r in case.recordings)
    least = SHORTEST_PIECE / length
    out = list(REGULAR_WINDOWS[number : number + 1])
    while len(out) < CANDIDATES:
        share = max(float(rng.uniform(*WINDOW)), least)
        start = float(rng.uniform(0.0, 1.0 - share))
        # what is left at either end is long enough for a piece, or belongs to this one
        start = 0.0 if start < least else start
        end = 1.0 if start + share > 1.0 - least else start + share
        out.append((start, end))
    return out


def cut(case: Case, window: Window) -> tuple[Case, Case]:
    """Two cases of a carrier: the reference, all but one piece of the longest recording; and that piece."""
    longest = max(case.recordings, key=lambda r: r.duration)
    others = tuple(r for r in case.recordings if r is not longest)
    share = (longest.t - longest.t[0]) / longest.duration
    before, after = share < window[0], share > window[1]
    rest = [
        rows(longest, chosen, name)
        for chosen, name in ((before, "before"), (after, "after"))
        if chosen.any()
    ]
    piece = rows(longest, ~before & ~after, "piece")
    reference = replace(case, recordings=(*rest, *others))
    return reference, replace(case, recordings=(piece,))


def rows(recording: Recording, chosen: np.ndarray, name: str) -> Recording:
    """Some rows of a recording, its time from zero, under another name."""
    channels = {
        key: None
        if getattr(recording, key) is None
        else getattr(recording, key)[chosen]
        for key in ("q", "dq", "tau", "tau_sensor", "temperature")
    }
    t = recording.t[chosen]
    return replace(recording, name=name, t=t - t[0], **channels)


@dataclass(frozen=True)
class Prepared:
    """What was prepared of one carrier and one cut of it.

    Attributes:
        carrier: the whole carrier.
        whole: the whole carrier with the arm identified on all of it as the nominal one.
        reference, case: the two pieces with the published arm.
        identified: the second piece with the arm identified on the first.
    """

    carrier: Case
    whole: Case
    reference: Case
    case: Case
    identified: Case


def prepare_arm(arm: str, out: Path) -> None:
    """Identify a carrier on all of its recordings, unless that was done."""
    folder = out / "carriers" / arm
    if not (folder / "whole" / "case.yaml").is_file():
        carrier = load_carrier(arm, folder)
        identified(carrier, carrier, folder / "whole")


def prepare_cut(arm: str, number: int, seed: int, out: Path) -> None:
    """Write reference, identified arm and window of one cut, unless they are there; the first healthy candidate."""
    folder = cut_folder(arm, number, out)
    if (folder / WINDOW_FILE).is_file():
        return
    carrier = load_carrier(arm, out / "carriers" / arm)
    least = model_residual(carrier)
    tried: list[tuple[float, Window]] = []
    for window in windows(carrier, number, seed):
        ratio = _write_cut(carrier, number, window, least, folder)
        tried.append((ratio, window))
        if ratio <= HEALTHY:
            break
    ratio, window = min(tried)
    if tried[-1] != (ratio, window):
        _write_cut(carrier, number, window, least, folder)
    write_json({"window": window, "ratio": ratio}, folder / WINDOW_FILE)


def _write_cut(
    carrier: Case, number: int, window: Window, least: np.ndarray, folder: Path
) -> float:
    """Write the cases of a cut, and how far its piece is from healthy: largest ratio over the joints [1]."""
    reference, piece = cut(carrier, window)
    named = replace(reference, name=f"{carrier.name}_reference_{number}")
    write_case(named, folder / CUT_FILES[0], overwrite=True)
    try:
        identified(reference, piece, folder / CUT_FILES[1])
    except GapscopeError:
        # nothing can be identified from this reference
        return UNIDENTIFIED
    return float((left(load_case(folder / CUT_FILES[1])) / least).max())


def cut_folder(arm: str, number: int, out: Path) -> Path:
    """Folder of one cut."""
    return out / "carriers" / arm / f"cut_{number}"


def load_prepared(arm: str, number: int, out: Path) -> Prepared:
    """What ``prepare_arm`` and ``prepare_cut`` wrote."""
    carrier = load_carrier(arm, out / "carriers" / arm)
    chosen = read_json(cut_folder(arm, number, out) / WINDOW_FILE, "--step make")
    reference, case = cut(carrier, tuple(chosen["window"]))
    return Prepared(
        carrier,
        load_case(out / "carriers" / arm / "whole"),
        reference,
        case,
        load_case(cut_folder(arm, number, out) / CUT_FILES[1]),
    )


def cut_residual(prepared: Prepared) -> np.ndarray:
    """RMS that full models leave on the piece that carries the effect [N m], (n,).

    The larger one, joint by joint, of a model of the whole motion, and of the arm identified on the other piece.
    """
    return np.maximum(model_residual(prepared.carrier), left(prepared.identified))
