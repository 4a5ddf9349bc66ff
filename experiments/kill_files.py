"""What ``49_kills.py`` disturbs: small inputs of each command, and how folders of results are compared."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import sys
import zipfile
from itertools import zip_longest
from pathlib import Path

import numpy as np
import pandas as pd
import yaml

URDF_LINK = """<link name="link_{k}"><inertial><origin xyz="0.1 0 0.02"/><mass value="{mass}"/>
<inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="joint_{k}" type="revolute"><parent link="link_{parent}"/><child link="link_{k}"/><origin xyz="{x} 0 0.1"/>
<axis xyz="{axis}"/><limit lower="-2" upper="2" velocity="3" effort="80"/></joint>"""
EFFECTS = {
    "schema": 1,
    "effects": [
        {
            "effect": "viscous_friction",
            "joints": [2],
            "parameters": {"coefficient": [3.0]},
        }
    ],
}
AGENT = {
    "algorithm": "ppo",
    "steps": 192,
    "round_steps": 64,
    "environments": 1,
    "network": [8],
    "motion": "fourier",
    "motions": ["fourier"],
    "episode_length": 0.4,
    "duration": 0.4,
    "hyperparameters": {"n_steps": 64, "batch_size": 64},
}
RECORD = ["--recordings", "2", "--duration", "5", "--rate", "100"]
NO_CASES = [
    "--singles",
    "0",
    "--pairs",
    "0",
    "--triples",
    "0",
    "--outside",
    "0",
    "--ladder",
    "0",
]
COMMANDS = (
    "record",
    "diagnose",
    "diagnose several",
    "identify",
    "train",
    "evaluate",
    "blind run",
    "fleet",
    "residual",
)
UNFINISHED = {
    "diagnose several": ("summary.html", "units.json"),
    "blind run": ("frozen.json",),
    "train": ("checkpoints/", "tensorboard/"),
    "evaluate": ("unfinished/",),
}
"""What a command keeps to go on from, what it writes line by line, and summaries, which list cases that failed."""
EVENTS = "tfevents"
"""In the names of TensorBoard's files: one for each process that trained."""
ID = re.compile(r"[0-9a-f]{8,}|\d{9,}")


def commands(folder: Path) -> dict[str, list[str]]:
    """Arguments of each command without ``--out``; makes their inputs."""
    robot, effects, agent = (
        folder / name for name in ("robot.urdf", "effects.yaml", "agent.yaml")
    )
    if not (folder / "done").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        robot.write_text(_urdf())
        effects.write_text(yaml.safe_dump(EFFECTS))
        agent.write_text(yaml.safe_dump(AGENT))
        for k in "12":
            case = folder / "cases" / f"case{k}"
            if not case.is_dir():
                _gapscope("record", robot, "--effects", effects, *RECORD, "--seed", k, "--out", case)  # fmt: skip
        _gapscope(
            "blind", "make", "--robots", "small", *NO_CASES, "--healthy", "2", "--seed", "1", "--out", folder / "blind"
        )  # fmt: skip
        # a run refuses to start if it can read the labels, wherever they are
        shutil.rmtree(folder / "blind-labels")
        (folder / "done").touch()
    cases = [folder / "cases" / f"case{k}" for k in "12"]
    asked: dict[str, list[object]] = {
        "record": ["record", robot, "--effects", effects, *RECORD, "--seed", 3],
        "diagnose": ["diagnose", cases[0]],
        "diagnose several": ["diagnose", *cases],
        "identify": ["identify", cases[0]],
        "train": ["train", "nominal", "--robot", robot, "--agent", agent],
        "evaluate": ["evaluate", "pd", "nominal", "--robot", robot, "--effects", effects, "--engine", "mujoco",
                     "--motions", "fourier", "--disturbances", "none", "--seeds", 2, "--duration", 1],
        "blind run": ["blind", "run", folder / "blind"],
        "fleet": ["fleet", folder / "cases"],
        "residual": ["residual", cases[0]],
    }  # fmt: skip
    return {name: [str(word) for word in words] for name, words in asked.items()}


def _gapscope(*arguments: object) -> None:
    words = [str(argument) for argument in arguments]
    subprocess.run([sys.executable, "-m", "gapscope", *words], check=True)


def _urdf() -> str:
    """An arm of three joints."""
    axes = ("0 0 1", "0 1 0", "0 1 0")
    links = [
        URDF_LINK.format(k=k, parent=k - 1, mass=4 - k, axis=axis, x=0.3 * (k > 1))
        for k, axis in enumerate(axes, start=1)
    ]
    return f'<robot name="three"><link name="link_0"/>{"".join(links)}</robot>'


def bytes_in(folder: Path) -> int:
    """Size of all files."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def finals(folder: Path) -> list[str]:
    """Files with a final name, relative to the folder: neither they nor a folder of theirs are hidden."""
    if not folder.is_dir():
        return []
    found = [path.relative_to(folder) for path in folder.rglob("*") if path.is_file()]
    return sorted(
        path.as_posix() for path in found if not any(p[0] == "." for p in path.parts)
    )


def leftovers(folder: Path) -> list[str]:
    """Hidden files and folders at or beside the results."""
    return sorted(path.name for path in folder.parent.rglob(".*"))


def cut_short(command: str, folder: Path, whole: list[Path]) -> list[str]:
    """Files that cannot be read, or differ from those of undisturbed runs under the same name."""
    known = {_plain(name): name for name in finals(whole[0])}
    wrong = []
    for name in finals(folder):
        grows = name.startswith(UNFINISHED.get(command, ()))
        if EVENTS not in name and not parses(folder / name):
            wrong.append(f"{name} cannot be read")
        elif not grows and _plain(name) in known and not _alike(name, folder, whole):
            wrong.append(f"{name} differs")
    return wrong


def unlike(folder: Path, whole: list[Path]) -> list[str]:
    """Files that are missing, too many or different, compared with undisturbed runs."""
    names = {_plain(name): name for name in finals(folder) if EVENTS not in name}
    known = {_plain(name) for name in finals(whole[0]) if EVENTS not in name}
    wrong = [f"{name} is {'missing' if name in known else 'too many'}" for name in known ^ set(names)]  # fmt: skip
    for plain in sorted(known & set(names)):
        if not _alike(names[plain], folder, whole):
            wrong.append(f"{names[plain]} differs")
    return wrong


def _plain(name: str) -> str:
    """A name without what is drawn for each run."""
    return ID.sub("ID", name)


def _alike(name: str, folder: Path, whole: list[Path]) -> bool:
    """Whether a file equals that of undisturbed runs wherever these equal each other."""
    texts = [(folder / name).read_bytes()]
    for other in whole:
        named = [found for found in finals(other) if _plain(found) == _plain(name)]
        if not named:
            return True  # not made by every undisturbed run
        texts.append((other / named[0]).read_bytes())
    mine, first, second = texts
    if first == second:
        return mine == first
    if Path(name).suffix in (".parquet", ".zip", ".npz"):
        return True  # holds stamps, and compressed; it was read
    lines = zip_longest(*(text.splitlines() for text in texts))
    return all(m == a for m, a, b in lines if a == b)


def parses(path: Path) -> bool:
    """Whether a file can be read to its end."""
    content = path.read_bytes()
    try:
        if path.suffix == ".json":
            json.loads(content)
        elif path.suffix == ".jsonl":
            [json.loads(line) for line in content.splitlines()]
        elif path.suffix in (".yaml", ".yml"):
            assert yaml.safe_load(content) is not None
        elif path.suffix == ".npz":
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                [arrays[key] for key in arrays]
        elif path.suffix == ".zip":
            assert zipfile.ZipFile(io.BytesIO(content)).testzip() is None
        elif path.suffix == ".parquet":
            pd.read_parquet(io.BytesIO(content))
        elif path.suffix in (".html", ".urdf"):
            assert content.rstrip().endswith((b"</html>", b"</robot>"))
        return bool(content)
    except Exception:
        # readers raise what they like at a file that is cut short
        return False
