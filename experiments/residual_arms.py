"""Arms of the blind check's generator with one remainder each, for ``14_residual_network.py``.

Eight recordings of 10 s: six to fit, two to judge. The data sheet and the bodies of the nominal arm are those of the
simulated one, so that the gap is the remainder and the small imperfections of a healthy arm (presliding, Stribeck
friction, viscous friction that bends, encoder noise). The remainder is on every joint, at the size that the generator
draws before it sizes an effect for a class of severity.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.nominal import NominalArm
from gapscope.arm.recording import Recording
from gapscope.arm.robots import load_nominal_arm
from gapscope.blind_check.generator.case_setup import CaseSetup, draw_setup, sheet_of
from gapscope.blind_check.generator.conditions import Conditions
from gapscope.blind_check.generator.law import Cause
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.measure import nominal_torque
from gapscope.blind_check.generator.motions import draw_motion
from gapscope.effects.corrected import CorrectedArm
from gapscope.ident.residual.trajectory import Trajectory, from_segment
from gapscope.model.conditioning import condition, position_cutoff

REMAINDERS = {
    "posture_friction": "position_dependent_friction",
    "coupling": "joint_coupling",
    "hysteresis": "hysteresis",
    "transmission_error": "torque_ripple",
    "thermal_fading": "fading_torque_constant",
}
"""Kinds of remainder, and the generator's law of each."""
ARMS = ("ur5_like", "franka_panda")
"""An arm with six joints and one with seven."""
KINDS = (
    "slow",
    "middle",
    "point_to_point",
    "fast",
    "middle",
    "crawl",
    "middle",
    "point_to_point",
)
"""Motions of the recordings; the last two judge."""
JUDGED = 2
"""Recordings set aside."""
DURATION = 10.0
"""Of a recording [s]."""
WAVE = 0.3
"""Amplitude of the wave, over the deviation of a joint's torque [1]."""
ATTEMPTS = 20
"""Draws of an arm with its remainder until the loop runs well."""


def simulated(
    arm: str, remainder: str, seed: int, folder: Path
) -> tuple[list[Trajectory], list[Trajectory]]:
    """Trajectories to fit and to judge of an arm with a remainder; its URDF is written into ``folder``."""
    rng = np.random.default_rng(
        (14, ARMS.index(arm), list(REMAINDERS).index(remainder), seed)
    )
    for _ in range(ATTEMPTS):
        setup = _with_motions(draw_setup(Conditions(arm), rng), rng)
        recordings = None if setup is None else _recorded(setup, remainder, rng)
        if setup is not None and recordings is not None:
            return _trajectories(_nominal(setup, folder), recordings)
    raise RuntimeError(f"no {arm} with {remainder} ran well in {ATTEMPTS} draws")


def waved(
    arm: str, seed: int, folder: Path
) -> tuple[list[Trajectory], list[Trajectory]]:
    """The same of a healthy arm whose recorded torque holds A_j sin(3 q_j) tanh(dq_j / 0.1) besides.

    A_j is ``WAVE`` times the deviation of the joint's torque.
    """
    rng = np.random.default_rng((15, ARMS.index(arm), seed))
    for _ in range(ATTEMPTS):
        setup = _with_motions(draw_setup(Conditions(arm), rng), rng)
        recordings = None if setup is None else _recordings(setup, ())
        if setup is not None and recordings is not None:
            torque = np.concatenate([np.asarray(r.tau) for r in recordings])
            size = WAVE * torque.std(axis=0)
            added = [_with_wave(recording, size) for recording in recordings]
            return _trajectories(_nominal(setup, folder), added)
    raise RuntimeError(f"no healthy {arm} ran well in {ATTEMPTS} draws")


def _with_wave(recording: Recording, size: np.ndarray) -> Recording:
    """A recording with a wave of some size [N m], (n,), in its torque."""
    assert recording.tau is not None
    speed = np.gradient(recording.q, recording.t, axis=0)
    # the derivative of noisy encoders is smoothed over 20 ms
    width = max(1, round(0.02 * recording.rate))
    smooth = uniform_filter1d(speed, width, axis=0)
    wave = size * np.sin(3.0 * recording.q) * np.tanh(smooth / 0.1)
    return replace(recording, tau=recording.tau + wave)


def _with_motions(
    setup: CaseSetup | None, rng: np.random.Generator
) -> CaseSetup | None:
    """The setup with the motions of ``KINDS``, fed forward with the nominal torque."""
    if setup is None:
        return None
    motions = [
        draw_motion(kind, setup.arm, DURATION, setup.loop.rate, rng) for kind in KINDS
    ]
    sheet = sheet_of(setup.arm)
    ahead = [nominal_torque(setup.model, sheet, m.t, m.q) for m in motions]
    noise = [setup.healthy.noise * rng.standard_normal(m.q.shape) for m in motions]
    return replace(setup, motions=motions, kinds=list(KINDS), ahead=ahead, noise=noise)


def _recorded(
    setup: CaseSetup, remainder: str, rng: np.random.Generator
) -> list[Recording] | None:
    """The recordings with the remainder on every joint; ``None`` if a loop does not run well."""
    law = LAWS[REMAINDERS[remainder]]
    joints = np.arange(1 if law.joints == "later" else 0, setup.arm.n)
    cause = Cause(law, joints, law.draw(rng, setup.context, joints))
    return _recordings(setup, (cause,))


def _recordings(setup: CaseSetup, causes: tuple[Cause, ...]) -> list[Recording] | None:
    """The recordings with some causes; ``None`` if a loop does not run well."""
    rows = [setup.run(setup.plant(causes), k) for k in range(len(KINDS))]
    if any(recorded is None for recorded in rows):
        return None
    return [
        Recording(f"{kind}_{k}", recorded["t"], recorded["q"], recorded["tau"])
        for k, (kind, recorded) in enumerate(zip(KINDS, rows, strict=True))
        if recorded is not None
    ]


def _nominal(setup: CaseSetup, folder: Path) -> NominalArm:
    """The nominal arm, with its URDF in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "robot.urdf"
    path.write_text(setup.arm.urdf, encoding="utf-8")
    return load_nominal_arm(path, sheet=sheet_of(setup.arm))


def _trajectories(
    arm: NominalArm, recordings: list[Recording]
) -> tuple[list[Trajectory], list[Trajectory]]:
    """What the nominal arm leaves of each recording, the judging ones apart."""
    corrected, body = CorrectedArm(arm), RigidBody(arm)
    cutoff = position_cutoff(tuple(recordings[:-JUDGED]))
    trajectories = [
        from_segment(corrected, body, segment)
        for recording in recordings
        for segment in condition(recording, cutoff)
    ]
    return trajectories[:-JUDGED], trajectories[-JUDGED:]
