"""A case of the generator: which arm, motion and causes, of which size, and its files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from scipy.interpolate import CubicSpline

from gapscope.arm.errors import GapscopeError
from gapscope.arm.root_mean_square import rms
from gapscope.blind_check.generator.arms import (
    Arm,
    copied,
    draw_arm,
    perturb_inertials,
    text_of,
)
from gapscope.blind_check.generator.law import Cause, Law, LawContext
from gapscope.blind_check.generator.laws import LAWS
from gapscope.blind_check.generator.rigid import (
    inertia_diagonal,
    inverse_dynamics,
    model_of,
    tip_path,
)
from gapscope.blind_check.generator.simulate import (
    KNEE,
    STRONG,
    WEAK,
    CaseSpec,
    Conditions,
    Motion,
    draw_motion,
    nominal_torque,
    residual,
    simulate,
)
from gapscope.blind_check.generator.true_arm import Columns, HealthyArm, Loop, TrueArm

# The setup of a case: its arm, controller, motions and healthy twin, on which causes are tried and sized.


STEP = 5e-4
"""Simulation step [s]."""
RESTLESS = 0.35
"""Mean change of the command from tick to tick, over its deviation, above which the loop is not a healthy one."""


@dataclass(frozen=True)
class CaseSetup(LawContext):
    """What stays the same while causes are tried; the last motion is the held-out one.

    Attributes:
        loop, healthy: the arm's controller, its small imperfections.
        model: MuJoCo model of the nominal arm.
        believed: URDF root with the true inertials of the healthy twin (a little off the nominal ones).
        motions, kinds, ahead, noise: per recording reference, its kind, feedforward [N m], encoder noise [rad].
        thin: rows of the controller per row of the recording.
        floor: RMS of the healthy twin's gap on the held-out motion [N m], (n,).
        twin: that gap itself [N m], (M, n).
    """

    loop: Loop
    healthy: HealthyArm
    model: Any
    believed: Any
    motions: list[Motion]
    kinds: list[str]
    ahead: list[np.ndarray]
    noise: list[np.ndarray]
    thin: int
    floor: np.ndarray
    twin: np.ndarray

    def plant(self, causes: Sequence[Cause]) -> TrueArm:
        """The true arm with some causes."""
        plant = TrueArm(self.arm, self.healthy, self.loop, copied(self.believed))
        for cause in causes:
            cause.act(plant)
        return plant

    def run(
        self, plant: TrueArm, which: int, later: tuple[float, TrueArm] | None = None
    ) -> Columns | None:
        """One recording, thinned to its rate, before any fault of the set-up; ``None`` if it cannot be used.

        Args:
            plant: the true arm.
            which: number of the motion.
            later: a time [s], and the arm that takes the place of the other from then on.
        """
        rows = simulate(
            plant,
            self.motions[which],
            self.ahead[which],
            self.noise[which],
            later=later,
        )
        if rows is None:
            return None
        settled = rows["tau"][int(0.4 * self.loop.rate) :]
        change = np.abs(np.diff(settled, axis=0)).mean(axis=0)
        # a chattering command is no healthy loop, even if the arm stays near its reference
        if (change / self.deviation).max() > RESTLESS:
            return None
        return {name: series[:: self.thin] for name, series in rows.items()}

    def gap(self, rows: Columns) -> tuple[np.ndarray, np.ndarray]:
        """Gap of a recording of the held-out motion [N m], (M, n), and the scale it is measured by, (n,)."""
        predicted = nominal_torque(self.model, sheet_of(self.arm), rows["t"], rows["q"])
        return residual(rows["tau"], predicted, self.loop.rate / self.thin)

    def signature(self, causes: Sequence[Cause]) -> np.ndarray | None:
        """RMS of what causes add to the gap on the held-out motion, over the healthy twin's floor, (n,)."""
        rows = self.run(self.plant(causes), -1)
        if rows is None:
            return None
        gap, _ = self.gap(rows)
        return rms(gap - self.twin) / self.floor


def draw_setup(conditions: Conditions, rng: np.random.Generator) -> CaseSetup | None:
    """The setup of a case; ``None`` if its healthy twin does not run well.

    The order of the draws is part of what a seed means.
    """
    arm = draw_arm(conditions.robot, rng)
    model = model_of(arm.urdf)
    motions, kinds = _motions(arm, conditions, rng)
    postures = arm.home + rng.uniform(-1, 1, (20, arm.n)) * arm.half
    inertia = inertia_diagonal(model, postures).mean(axis=0)
    torques = [needed_torque(arm, model, motion) for motion in motions]
    # a PD controller of 3 to 4.5 Hz bandwidth whose limit lies well above what the motions need
    w = rng.uniform(20, 28)
    damping = rng.uniform(0.8, 1.0)
    kp = (inertia + arm.armature) * w**2 * rng.uniform(0.85, 1.15, arm.n)
    kd = 2 * damping / w * kp
    needed = np.max([np.abs(torque).max(axis=0) for torque in torques], axis=0)
    loop = Loop(
        rate=float(conditions.loop_rate),
        kp=kp,
        kd=kd,
        # room for the damping of an error of 0.5 rad/s
        limit=needed * rng.uniform(2.5, 3.5) + kd * 0.5,
        cutoff=float(rng.choice([50.0, 80.0, 120.0])),
        damping=float(rng.choice([0.7, 0.9, 1.0])),
        feedforward=str(rng.choice(["none", "gravity", "nominal"], p=[0.2, 0.3, 0.5])),
    )
    healthy = HealthyArm(
        step=STEP,
        encoder_step=2 * np.pi / 2 ** int(rng.integers(16, 20)),
        noise=rng.uniform(0.5e-5, 2.2e-5) * conditions.noise,
        stribeck=rng.uniform(0.03, 0.15, arm.n),
        knee=rng.uniform(0.01, 0.06, arm.n),
        presliding=10 ** rng.uniform(-4.7, -4.0),
        bend=rng.uniform(0.94, 1.0, arm.n),
    )
    pairs = zip(motions, torques, strict=True)
    ahead = [fed_forward(loop.feedforward, model, *pair) for pair in pairs]
    noise = [healthy.noise * rng.standard_normal(motion.q.shape) for motion in motions]
    believed = arm.root
    if conditions.inertials_off:
        perturb_inertials(believed, conditions.inertials_off, rng)
    deviation = torques[-1].std(axis=0)
    setup = CaseSetup(
        arm=arm,
        loop=loop,
        healthy=healthy,
        model=model,
        believed=believed,
        motions=motions,
        kinds=kinds,
        ahead=ahead,
        noise=noise,
        thin=conditions.loop_rate // conditions.rate,
        deviation=np.maximum(deviation, 0.05 * deviation.max()),
        peak=np.abs(torques[-1]).max(axis=0),
        speed=rms(motions[-1].dq),
        inertia=inertia,
        swing=np.ptp(motions[-1].q, axis=0),
        middle=motions[-1].q.mean(axis=0),
        tip=tip_path(model, np.vstack([motion.q[::20] for motion in motions])),
        shortest=float(min(motion.t[-1] for motion in motions)),
        encoder_step=healthy.encoder_step,
        # measured below, on the setup itself
        floor=np.zeros(arm.n),
        twin=np.zeros(arm.n),
    )
    rows = setup.run(setup.plant(()), -1)
    if rows is None:
        return None
    twin, _ = setup.gap(rows)
    return replace(setup, twin=twin, floor=rms(twin))


def sheet_of(arm: Arm) -> dict[str, np.ndarray]:
    """Armature, Coulomb and viscous friction of the data sheet, each (n,)."""
    return {"armature": arm.armature, "coulomb": arm.coulomb, "viscous": arm.viscous}


def needed_torque(arm: Arm, model: Any, motion: Motion) -> np.ndarray:
    """Torque that the nominal arm needs for a reference [N m], (N, n)."""
    rigid = _rigid_torque(model, motion)
    rotors = arm.armature * motion.ddq
    dry = arm.coulomb * np.tanh(motion.dq / KNEE)
    return rigid + rotors + dry + arm.viscous * motion.dq


def fed_forward(
    kind: str, model: Any, motion: Motion, needed: np.ndarray
) -> np.ndarray:
    """What a feedforward of a kind makes of the torque that the nominal arm needs for a reference [N m], (N, n)."""
    if kind == "gravity":
        return _rigid_torque(model, motion, gravity_only=True)
    return needed if kind == "nominal" else np.zeros_like(needed)


def _rigid_torque(
    model: Any, motion: Motion, *, gravity_only: bool = False
) -> np.ndarray:
    """Torque of the rigid bodies along a reference [N m], (N, n): at 200 Hz, between them by cubic splines."""
    last = len(motion.t) - 1
    every = max(1, round(0.005 / motion.t[1]))
    rows = np.unique(np.append(np.arange(0, last + 1, every), last))
    q, dq, ddq = motion.q[rows], motion.dq[rows], motion.ddq[rows]
    if gravity_only:
        dq, ddq = 0 * dq, 0 * ddq
    torque = inverse_dynamics(model, q, dq, ddq)
    return CubicSpline(motion.t[rows], torque)(motion.t)


def _motions(
    arm: Arm, conditions: Conditions, rng: np.random.Generator
) -> tuple[list[Motion], list[str]]:
    """The recordings' motions: slow, faster, then others; the last, held-out one is no faster than the fastest."""
    others = [str(kind) for kind in rng.permutation(["point_to_point", "crawl"])]
    faster = str(rng.choice(["fast", "middle"]))
    kinds = ["slow", faster, *others][: conditions.recordings]
    kinds.append(kinds[1] if rng.uniform() < 0.6 else "middle")
    lengths = np.round(rng.uniform(*conditions.duration, len(kinds)), 1)
    lengths[-1] = min(lengths[-1], 10.0)
    motions = [
        draw_motion(kind, arm, float(length), conditions.loop_rate, rng)
        for kind, length in zip(kinds, lengths, strict=True)
    ]
    return motions, kinds


# Drawing a cause and giving it the size that its severity class asks for.


TRIES = 12
"""Runs of the held-out motion that the sizing of a cause may take."""
OTHERS = (0.6, 1.0)
"""Size of an effect on its further joints, over that on its first."""
MIN_NRMSE = 0.02
"""Least torque NRMSE that a strong effect adds, on each of its joints if these are sized one by one: an effect that
adds less than 0.01 to no joint's gap need not be named at all, however low the floor is."""
NEAR = 0.2
"""How far, in logarithm, each joint may stay from its own target."""


def draw_cause(
    law: Law,
    setup: CaseSetup,
    severity: tuple[float, float] | None,
    rng: np.random.Generator,
) -> Cause | None:
    """A cause whose own gap on the held-out motion lies in a class; ``None`` if no believable size gives that.

    Args:
        law: its law.
        setup: the case's arm and motions.
        severity: lowest and highest ratio of its own gap to the floor, on the joint where it is widest.
        rng: source of joints and values.
    """
    joints = draw_joints(law.joints, setup.arm.n, rng)
    if joints is None:
        return None
    cause = law.cause(rng, setup, joints)
    if severity is None or law.measure == "none":
        return cause
    low, high = severity
    # a little inside the class, evenly in the logarithm
    target = float(np.exp(rng.uniform(np.log(low * 1.08), np.log(high / 1.08))))
    targets = target * rng.uniform(*OTHERS, max(len(joints), 1))
    targets[rng.integers(len(targets))] = target
    targets = np.maximum(targets, min(low, 2.0))
    if law.measure == "step":
        now = cause.values["step"] / setup.encoder_step
        return cause.sized(np.full(len(joints), target) / now)
    return _sized(cause, setup, targets, severity)


def _sized(
    cause: Cause,
    setup: CaseSetup,
    targets: np.ndarray,
    severity: tuple[float, float],
) -> Cause | None:
    """Scale towards the targets, as if what an effect adds to the gap were proportional to its size.

    Where it is not, by halving between sizes that are too small and too large.
    A strong effect is lifted to ``MIN_NRMSE``, if that takes it beyond its class.
    """
    own, joints = cause.law.own, cause.joints
    least = np.zeros(setup.arm.n)
    if severity[0] >= STRONG[0][0]:
        least = MIN_NRMSE / (setup.floor / setup.deviation)
    # sizes over the one that was drawn: this one, the largest that is too small, the least that is too large
    size: np.ndarray = np.ones(len(targets))
    small, large = np.zeros(len(targets)), np.full(len(targets), np.inf)
    for _ in range(TRIES):
        if not cause.believable():
            return None
        ratios = setup.signature((cause,))
        if ratios is None:
            # the loop became unstable
            large = np.minimum(large, size)
            wider = np.full(len(targets), 0.6)
        else:
            # of each joint, or of the one where it is widest if its joints are not sized one by one
            reached, wanted = ratios[joints], targets
            if own:
                wanted = np.maximum(targets, least[joints])
            else:
                reached = ratios.max(keepdims=True)
                # ratio at which the effect becomes visible on some joint
                visible_at = reached * (least / np.maximum(ratios, 1e-9)).min()
                wanted = np.maximum(targets.max(keepdims=True), visible_at)
            highest = max(severity[1], 1.2 * wanted.max())
            in_class = severity[0] <= ratios.max() <= highest
            visible = own or (ratios >= 0.9 * least).any()
            error = np.log(wanted / np.maximum(reached, 1e-9))
            near = not own or (np.abs(error) < NEAR).all()
            if in_class and visible and near:
                return cause
            wider = np.clip(np.exp(error), 0.1, 6.0) * np.ones(len(targets))
            small = np.maximum(small, np.where(wider > 1.0, size, 0.0))
            large = np.minimum(large, np.where(wider < 1.0, size, np.inf))
        # a clamp does nothing, and then nearly everything: half way, if that would leave what is known
        following = size * wider
        above = np.where(np.isinf(large), 4.0 * small, large)
        half_way = np.sqrt(np.maximum(small, 0.36 * above) * above)
        inside = (following > small) & (following < large)
        following = np.where(inside, following, half_way)
        cause, size = cause.sized(following / size), following
    return None


def draw_joints(kind: str, n: int, rng: np.random.Generator) -> np.ndarray | None:
    """Joints, from 0, of one kind of law (see ``Law``) on an arm of n joints; ``None`` if it has none."""
    first, last = {
        "middle": (1, n - 1),
        "inner": (1, max(n - 2, 2)),
        "later": (1, n),
    }.get(kind, (0, n))
    pool = np.arange(first, last)
    if kind == "arm":
        return np.array([], dtype=int)
    if len(pool) < (2 if kind == "pair" else 1):
        return None
    if kind == "all":
        return pool
    if kind in ("one", "inner", "pair"):
        count = 2 if kind == "pair" else 1
        return np.sort(rng.choice(pool, count, replace=False))
    # mostly one joint, at times several, rarely all
    chance = rng.random()
    if chance < 0.15:
        return pool
    count = 1 if chance < 0.6 or len(pool) < 3 else int(rng.integers(2, len(pool)))
    return np.sort(rng.choice(pool, count, replace=False))


# One case of the blind check: drawn, simulated, measured, and written in the project's case format.


ATTEMPTS = 120
"""Draws of a case before giving up."""
EASED = (8, 16, 24)
"""Draws after which less is asked of a case: the lowest class; nearly true inertials; another arm without extra noise,
whose other recordings need not show the cause."""
DRAWS = 3
"""Draws of a cause on one arm with its motions, before another is taken."""
VISIBLE = 3.0
"""Least ratio of the gap to the floor in a case of a strong class."""
MIN_VISIBLE_NRMSE = 0.02
"""Torque NRMSE that a strong cause reaches in some recording that may be fitted."""


class MadeCase(NamedTuple):
    """A case before it is written.

    Attributes:
        setup: arm, controller and motions.
        plant: the true arm.
        causes: what is at work.
        rows: the recordings, the last of them the held-out one.
        label: the truth, as JSON data.
    """

    setup: CaseSetup
    plant: TrueArm
    causes: tuple[Cause, ...]
    rows: list[Columns]
    label: dict[str, Any]


def make_case(spec: CaseSpec, seed: tuple[int, ...]) -> MadeCase:
    """Draw until a case runs well; the same seed gives the same case.

    Raises:
        GapscopeError: no draw gave a case, or numba is not installed.
    """
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng([*seed, attempt])
        made = _attempt(_eased(spec, attempt), rng, attempt)
        if made is not None:
            return made
    raise GapscopeError(
        f"no case with {' and '.join(spec.laws) or 'no effect'} came about in {ATTEMPTS} draws on {spec.conditions}",
        "leave the effect out of the plan, or draw from another seed",
    )


def _eased(spec: CaseSpec, attempt: int) -> CaseSpec:
    """The case as it is wanted; after many draws the lowest class of its kind, then nearly true inertials as well.

    Some effects cannot reach a high class on some arms: the loop becomes unstable first.
    """
    if attempt < EASED[0] or spec.severity is None:
        return spec
    severity = STRONG[0] if spec.severity[0] >= VISIBLE else spec.severity
    conditions = spec.conditions
    if attempt >= EASED[1]:
        nearly_true = min(conditions.inertials_off, 0.02)
        conditions = conditions._replace(inertials_off=nearly_true)
    if attempt >= EASED[2]:
        conditions = conditions._replace(robot="franka_panda", noise=1.0)
    return spec._replace(severity=severity, conditions=conditions)


def _attempt(spec: CaseSpec, rng: np.random.Generator, attempt: int) -> MadeCase | None:
    """One draw of a case; ``None`` if it does not run well or does not show its cause."""
    setup = draw_setup(spec.conditions, rng)
    if setup is None:
        return None
    causes = []
    for name in spec.laws:
        # each with a few tries
        drawn = (
            draw_cause(LAWS[name], setup, spec.severity, rng) for _ in range(DRAWS)
        )
        cause = next((cause for cause in drawn if cause is not None), None)
        if cause is None:
            return None
        causes.append(cause)
    plant = setup.plant(causes)
    rows = []
    # the held-out one is tried first, and becomes the last
    for which in (-1, *range(len(setup.motions) - 1)):
        recorded = setup.run(plant, which)
        if recorded is None:
            return None
        rows.append(recorded)
    rows = [*rows[1:], rows[0]]
    if attempt < EASED[2] and not _shown(setup, causes, rows, spec):
        return None
    gap, scale = setup.gap(rows[-1])
    ratio = rms(gap) / setup.floor
    by_torque = bool(causes) and all(cause.law.measure == "torque" for cause in causes)
    strong = spec.severity is not None and spec.severity[0] >= VISIBLE
    # together several causes may cancel
    if by_torque and strong and ratio.max() < VISIBLE:
        return None
    label = _label(spec, setup, causes, gap, scale, attempt)
    for spoil in plant.spoil:
        rows = [spoil(recorded, rng) for recorded in rows]
    return MadeCase(setup, plant, tuple(causes), rows, label)


def _shown(
    setup: CaseSetup, causes: list[Cause], rows: list[Columns], spec: CaseSpec
) -> bool:
    """Whether what a strong cause does to the held-out motion can be seen in some other recording too.

    It must be ``VISIBLE`` times the floor and ``MIN_VISIBLE_NRMSE`` of torque NRMSE on the joint where it is widest.
    """
    single = len(causes) == 1 and causes[0].law.measure == "torque"
    if not single or spec.severity is None or spec.severity[0] < VISIBLE:
        return True
    gap, _ = setup.gap(rows[-1])
    joint = int(np.argmax(rms(gap - setup.twin) / setup.floor))
    for recorded in rows[:-1]:
        gap, scale = setup.gap(recorded)
        least = max(VISIBLE * setup.floor[joint], MIN_VISIBLE_NRMSE * scale[joint])
        if rms(gap)[joint] > least:
            return True
    return False


def _label(
    spec: CaseSpec,
    setup: CaseSetup,
    causes: list[Cause],
    gap: np.ndarray,
    scale: np.ndarray,
    attempt: int,
) -> dict[str, Any]:
    nrmse = rms(gap) / scale
    floor = setup.floor / scale
    own = rms(gap - setup.twin) / setup.floor
    by_torque = all(cause.law.measure == "torque" for cause in causes)
    steps = [
        float(cause.values["step"].max() / setup.encoder_step)
        for cause in causes
        if cause.law.measure == "step"
    ]
    ratio = float((nrmse / floor).max()) if by_torque else max(steps, default=None)
    severity = spec.severity
    # the class that a single effect has come into; that of the plan for several, none without any
    if severity is not None and len(causes) == 1 and by_torque:
        classes = (*WEAK, *STRONG)
        severity = next((x for x in classes if own.max() <= x[1]), classes[-1])
    return {
        "kind": spec.kind,
        "effects": [cause.label() for cause in causes],
        "severity": severity and list(severity),
        "measure": "torque" if by_torque else "step" if steps else "none",
        "ratio": None if ratio is None else round(ratio, 3),
        "signature": _rounded(own, 3),
        "gap": _rounded(nrmse, 5),
        "floor": _rounded(floor, 5),
        "conditions": spec.conditions._asdict(),
        "motions": setup.kinds,
        "feedforward": setup.loop.feedforward,
        "attempts": attempt + 1,
    }


def _rounded(values: np.ndarray, digits: int) -> list[float]:
    """Numbers of a label."""
    return [round(float(x), digits) for x in values]


def write_case(
    made: MadeCase, name: str, bare: bool, folder: Path, unseen: Path
) -> None:
    """Write ``case.yaml``, ``robot.urdf`` and the recordings into a folder, the held-out recording elsewhere."""
    folder.mkdir(parents=True)
    unseen.parent.mkdir(parents=True, exist_ok=True)
    root = made.setup.arm.root
    if made.plant.spoil_urdf is not None:
        made.plant.spoil_urdf(root)
    (folder / "robot.urdf").write_text(text_of(root), encoding="utf-8")
    names = [f"recording_{letter}.csv" for letter in "abcdefgh"[: len(made.rows) - 1]]
    arm, loop = made.setup.arm, made.setup.loop
    content = {
        "name": name,
        "robot": "robot.urdf",
        "nominal": {
            "armature": _plain(arm.armature),
            "coulomb": _plain(arm.coulomb),
            "viscous": _plain(arm.viscous),
            "torque_limit": _plain(loop.limit),
            "encoder": "motor",
            "encoder_step": made.setup.encoder_step,
        },
    }
    if not bare:
        content["controller"] = {
            "kind": "pd",
            "rate": loop.rate,
            "kp": _plain(loop.kp),
            "kd": _plain(loop.kd),
            "feedforward": loop.feedforward,
            "velocity_filter": {"cutoff": loop.cutoff, "damping": loop.damping},
        }
    content["recordings"] = names
    text = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110)
    (folder / "case.yaml").write_text(text, encoding="utf-8")
    # recordings as CSV: t, then each channel's joints
    channels = ("q", "tau") if bare else ("q", "dq", "tau", "q_ref", "dq_ref")
    joints = range(1, arm.n + 1)
    head = ",".join(["t", *(f"{x}{j}" for x in channels for j in joints)])
    paths = [*(folder / name for name in names), unseen]
    for rows, path in zip(made.rows, paths, strict=True):
        table = np.column_stack([rows["t"], *(rows[channel] for channel in channels)])
        np.savetxt(path, table, "%.8g", ",", header=head, comments="")


def _plain(values: np.ndarray) -> list[float]:
    """Numbers of a case file, to eight digits."""
    return [float(f"{x:.8g}") for x in values]
