"""Which cases the benchmark of real arms has, and how one is made; see ``26_real_benchmark.py``.

Everything is drawn from the seed, the arm, the mode and the number of the case: a run on some arms has the same cases
as one on all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from real_carriers import ARMS, CUT_FILES, cut_folder, cut_residual, load_prepared
from real_case_files import write_piece
from real_injections import LAWS, Injection, compatible, draw, inject
from real_scene import Scene

from gapscope.arm.io.json_file import read_json, write_json

MODES = ("against", "plain")
SIZES = (2.5, 4.0, 8.0)
"""RMS of an effect over what a full model leaves [1]."""
COUNTS = {"healthy": 3, "single": 5, "pair": 1}
FULL_COUNTS = {"healthy": 12, "single": 20, "pair": 4}
"""Cases per arm and mode, by kind."""
PAIR_ATTEMPTS = 12
"""Second effects that are tried for a pair."""


@dataclass(frozen=True)
class Planned:
    """One case to be made.

    Attributes:
        arm: short name of the carrier.
        mode: ``against`` a reference, or ``plain`` with the identified arm as the nominal one.
        kind: ``healthy``, ``single`` or ``pair``.
        number: within arm, mode and kind, from 0.
        size: RMS of each effect over what a full model leaves [1]; 0 if healthy.
    """

    arm: str
    mode: str
    kind: str
    number: int
    size: float

    @property
    def name(self) -> str:
        """Name of the case; it says nothing of the truth but the kind of carrier."""
        first = {"healthy": 100, "single": 200, "pair": 300}[self.kind]
        scrambled = crc32(f"{self.arm} {self.mode} {first + self.number}".encode())
        return f"{self.arm}_{self.mode}_{scrambled % 0xFFFFFF:06x}"

    @property
    def cut(self) -> int:
        """Number of the cut: each healthy case has its own, cases with an effect share the first three."""
        return self.number if self.kind == "healthy" else (self.number + 1) % 3


def counts(per_arm: int | None, full: bool) -> dict[str, int]:
    """Cases by kind for a total per arm and mode: a third healthy, a ninth pairs."""
    if per_arm is None:
        return FULL_COUNTS if full else COUNTS
    healthy, pairs = -(-per_arm // 3), per_arm // 9
    return {"healthy": healthy, "single": per_arm - healthy - pairs, "pair": pairs}


def planned(
    arms: list[str], modes: list[str], sizes: list[float], number: dict[str, int]
) -> list[Planned]:
    """All cases, arm by arm."""
    out = []
    for arm in arms:
        for mode in modes:
            for kind, count in number.items():
                for k in range(count):
                    # every arm and mode begins with another size
                    first = k + list(ARMS).index(arm) + MODES.index(mode)
                    size = 0.0 if kind == "healthy" else sizes[first % len(sizes)]
                    out.append(Planned(arm, mode, kind, k, size))
    return out


def make_case(plan: Planned, seed: int, out: Path) -> None:
    """Write one case, and its truth beside the cases, unless both are there."""
    truth = out / "truth" / f"{plan.name}.json"
    folder = out / "cases" / plan.name
    if truth.is_file() and (folder / "case.yaml").is_file():
        return
    prepared = load_prepared(plan.arm, plan.cut, out)
    base = prepared.case if plan.mode == "against" else prepared.identified
    healthy = Scene(
        base.recordings[0],
        # a comparison identifies the arm itself
        prepared.whole.arm if plan.mode == "against" else base.arm,
        prepared.whole.arm,
        cut_residual(prepared, plan.mode == "against"),
    )
    injections = drawn(plan, seed, healthy)
    recording, entries = inject(healthy, injections)
    recording = replace(recording, name="recording")
    case = replace(base, name=plan.name, recordings=(recording,))
    write_piece(case, folder)
    write_json(label(plan, healthy, injections, entries), truth)


def drawn(plan: Planned, seed: int, healthy: Scene) -> list[Injection]:
    """The effects of a case: the next ones in an order of all effects that this carrier can have."""
    if plan.kind == "healthy":
        return []
    place = [MODES.index(plan.mode), 0 if plan.kind == "single" else 1, plan.number]
    rng = np.random.default_rng([seed, crc32(plan.arm.encode()), *place])
    if plan.kind == "single":
        return [first_possible(order(plan, seed), plan.size, healthy, rng)]
    for _ in range(PAIR_ATTEMPTS):
        names = [str(name) for name in rng.permutation(list(LAWS))]
        first = first_possible(names, plan.size, healthy, rng)
        others = [n for n in names if compatible(first.law.name, n)]
        if others:
            return [first, first_possible(others, plan.size, healthy, rng)]
    raise RuntimeError(f"no pair of effects is possible on {plan.arm}")


def order(plan: Planned, seed: int) -> list[str]:
    """Effects to try for a single one, so that all occur about equally often and none twice among five cases.

    A permutation of all effects is turned on by five from one arm and mode to the next; of five cases the first tries
    every fifth name from the first on, the second every fifth from the second on, and so on.
    """
    group, place = divmod(plan.number, COUNTS["single"])
    names = np.random.default_rng([seed, group]).permutation(list(LAWS))
    arm, mode = list(ARMS).index(plan.arm), MODES.index(plan.mode)
    turned = np.roll(names, -(len(MODES) * arm + mode) * COUNTS["single"])
    first = turned[place :: COUNTS["single"]]
    return [str(name) for name in (*first, *turned)]


def first_possible(
    names: list[str], size: float, healthy: Scene, rng: np.random.Generator
) -> Injection:
    """The first of some effects that the carrier can have in a size."""
    for name in names:
        found = draw(healthy, name, size, rng)
        if found is not None:
            return found
    raise RuntimeError(f"no effect of {size} times the residual is possible")


def label(
    plan: Planned,
    healthy: Scene,
    injections: list[Injection],
    entries: list[dict[str, Any]],
) -> dict[str, Any]:
    """The truth of a case, in the form that ``gapscope.blind_check.scoring`` reads."""
    sized = any(one.law.place != "none" for one in injections)
    ratios = [
        (healthy.gap(one.applied(healthy, healthy.recording)[0]) / healthy.residual)
        if one.law.stage < 7
        else np.zeros(healthy.n)
        for one in injections
    ]
    return {
        "kind": plan.kind,
        "effects": entries,
        "forms": [one.law.form for one in injections],
        "gap": np.max([np.zeros(healthy.n), *ratios], axis=0).tolist(),
        "residual": healthy.residual.tolist(),
        "motions": ["slow", "slow"],
        "severity": [plan.size, plan.size] if injections else None,
        "measure": "torque" if sized else "none",
        "conditions": {
            "robot": plan.arm,
            "mode": plan.mode,
            "cut": plan.cut,
            "size": plan.size,
        },
    }


def read_truth(plan: Planned, out: Path) -> dict[str, Any]:
    """The truth of a case."""
    file = out / "truth" / f"{plan.name}.json"
    return dict(read_json(file, "make the cases first, --step make"))


def reference_of(plan: Planned, out: Path) -> Path:
    """Folder of the reference of a case."""
    return cut_folder(plan.arm, plan.cut, out) / CUT_FILES[0]
