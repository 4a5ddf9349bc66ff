"""Readers under test: for each a folder of valid files, the file that is mutated, and the call that a command makes."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import fuzz_mutations as mutations
import numpy as np

from gapscope.agents.models import read_arm
from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.case_file import read_controller
from gapscope.arm.io.import_section import parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import open_log
from gapscope.arm.io.write_case import write_recording
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.diagnose_change import read_reference
from gapscope.diagnosis.document.diagnosis_json import read_document
from gapscope.effects.corrected_file import read_corrected_arm, read_with_faults
from gapscope.effects.residual import (
    Inputs,
    Layout,
    Network,
    ResidualNetwork,
    Trust,
    read_residual,
    write_residual,
)
from gapscope.many.archive import Archive, answer
from gapscope.model_audit.audit import audit_model

CORPUS = Path(__file__).with_name("corpus")
N = 60
"""Samples of the recordings, at 50 Hz."""


@dataclass(frozen=True)
class Target:
    """A reader under test.

    Attributes:
        name: of the reader.
        file: that is mutated, relative to the folder.
        make: writes the valid files into a folder.
        read: calls the reader on the folder, as a command does.
        mutate: one mutation.
        finish: what follows from the mutated file, such as a hash in another one.
        may_name_files: whether the user's own file may name other files anywhere.
    """

    name: str
    file: str
    make: Callable[[Path], None]
    read: Callable[[Path], object]
    mutate: mutations.Mutation
    finish: Callable[[Path], None] = lambda folder: None
    may_name_files: bool = False


@cache
def arm() -> NominalArm:
    """The two-joint arm of the corpus."""
    return load_nominal_arm(CORPUS / "robot.urdf")


def recording() -> Recording:
    """Both joints moving to and fro."""
    t = np.arange(N) / 50
    q = np.column_stack([np.sin(3 * t), 0.5 * np.cos(4 * t)])
    dq = np.column_stack([3 * np.cos(3 * t), -2 * np.sin(4 * t)])
    return Recording("motion.csv", t, q.round(4), (dq + 1).round(4), dq.round(4))


def copies(*names: str) -> Callable[[Path], None]:
    """Writes files of the corpus."""

    def make(folder: Path) -> None:
        for name in names:
            shutil.copyfile(CORPUS / name, folder / name)

    return make


def _write_bag(file: Path) -> None:
    """A bag of joint states as one file, MCAP or SQLite."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    types, kind = store.types, "sensor_msgs/msg/JointState"
    mcap = file.suffix == ".mcap"
    storage = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
    seed, aside = recording(), file.with_name("bag")
    with Writer(aside, version=9, storage_plugin=storage) as writer:
        connection = writer.add_connection("/joint_states", kind, typestore=store)
        for i, t in enumerate(seed.t):
            logged = round((1e9 + t) * 1e9)
            whole, rest = divmod(logged, 10**9)
            stamp = types["builtin_interfaces/msg/Time"](sec=whole, nanosec=rest)
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            fields = {"position": seed.q[i], "effort": seed.tau[i]}
            fields["velocity"] = seed.dq[i]
            message = types[kind](header=header, name=list(arm().joints), **fields)
            writer.write(connection, logged, store.serialize_cdr(message, kind))
    next(aside.glob(f"*{file.suffix}")).rename(file)
    shutil.rmtree(aside)


def _write_hdf5(file: Path) -> None:
    import h5py

    seed = recording()
    with h5py.File(file, "w") as content:
        content["t"], content["q"], content["tau"] = seed.t, seed.q, seed.tau


def _write_mat(file: Path) -> None:
    import scipy.io

    seed = recording()
    log = {"t": seed.t, "q": seed.q, "tau": seed.tau}
    content = {**log, "log": log, "cells": np.array([1, "a"], object)}
    scipy.io.savemat(file, content, do_compression=False)


def _read_log(file: Path) -> object:
    return load_recording(file, arm(), complete=True, any_unit=True)


WRITERS: dict[str, Callable[[Path], object]] = {
    "h5": _write_hdf5,
    "mat": _write_mat,
    "db3": _write_bag,
    "mcap": _write_bag,
}
"""Writers of recordings by ending; others are written by the package."""


def _log(
    ending: str,
    mutate: mutations.Mutation = mutations.of_bytes,
    name: str = "",
    read: Callable[[Path], object] = _read_log,
) -> Target:
    """A recording in one format."""
    file = f"motion.{ending}"
    write = WRITERS.get(ending, lambda path: write_recording(recording(), path))
    return Target(
        name or ending,
        file,
        lambda folder: write(folder / file),
        lambda folder: read(folder / file),
        mutate,
    )


def _bag_folder() -> Target:
    def make(folder: Path) -> None:
        _write_bag(folder / "motion.mcap")
        copies("metadata.yaml")(folder)

    mutate = mutations.either(mutations.of_yaml)
    return Target("rosbag2_metadata", "metadata.yaml", make, _read_log, mutate)


def _dataset(file: str, mutate: mutations.Mutation) -> Target:
    names = {"shape": [2], "names": [f"{joint}.pos" for joint in ("shoulder", "elbow")]}
    data = "data/chunk-000/file-000.parquet"

    def make(folder: Path) -> None:
        import pyarrow as pa
        import pyarrow.parquet as pq

        seed = recording()
        lists = {
            "observation.state": seed.q,
            "action": seed.q,
            "observation.effort": seed.tau,
        }
        columns: dict[str, Any] = {key: pa.array(list(x)) for key, x in lists.items()}
        columns |= {"timestamp": seed.t, "frame_index": np.arange(N)}
        columns["episode_index"] = np.zeros(N, int)
        (folder / data).parent.mkdir(parents=True)
        (folder / "meta").mkdir()
        pq.write_table(pa.table(columns), folder / data)
        info = {"fps": 50, "codebase_version": "v3.0"}
        info["features"] = {key: {"dtype": "float32", **names} for key in lists}
        (folder / "meta" / "info.json").write_text(json.dumps(info))

    importing = parse_import({"q": {"unit": "deg"}, "tau": {}}, 2, CORPUS)

    def read(folder: Path) -> object:
        return load_recording(folder, arm(), importing, any_unit=True)

    return Target(
        f"lerobot_{Path(file).stem[:4]}",
        data if file == "data" else file,
        make,
        read,
        mutate,
    )


def _read_robot(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        found = load_nominal_arm(folder / name)
        still = np.zeros((1, found.n_joints))
        return RigidBody(found).inverse_dynamics(still, still, still)

    return read


def _of_corpus(
    name: str,
    file: str,
    read: Callable[[Path], object],
    mutate: mutations.Mutation,
    *beside: str,
) -> Target:
    """A file of the corpus with others beside it."""
    return Target(name, file, copies(file, *beside), read, mutations.either(mutate))


def _case() -> Target:
    def make(folder: Path) -> None:
        copies("case.yaml", "robot.urdf")(folder)
        write_recording(recording(), folder / "motion.csv")

    def read(folder: Path) -> object:
        return load_case(folder, any_unit=True)

    mutate = mutations.either(mutations.of_yaml)
    return Target("case_yaml", "case.yaml", make, read, mutate, may_name_files=True)


def _read_corrected(folder: Path) -> object:
    read_with_faults(folder / "corrected.yaml")
    return read_corrected_arm(arm(), folder / "corrected.yaml")


def _read_diagnosis(folder: Path) -> object:
    archive = Archive(folder)
    answer(archive, "/")
    for entry in archive.rows():
        answer(archive, f"/units/{entry.unit}")
    return read_document(folder / "diagnosis.json")


def _address() -> Target:
    """Addresses of requests to the server."""

    def make(folder: Path) -> None:
        copies("diagnosis.json")(folder)
        (folder / "address.txt").write_text("/files/diagnosis.json?page=1")

    def read(folder: Path) -> object:
        place = folder / "address.txt"
        if not place.is_file():
            return None
        return answer(Archive(folder), place.read_bytes().decode("latin-1"))

    return Target("serve_address", "address.txt", make, read, mutations.of_bytes)


def _residual() -> Target:
    def make(folder: Path) -> None:
        n, taps, rng = 2, 2, np.random.default_rng(0)
        channels, near = Layout(n).channels, len(Layout(n).neighbourhood)
        flat = np.zeros((n, channels))
        inputs = Inputs(n, taps, 0.02, flat, flat + 1)
        seen = inputs.seen_by_mlp
        weights = tuple(rng.normal(size=(1, n, *s)) for s in ((len(seen), 2), (2, 2)))
        network = Network("mlp", seen, weights, (np.zeros((1, n, 2)),) * 2)
        trust = Trust(np.zeros((n, 2, near)), np.full(n, 50.0))
        ones = np.ones(n)
        residual = ResidualNetwork(
            inputs, (network,), np.zeros(n, int), trust, ones, ones, 12.0
        )
        write_residual(residual, folder / "residual.npz")

    def read(folder: Path) -> object:
        return read_residual(folder / "residual.npz")

    mutate = mutations.either(mutations.of_npz)
    return Target("residual_npz", "residual.npz", make, read, mutate)


def _rehashed(document: str, names: tuple[str, ...]) -> Callable[[Path], None]:
    """Writes the hashes of other files into a document, as somebody who means harm would."""

    def finish(folder: Path) -> None:
        path = folder / document
        content = json.loads(path.read_text())
        content["files"] = {name: _sha256(folder / name) for name in names}
        path.write_text(json.dumps(content))

    return finish


def _reference(file: str, mutate: mutations.Mutation) -> Target:
    names = ("reference.npz", "identified.urdf")
    target = _of_corpus(
        f"reference_{Path(file).suffix[1:]}",
        file,
        read_reference,
        mutate,
        *({"reference.json", *names} - {file}),
    )
    rehashed = _rehashed("reference.json", names)
    return replace(target, finish=rehashed) if file in names else target


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""


def _agent(file: str, mutate: mutations.Mutation) -> Target:
    names = ("policy.zip", "normalisation.npz")
    rehashed = _rehashed("agent.json", names)

    def make(folder: Path) -> None:
        from gapscope.agents.training.policy import _Spaces
        from gapscope.agents.training.task import Normalisation
        from gapscope.agents.training.training_loop import make_learner, write_weights
        from gapscope.agents.training.training_settings import TrainingSettings

        settings = TrainingSettings(network=(2,), environments=1)
        write_weights(make_learner(settings, _Spaces(6, 2)), folder / "policy.zip")
        figures = Normalisation(np.zeros(6), np.ones(6), (0, 2), (2, 4))
        figures.write(folder / "normalisation.npz")
        document = {"schema": 1, "joints": list(arm().joints), "model": "nominal"}
        document |= {"observation": {"position": 6}, "actions": 2}
        document |= {"settings": settings.plain(), "robot": "two"}
        (folder / "agent.json").write_text(json.dumps(document))
        rehashed(folder)

    def read(folder: Path) -> object:
        from gapscope.agents.training.policy import read_agent_model

        return read_agent_model(folder, arm())

    return Target(
        f"agent_{Path(file).suffix[1:]}",
        file,
        make,
        read,
        mutations.either(mutate),
        finish=rehashed if file in names else lambda folder: None,
    )


def _inspected(file: Path) -> object:
    from gapscope.inspection.inspection import inspect_logs

    return inspect_logs([open_log(file)], arm())


CORPUS_READERS: dict[str, tuple[Any, ...]] = {
    "urdf": ("robot.urdf", _read_robot("robot.urdf"), mutations.of_xml),
    "mjcf": ("robot.xml", _read_robot("robot.xml"), mutations.of_xml),
    "audit_urdf": ("robot.urdf", lambda x: audit_model(x / "robot.urdf"), mutations.of_xml),
    "audit_mjcf": ("robot.xml", lambda x: audit_model(x / "robot.xml"), mutations.of_xml),
    "controller_yaml": ("controller.yaml", lambda x: read_controller(x / "controller.yaml", 2), mutations.of_yaml),
    "corrected_yaml": ("corrected.yaml", _read_corrected, mutations.of_yaml),
    "identification_json": (
        "identification.json",
        lambda folder: read_arm(str(folder / "identification.json"), arm()),
        mutations.of_json,
        *("corrected.yaml", "case.yaml", "robot.urdf"),
    ),
    "diagnosis_json": ("diagnosis.json", _read_diagnosis, mutations.of_json),
}  # fmt: skip
"""Readers of files of the corpus: file, call, mutation, and the files beside it."""


def targets() -> dict[str, Target]:
    """All readers by name."""
    of_csv = mutations.either(mutations.of_csv)
    of_npz = mutations.either(mutations.of_npz)
    of_json = mutations.either(mutations.of_json)
    found = [
        _log("csv", of_csv),
        _log("parquet"),
        _log("npz", of_npz),
        _log("csv", of_csv, "inspect_csv", _inspected),
        _log("db3"),
        _log("mcap"),
        _bag_folder(),
        _log("h5", name="hdf5"),
        _log("mat"),
        _dataset("meta/info.json", of_json),
        _dataset("data", mutations.of_bytes),
        *(_of_corpus(name, *one) for name, one in CORPUS_READERS.items()),
        _case(),
        _address(),
        _residual(),
        _reference("reference.json", of_json),
        _reference("reference.npz", of_npz),
        _reference("identified.urdf", mutations.of_xml),
        _agent("agent.json", of_json),
        _agent("normalisation.npz", of_npz),
        _agent("policy.zip", mutations.of_bytes),
    ]
    return {target.name: target for target in found}
