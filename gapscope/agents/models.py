"""Models of an arm as a controller uses them: inverse dynamics, trained agents, and their names and files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from gapscope.arm.case import load_case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import InputError
from gapscope.arm.input_file import file_beside, is_folder
from gapscope.arm.io.json_file import read_json
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nearest_name import nearest
from gapscope.arm.nominal import NominalArm
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.corrected_file import read_corrected_arm
from gapscope.effects.effect import Effect, Inertial, Transmission
from gapscope.effects.effect import Path as TorquePath
from gapscope.envs.actions import Control


class TorqueModel(Protocol):
    """Inverse dynamics of an arm with n joints: the torque to command [N m].

    Positions are those that the encoders read.
    """

    def __call__(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torque of one sample [N m], shape (n,); q [rad], dq [rad/s], ddq [rad/s^2] of shape (n,)."""

    def series(self, motion: Motion) -> np.ndarray:
        """Torque of a motion known beforehand [N m], shape (N, n), with delay and lag compensated."""


class Gravity:
    """The nominal arm's gravity torque g(q), whatever the motion.

    Args:
        arm: the nominal arm.
    """

    def __init__(self, arm: NominalArm) -> None:
        # a controller meets each motion once
        self._body = RigidBody(arm, most_bytes=0)
        self._still = np.zeros(arm.n_joints)

    def __call__(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """g(q) [N m], shape (n,)."""
        return self._body.bias(q, self._still)

    def series(self, motion: Motion) -> np.ndarray:
        """g(q) [N m], shape (N, n)."""
        still = np.zeros_like(motion.q)
        return self._body.inverse_dynamics(motion.q, still, still)


class ArmModel:
    """Inverse dynamics of an arm with effects: nominal, identified or corrected, with its residual network.

    With N(q, dq, ddq) = M(q) ddq + C(q, dq) dq + g(q) + I ddq + friction + springs of the arm with payload, link errors
    and tilt, at the true position q = encoder - offset, what is commanded is what the way to the joint makes N of:
    (N - ripple - offset) / (1 + scale), plus the residual network. Signs are smoothed as in ``gapscope.arm.nominal``.

    ``series`` is ``CorrectedArm.predict``: delay T and lag L are undone by N(t + T) and N + L dN/dt, an elastic joint
    to first order in its twist. One sample has neither a future nor a past: evaluate it ``ahead`` of time; elasticity
    and backlash are left out, friction that drifts is that of the start, and the network takes the past to be like the
    present. An external force is left out of both, since it belongs to the recording in which it acted.

    Args:
        corrected: the arm with its effects.

    Attributes:
        ahead: how far ahead of time a single sample must be evaluated, delay plus lag per joint [s], shape (n,).

    Raises:
        InputError: an effect on a joint that does not exist, or a network of another arm.
    """

    def __init__(self, corrected: CorrectedArm) -> None:
        corrected.check()
        self._corrected = corrected.lasting
        self._nominal = RigidBody(corrected.arm, most_bytes=0)
        self._body = self._corrected.body(self._nominal)
        # delay and lag both shift torque in time, to first order
        self.ahead = corrected.quantity("delay") + corrected.quantity("lag")
        instant = tuple(e for e in self._corrected.effects if _instant(e.effect))
        self._instant = replace(self._corrected, effects=instant)

    @property
    def corrected(self) -> CorrectedArm:
        """The arm with its lasting effects."""
        return self._corrected

    def __call__(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        """Torque to command [N m], shape (n,), of one sample, each (n,)."""
        arm = self._instant
        # two equal samples: a rate exists, and what the network sees of the past is the present
        t = np.array([0.0, 1.0])
        motion = Motion(t, np.array([q, q]), np.array([dq, dq]), np.array([ddq, ddq]))
        true = arm.true_position(motion.q)[0]
        rigid = self._body.torque(true, dq, ddq)
        needed = arm.needed_torque(np.array([rigid, rigid]), motion)
        torque = arm.recorded_torque(needed, motion)
        if arm.residual is not None:
            torque = torque + arm.residual.torque(motion, torque)
        return np.asarray(torque[0])

    def series(self, motion: Motion) -> np.ndarray:
        """Torque to command [N m], shape (N, n), over a motion."""
        return self._corrected.predict(self._nominal, motion)


def _instant(effect: Effect) -> bool:
    """Whether an effect is left for a single sample to undo: those of the bodies are in the model already."""
    bodies = isinstance(effect, Inertial) and effect.scope != "joint"
    in_time = isinstance(effect, TorquePath) and effect.varies_with == "time"
    return not (bodies or in_time or isinstance(effect, Transmission))


class AgentModel(NamedTuple):
    """A trained agent beside models: a policy, and the model that it was trained on top of.

    Attributes:
        policy: action in -1 .. 1 of an observation of the environment.
        model: whose feedforward it acts on, ``None`` for PD alone.
        control: how its actions become torque.
        look_ahead: how far ahead it observes the reference [s].
        period: between its actions [s].
        digest: of its files.
    """

    policy: Callable[[np.ndarray], np.ndarray]
    model: TorqueModel | None
    control: Control
    look_ahead: tuple[float, ...]
    period: float
    digest: str


Candidate = TorqueModel | AgentModel | None
"""What is evaluated: a model, an agent on top of one, or PD alone."""


NAMES = ("pd", "gravity", "nominal")
"""Models that need no file."""


def named(entry: str) -> tuple[str, str]:
    """Name and source of ``SOURCE`` or ``NAME=SOURCE``.

    A file is called after itself; a ``corrected.yaml`` and an ``identification.json`` after their folder. The folder of
    an agent is called after itself.
    """
    name, equals, source = entry.partition("=")
    if equals:
        return name, source
    path = Path(entry)
    if is_folder(path):
        return path.resolve().name, entry
    if entry in NAMES or not path.suffix:
        return entry, entry
    # files that have this name in every folder: the folder tells them apart
    usual = path.stem in ("corrected", "identification") and path.resolve().parent.name
    return (usual or path.stem), entry


def read_models(
    entries: list[str],
    arm: NominalArm,
    read_agent: Callable[[Path, NominalArm], AgentModel],
) -> dict[str, Candidate]:
    """Models and agents by name, in their order; ``None`` is PD alone.

    Args:
        entries: each one of ``NAMES``, the path of a ``corrected.yaml`` or of an ``identification.json``, or the folder
            of a trained agent; or any of these behind ``NAME=``.
        arm: the nominal arm that a ``corrected.yaml`` belongs to, and whose joints an identified one must have.
        read_agent: reads an agent's folder; given by the caller, so that models need no learning libraries.

    Raises:
        InputError: a file is missing or no model, is of an arm with other joints, or two models have one name.
    """
    models = {}
    for entry in entries:
        name, source = named(entry)
        if not name or name in models:
            raise InputError(
                f"two models are called {name!r}", f"write NAME={source}", where="MODEL"
            )
        path = Path(source)
        models[name] = (
            read_agent(path, arm) if is_folder(path) else read_model(source, arm)
        )
    return models


def read_model(source: str, arm: NominalArm) -> TorqueModel | None:
    """One model; see ``read_models``."""
    if source == "pd":
        return None
    return Gravity(arm) if source == "gravity" else ArmModel(read_arm(source, arm))


def read_arm(source: str, arm: NominalArm) -> CorrectedArm:
    """The arm with effects of ``nominal`` or of a file; see ``read_models``."""
    if source == "nominal":
        return CorrectedArm(arm)
    path = Path(source)
    if path.suffix in (".yaml", ".yml"):
        return read_corrected_arm(arm, path)
    if path.suffix == ".json":
        # the identified arm that ``gapscope identify`` wrote beside its document
        remedy = (
            "give the identification.json that gapscope identify wrote, in its folder"
        )
        content = read_json(path, remedy)
        files = content.get("files") if isinstance(content, dict) else None
        if not isinstance(files, dict) or not {"case", "effects"} <= set(files):
            raise InputError(
                "names no files of an identified arm", remedy, file=path, where="files"
            )
        case, effects = (
            file_beside(path.parent, files[name], path, f"files.{name}")
            for name in ("case", "effects")
        )
        identified = load_case(case, read_recordings=False).arm
        if identified.joints != arm.joints:
            raise InputError(
                f"is of an arm with the joints {', '.join(identified.joints)}, not {', '.join(arm.joints)}",
                "identify the arm that is tracked, or give it as --robot",
                file=path,
            )
        # the identified arm stands where the nominal one does, with effects of its own
        return read_corrected_arm(identified, effects)
    raise InputError(
        f"unknown model {source!r}",
        f"{nearest(source, NAMES)}give {', '.join(NAMES)}, the path of a corrected.yaml or of an identification.json, "
        "or the folder of a trained agent",
        where="MODEL",
    )
