"""Readers under test: for each its valid files of the corpus, the mutated one, and the call that a command makes.

The recordings of the corpus are two joints moving to and fro, 60 samples at 50 Hz.
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import fuzz_mutations as mutations
import numpy as np

from gapscope.agents.models import read_arm
from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.io.case_file import read_controller
from gapscope.arm.io.import_section import parse_import
from gapscope.arm.io.load_recording import load_recording
from gapscope.arm.io.log import open_log
from gapscope.arm.nominal import NominalArm
from gapscope.arm.robots import load_nominal_arm
from gapscope.diagnosis.diagnose_change import read_reference
from gapscope.diagnosis.document.diagnosis_json import read_document
from gapscope.effects.corrected_file import read_corrected_arm, read_with_faults
from gapscope.effects.residual import read_residual
from gapscope.inspection.inspection import inspect_logs
from gapscope.many.archive import Archive, answer
from gapscope.model_audit.audit import audit_model

CORPUS = Path(__file__).with_name("corpus")


@dataclass(frozen=True)
class Target:
    """A reader under test.

    Attributes:
        name: of the reader.
        file: that is mutated, relative to the folder.
        read: calls the reader on the folder, as a command does.
        mutate: one mutation.
        beside: files of the corpus that lie beside it.
        make: writes other valid files into a folder.
        rehashed: document into which the hashes of files are written, as somebody who means harm would; and the files.
        may_name_files: whether the user's own file may name other files anywhere.
    """

    name: str
    file: str
    read: Callable[[Path], object]
    mutate: mutations.Mutation
    beside: tuple[str, ...] = ()
    make: Callable[[Path], None] | None = None
    rehashed: tuple[str, tuple[str, ...]] = ("", ())
    may_name_files: bool = False

    def fill(self, folder: Path) -> None:
        """Write the valid files into a folder."""
        if self.make is not None:
            self.make(folder)
            return
        for name in (self.file, *self.beside):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(CORPUS / name, folder / name)

    def finish(self, folder: Path) -> None:
        """Hashes of the mutated file in the document that names it."""
        document, names = self.rehashed
        if self.file in names:
            rehash(folder / document, names)


def rehash(document: Path, names: tuple[str, ...]) -> None:
    """Write the hashes of files into a document beside them."""
    content, files = json.loads(document.read_text()), {}
    for name in names:
        path = document.parent / name
        found = hashlib.sha256(path.read_bytes() if path.is_file() else b"")
        files[name] = found.hexdigest()
    document.write_text(json.dumps(content | {"files": files}))


@cache
def arm() -> NominalArm:
    """The two-joint arm of the corpus."""
    return load_nominal_arm(CORPUS / "robot.urdf")


def read_log(path: Path) -> object:
    return load_recording(path, arm(), complete=True, any_unit=True)


def inspected(path: Path) -> object:
    return inspect_logs([open_log(path)], arm())


def read_dataset(folder: Path) -> object:
    importing = parse_import({"q": {"unit": "deg"}, "tau": {}}, 2, CORPUS)
    return load_recording(folder, arm(), importing, any_unit=True)


def read_robot(path: Path) -> object:
    found = load_nominal_arm(path)
    still = np.zeros((1, found.n_joints))
    return RigidBody(found).inverse_dynamics(still, still, still)


def read_corrected(path: Path) -> object:
    read_with_faults(path)
    return read_corrected_arm(arm(), path)


def read_diagnosis(folder: Path) -> object:
    archive = Archive(folder)
    answer(archive, "/")
    for entry in archive.rows():
        answer(archive, f"/units/{entry.unit}")
    return read_document(folder / "diagnosis.json")


def answered(folder: Path) -> object:
    """A request to the server."""
    place = folder / "address.txt"
    if not place.is_file():
        return None
    return answer(Archive(folder), place.read_bytes().decode("latin-1"))


WEIGHTS = ("policy.zip", "normalisation.npz")


def make_agent(folder: Path) -> None:
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
    rehash(folder / "agent.json", WEIGHTS)


def read_agent(folder: Path) -> object:
    from gapscope.agents.training.policy import read_agent_model

    return read_agent_model(folder, arm())


def at(read: Callable[[Path], object], name: str) -> Callable[[Path], object]:
    """The reader of a file on the folder that holds it."""
    return lambda folder: read(folder / name)


BYTES = mutations.of_bytes
CSV, NPZ, JSON, YAML, XML = (
    mutations.either(getattr(mutations, f"of_{form}"))
    for form in ("csv", "npz", "json", "yaml", "xml")
)
FRAMES = "data/chunk-000/file-000.parquet"
REFERENCE = ("reference.json", "reference.npz", "identified.urdf")


def targets() -> dict[str, Target]:
    """All readers by name."""
    logs = [("csv", CSV), ("parquet", BYTES), ("npz", NPZ), ("db3", BYTES)]
    logs += [("mcap", BYTES), ("h5", BYTES), ("mat", BYTES)]
    identified = lambda path: read_arm(str(path), arm())  # noqa: E731
    controller = lambda path: read_controller(path, 2)  # noqa: E731
    beside_identified = ("corrected.yaml", "case.yaml", "robot.urdf")
    of_files = [
        *(("hdf5" if x == "h5" else x, f"motion.{x}", read_log, m) for x, m in logs),
        ("inspect_csv", "motion.csv", inspected, CSV),
        ("residual_npz", "residual.npz", read_residual, NPZ),
        ("urdf", "robot.urdf", read_robot, XML),
        ("mjcf", "robot.xml", read_robot, XML),
        ("audit_urdf", "robot.urdf", audit_model, XML),
        ("audit_mjcf", "robot.xml", audit_model, XML),
        ("controller_yaml", "controller.yaml", controller, YAML),
        ("corrected_yaml", "corrected.yaml", read_corrected, YAML),
        ("identification_json", "identification.json", identified, JSON, *beside_identified),
    ]  # fmt: skip
    found = [
        *(Target(x, file, at(read, file), m, tuple(y)) for x, file, read, m, *y in of_files),
        Target("rosbag2_metadata", "metadata.yaml", read_log, YAML, ("motion.mcap",)),
        Target("lerobot_info", "meta/info.json", read_dataset, JSON, (FRAMES,)),
        Target("lerobot_data", FRAMES, read_dataset, BYTES, ("meta/info.json",)),
        Target("case_yaml", "case.yaml", lambda x: load_case(x, any_unit=True), YAML,
               ("robot.urdf", "motion.csv"), may_name_files=True),
        Target("diagnosis_json", "diagnosis.json", read_diagnosis, JSON),
        Target("serve_address", "address.txt", answered, BYTES, ("diagnosis.json",)),
    ]  # fmt: skip
    for file, mutate in zip(REFERENCE, (JSON, NPZ, XML), strict=True):
        others = tuple(x for x in REFERENCE if x != file)
        hashes = {"rehashed": (REFERENCE[0], REFERENCE[1:])}
        name = f"reference_{file.split('.')[-1]}"
        found.append(Target(name, file, read_reference, mutate, others, **hashes))
    for file, mutate in (("agent.json", JSON), (WEIGHTS[1], NPZ), (WEIGHTS[0], BYTES)):
        made = {"make": make_agent, "rehashed": ("agent.json", WEIGHTS)}
        name = f"agent_{file.split('.')[-1]}"
        found.append(Target(name, file, read_agent, mutate, **made))
    return {target.name: target for target in found}
