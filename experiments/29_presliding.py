"""Presliding: what the corrected arm closes on withheld recordings with it and without.

    .venv/bin/python experiments/29_presliding.py --out out/presliding --jobs 2

Cases of the blind check's generator, whose friction is LuGre's and others', not the catalogue's, are diagnosed; the
corrected arm then predicts the recording that was withheld, with the presliding that was found and without. Printed for
each effect: cases, median of the torque NRMSE of the joints above their floor before, after without and after with
presliding, and how often presliding made it better and worse by more than 1 %. A run that was interrupted goes on.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import yaml
from joblib import Parallel, delayed

import gapscope
from gapscope.arm.io.json_file import read_json
from gapscope.blind_check.make import make
from gapscope.blind_check.plan import BlindPlan
from gapscope.blind_check.scoring.closure import closure

EFFECTS = ("coulomb_friction", "stribeck_friction", "load_friction")
COLUMNS = f"{'effect':<18} {'cases':>5} {'before':>7} {'without':>8} {'with':>6} {'better':>7} {'worse':>6}"


class Closed(NamedTuple):
    """Mean torque NRMSE over the joints above their floor: before, after without and with presliding."""

    before: float
    without: float
    bent: float


def diagnosed(case: Path, results: Path) -> None:
    """Diagnose a case, unless that was done."""
    if not (results / case.name / "diagnosis.json").exists():
        gapscope.diagnose(case).save(results / case.name)
        print(f"{case.name} diagnosed", flush=True)


def closed(name: str, label: dict, cases: Path, labels: Path, results: Path) -> Closed:
    """The gap of one case; NaN if no joint is above its floor."""
    floor = np.array(label["floor"])
    file = results / name / "corrected.yaml"
    unseen = labels / "unseen" / f"{name}.csv"
    bent = closure(cases / name, unseen, file, floor)
    with TemporaryDirectory() as folder:
        plain = Path(folder) / "corrected.yaml"
        content = yaml.safe_load(file.read_text())
        content.pop("presliding", None)
        plain.write_text(yaml.safe_dump(content))
        without = closure(cases / name, unseen, plain, floor)
    if bent is None or without is None:
        return Closed(np.nan, np.nan, np.nan)
    above = np.array(bent["before"]) > 2 * floor
    stages = bent["before"], without["after"], bent["after"]
    return Closed(*(float(np.array(stage)[above].mean()) for stage in stages))


def line(effect: str, found: list[Closed]) -> str:
    """One line of the table."""
    values = np.array([c for c in found if np.isfinite(c.before)])
    before, without, bent = np.median(values, axis=0)
    ratio = values[:, 2] / values[:, 1]
    better, worse = (ratio < 0.99).sum(), (ratio > 1.01).sum()
    return f"{effect:<18} {len(values):5d} {before:7.3f} {without:8.3f} {bent:6.3f} {better:7d} {worse:6d}"


def main() -> None:
    """Make, diagnose and measure; prints the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("out/presliding"))
    parser.add_argument("--per-effect", type=int, default=8)
    parser.add_argument("--seed", type=int, default=29)
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    cases, labels, results = (args.out / n for n in ("cases", "labels", "results"))
    plan = BlindPlan(
        singles=args.per_effect * len(EFFECTS),
        pairs=0,
        triples=0,
        outside=0,
        healthy=0,
        ladder=0,
        effects=EFFECTS,
    )
    make(cases, plan, seed=args.seed, labels=labels, jobs=args.jobs, progress=print)
    folders = sorted(path for path in cases.iterdir() if path.is_dir())
    Parallel(args.jobs)(delayed(diagnosed)(path, results) for path in folders)
    truth = read_json(labels / "labels.json", "make the cases again")["cases"]
    print(COLUMNS)
    for effect in EFFECTS:
        names = [n for n, x in truth.items() if x["effects"][0]["effect"] == effect]
        found = [closed(n, truth[n], cases, labels, results) for n in sorted(names)]
        print(line(effect, found))


if __name__ == "__main__":
    main()
