"""A residual network as an effect: its inputs, memory, trusted region, arithmetic and file."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gapscope.arm.errors import InputError
from gapscope.arm.input_file import read_arrays
from gapscope.arm.io.atomic_write import atomic_write
from gapscope.arm.motions.motion import Motion

# What a joint remembers of its motion: how far it came since it last turned, and how warm its torque made it.


REACHES = np.array([0.01, 0.03, 0.1, 0.3, 1.0])
"""Ways after a reversal over which the stop operators fill [rad]."""
WARMING = np.array([2.0, 6.0, 20.0])
"""Time constants of the warming states [s]."""
STATES = len(REACHES) + len(WARMING)
"""States of a joint."""


class Memory:
    """Stop operators and warming states of n joints, cold and unstrained when the motion begins.

    A stop operator follows the way and is held at its reach r, s = clip(s + dq dt, -r, r): sums of them describe any
    hysteresis of Prandtl and Ishlinskii. A warming state follows the square of the load, T h' = load^2 - h.

    Args:
        q: position at the beginning [rad], (n,).
    """

    def __init__(self, q: np.ndarray) -> None:
        self._q = q
        self._stop: np.ndarray = np.zeros((len(q), len(REACHES)))
        self._heat: np.ndarray = np.zeros((len(q), len(WARMING)))

    def advance(self, q: np.ndarray, load: np.ndarray, dt: float) -> np.ndarray:
        """The states after a sample: stop operators over their reach [1], then warmth [N^2 m^2]; (n, STATES).

        Args:
            q: position [rad], (n,).
            load: torque that the corrected arm predicts [N m], (n,).
            dt: time since the sample before [s].
        """
        way = (q - self._q)[:, None]
        self._q = q
        self._stop = np.clip(self._stop + way, -REACHES, REACHES)
        # exact for a load that stays over the step, however long it is
        share = -np.expm1(-dt / WARMING)
        self._heat = self._heat + share * ((load**2)[:, None] - self._heat)
        return np.hstack([self._stop / REACHES, self._heat])


# What a residual network sees of a motion: per joint its own signals, what it remembers, the other joints.


SPEEDS = np.array([0.003, 0.01, 0.03, 0.1, 0.3, 1.0])
"""Speeds v at which a direction tanh(dq / v) turns [rad/s]."""
DIRECTION = 2
"""The direction that the past of a window and the neighbourhood of the training data are told by."""
OF_OTHERS = 3
"""The direction of the other joints."""


class Layout:
    """Places of the channels of a joint of an arm with n joints; C = 13 + 7 n of them.

    The joint's dq, ddq and load; its directions; its memory; dq, ddq, load and direction of the others; q, sin q and
    cos q of all joints, its own first.

    Attributes:
        channels: number C of channels.
        direction, memory: slices of the joint's directions and its memory.
        others: of the signals of the other joints: dq, ddq, load and direction, n - 1 each.
        angle: place of the joint's position; those of the others follow.
        past: channels of which a network with a short past sees the past: dq and a direction.
    """

    def __init__(self, n: int) -> None:
        self.n = n
        directions = 3 + len(SPEEDS)
        self.direction = slice(3, directions)
        self.memory = slice(directions, directions + STATES)
        self.angle = self.memory.stop + 4 * (n - 1)
        self.others = slice(self.memory.stop, self.angle)
        self.channels = self.angle + 3 * n
        self.past = np.array([0, 3 + DIRECTION])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the channels in their order; ``other_1`` is the first of the arm's other joints."""
        own = ("velocity", "acceleration", "load")
        directions = [f"direction_{speed:g}" for speed in SPEEDS]
        memory = [f"strain_{reach:g}" for reach in REACHES]
        memory += [f"warmth_{time:g}" for time in WARMING]
        others = [f"other_{k}" for k in range(1, self.n)]
        signals = (*own, f"direction_{SPEEDS[OF_OTHERS]:g}")
        of_others = [f"{signal}_{other}" for signal in signals for other in others]
        angles = ["position", *(f"position_{other}" for other in others)]
        posture = [f"{f}{angle}" for f in ("", "sin_", "cos_") for angle in angles]
        return (*own, *directions, *memory, *of_others, *posture)

    @property
    def own(self) -> np.ndarray:
        """Channels of the joint itself."""
        position = self.angle + self.n * np.arange(3)
        return np.concatenate([np.arange(self.memory.stop), position])

    @property
    def neighbourhood(self) -> np.ndarray:
        """Channels by which the distance from the training data is told: dq, ddq, load, direction, dq, sin q, cos q."""
        own = [0, 1, 2, 3 + DIRECTION]
        others = np.arange(self.others.start, self.others.start + self.n - 1)
        posture = np.arange(self.angle + self.n, self.channels)
        return np.concatenate([own, others, posture]).astype(int)


@dataclass(frozen=True)
class Inputs:
    """Windows of channels, one per joint; see ``Layout``.

    The load is the torque that the corrected arm predicts for the joint [N m]. A window holds ``taps`` samples,
    ``spacing`` apart, the oldest first; before the beginning of a motion the arm is taken to have stood where it
    begins, with the signals of the first sample.

    Attributes:
        n: number of joints.
        taps: samples in a window.
        spacing: time between them [s].
        mean, std: of the channels, in their units, subtracted and divided by; shape (n, C).
    """

    n: int
    taps: int
    spacing: float
    mean: np.ndarray
    std: np.ndarray

    @cached_property
    def layout(self) -> Layout:
        """Places of the channels."""
        return Layout(self.n)

    @property
    def channels(self) -> int:
        """Number C of channels."""
        return self.layout.channels

    @property
    def seen_by_mlp(self) -> np.ndarray:
        """Places in a flat window that the MLP sees: the joint's own channels now, its dq and direction before.

        Signals of all joints let it learn the paths of the training motions instead of functions.
        """
        places = np.arange(self.taps * self.channels).reshape(self.taps, self.channels)
        now = places[-1, self.layout.own]
        return np.concatenate([places[:-1, self.layout.past].ravel(), now])

    def windows(
        self, motion: Motion, load: np.ndarray, rows: np.ndarray | None = None
    ) -> np.ndarray:
        """Normalised windows at the chosen samples (all of them by default), shape (n, M, taps, C).

        Args:
            motion: N samples of n joints.
            load: torque that the corrected arm predicts [N m], (N, n).
            rows: the samples, (M,).
        """
        rows = np.arange(len(motion.t)) if rows is None else rows
        return self.windows_of(channels(motion, load), motion.rate, rows)

    def windows_of(
        self, series: np.ndarray, rate: float, rows: np.ndarray
    ) -> np.ndarray:
        """The same of channels in their units, (n, N, C), at a rate [Hz]."""
        back = self.spacing * rate * np.arange(self.taps - 1, -1, -1)
        # before the first sample the arm stood: its window repeats that sample
        place = np.maximum(rows[:, None] - back, 0.0)
        before = np.floor(place).astype(int)
        part = (place - before)[None, :, :, None]
        after = np.minimum(before + 1, series.shape[1] - 1)
        # the spacing need not be a whole number of samples: a line in between
        between = (1.0 - part) * series[:, before] + part * series[:, after]
        scaled = between - self.mean[:, None, None]
        return scaled / self.std[:, None, None]


def channels(motion: Motion, load: np.ndarray) -> np.ndarray:
    """Channels of each joint at each sample, in their units, shape (n, N, C)."""
    memory, dt = Memory(motion.q[0]), 1.0 / motion.rate
    states = [memory.advance(q, x, dt) for q, x in zip(motion.q, load, strict=True)]
    remembered = np.stack(states, axis=1)
    return channels_with(remembered, motion.q, motion.dq, motion.ddq, load)


def channels_with(
    memory: np.ndarray,
    q: np.ndarray,
    dq: np.ndarray,
    ddq: np.ndarray,
    load: np.ndarray,
) -> np.ndarray:
    """The same with the memory known, (n, N, STATES); the signals are (N, n)."""
    n = q.shape[1]
    # many speeds of turning: their sums are friction of any shape about standstill
    direction = np.tanh(dq[:, :, None] / SPEEDS)
    series = (dq, ddq, load, direction[:, :, OF_OTHERS])
    joints = []
    for j in range(n):
        own = np.stack([dq[:, j], ddq[:, j], load[:, j]], axis=1)
        # the joint itself comes first, others in their order without it
        others = [np.delete(x, j, axis=1) for x in series]
        angle = np.hstack([q[:, [j]], np.delete(q, j, axis=1)])
        posture = [angle, np.sin(angle), np.cos(angle)]
        joints.append(np.hstack([own, direction[:, j], memory[j], *others, *posture]))
    return np.stack(joints)


# Fixed functions of a joint's signals, of which an additive model is a weighted sum.


WAVES = 64
"""Waves over the range of a joint; the finest has half a wavelength of 1/51 of the range."""
BEYOND = 1.25
"""Length on which the waves are periodic after two turns, over the range seen in training."""
BANDS = (0, 8, 24, WAVES)
"""Waves are weighted band by band."""
OWN, ALL = 48, 96
"""Random waves over the joint's own signals (at two lengths each), and over those of all joints."""
LENGTHS = (1.0, 3.0)
"""Lengths of the random waves, in standard deviations of the signals."""
FRICTION = 3
"""The direction that friction follows."""


class Basis(NamedTuple):
    """F functions for each of n joints, of its channels held within the range of training.

    Waves over its position, alone and times its direction; its directions and speed; its memory; its load, alone and
    times warmth, directions and speed; signals of the others; and random waves, of which sums are smooth functions of
    many variables (rahimi2007): of q, dq, ddq and load of the joint, and of q, dq and load of all.

    Attributes:
        low, high: range of the normalised channels in training, (n, C).
        own: wave vectors and phases over q, dq, ddq, load of the joint, (5, OWN).
        everything: the same over q, dq and load of all joints, (3 n + 1, ALL).
    """

    low: np.ndarray
    high: np.ndarray
    own: np.ndarray
    everything: np.ndarray

    def parts(self, now: np.ndarray) -> list[np.ndarray]:
        """The functions by kind, each (n, N, .), of normalised channels (n, N, C)."""
        # held within the range of training: waves repeat beyond it
        x = np.clip(now, self.low[:, None], self.high[:, None])
        n = len(self.low)
        at = Layout(n)
        direction, memory = x[..., at.direction], x[..., at.memory]
        # of the joint's channels: 0 velocity, 1 acceleration, 2 load
        speed, load, friction = x[..., :1], x[..., 2:3], direction[..., [FRICTION]]
        strain, warmth = memory[..., : len(REACHES)], memory[..., len(REACHES) :]
        others = x[..., at.others]
        position = x[..., at.angle : at.angle + n]
        own = np.concatenate([position[..., :1], x[..., :3]], axis=2)
        dq, _, loads, _ = np.split(others, 4, axis=2)
        everything = np.concatenate([position, speed, dq, load, loads], axis=2)
        waves = self._waves(x[..., at.angle])
        return [
            *waves,
            *(wave * friction for wave in waves),
            np.concatenate([direction, speed, speed * np.abs(speed)], axis=2),
            strain,
            np.concatenate([load, load**3], axis=2),
            load * warmth,
            friction * warmth,
            np.concatenate([np.abs(load) * direction, load * speed], axis=2),
            x[..., 1:2],
            others,
            *(_random_waves(own, self.own, length) for length in LENGTHS),
            # states of more joints lie farther apart: longer waves
            _random_waves(everything, self.everything, np.sqrt(n) * 1.5),
        ]

    def features(self, now: np.ndarray) -> np.ndarray:
        """All functions, (n, N, F)."""
        return np.concatenate(self.parts(now), axis=2)

    def _waves(self, position: np.ndarray) -> list[np.ndarray]:
        """Cosines and sines of multiples of half a turn over ``BEYOND`` times the range, by band; (n, N, .)."""
        angle = Layout(len(self.low)).angle
        low, high = self.low[:, angle, None], self.high[:, angle, None]
        along = (position - low) / (BEYOND * np.maximum(high - low, 1e-9))
        phase = np.pi * along[:, :, None] * np.arange(1, WAVES + 1)
        cosine, sine = np.cos(phase), np.sin(phase)
        bands = [slice(a, b) for a, b in itertools.pairwise(BANDS)]
        return [np.concatenate([cosine[..., b], sine[..., b]], axis=2) for b in bands]


def _random_waves(x: np.ndarray, waves: np.ndarray, length: float) -> np.ndarray:
    """Cosines along random directions, (n, N, W), of x (n, N, D)."""
    # the last row holds the phases
    return np.cos(x @ waves[:-1] / length + waves[-1])


def draw_basis(low: np.ndarray, high: np.ndarray, seed: int) -> Basis:
    """A basis on a range of normalised channels, (n, C), with its random waves drawn."""
    rng = np.random.default_rng(seed)

    def waves(inputs: int, count: int) -> np.ndarray:
        vectors = rng.standard_normal((inputs, count))
        return np.vstack([vectors, rng.uniform(0.0, 2 * np.pi, count)])

    return Basis(low, high, waves(4, OWN), waves(3 * len(low), ALL))


def part_of_each(basis: Basis) -> np.ndarray:
    """Number of the part that each function belongs to, (F,)."""
    n, channels = basis.low.shape
    # by a trial: the number of functions does not depend on the values
    sizes = [part.shape[2] for part in basis.parts(np.zeros((n, 1, channels)))]
    return np.repeat(np.arange(len(sizes)), sizes)


# Trust of a residual network: 1 near the inputs that it was trained on, 0 far from them.


class Trust(NamedTuple):
    """A factor between 0 and 1 from the distance to the nearest of L inputs seen in training, per joint.

    With r the radius and d the distance, u = clip((d - r) / r, 0, 1): trust is 1 - 3 u^2 + 2 u^3. It is 1 up to the
    radius, and exactly 0 from twice the radius on. Inputs are the normalised channels of the present sample.

    Attributes:
        landmarks: inputs seen, (n, L, C).
        radius: within which everything seen lies, (n,).
    """

    landmarks: np.ndarray
    radius: np.ndarray

    def distance(self, now: np.ndarray) -> np.ndarray:
        """Distance to the nearest landmark, (n, N), of inputs (n, N, C)."""
        return nearest(now, self.landmarks)

    def factor(self, now: np.ndarray) -> np.ndarray:
        """Trust, (n, N), of inputs (n, N, C)."""
        u = np.clip(self.distance(now) / self.radius[:, None] - 1.0, 0.0, 1.0)
        return 1.0 - u * u * (3.0 - 2.0 * u)


def nearest(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Distance from each point, (n, N, C), to the nearest of the others, (n, L, C); shape (n, N)."""
    # the square of a - b is a^2 - 2 a b + b^2: one product in place of all differences
    cross = points @ others.transpose(0, 2, 1)
    square = (
        (points**2).sum(axis=2)[:, :, None]
        - 2.0 * cross
        + (others**2).sum(axis=2)[:, None]
    )
    # rounding may make it a little negative
    return np.sqrt(np.clip(square.min(axis=2), 0.0, None))


# An ensemble of small networks, one per joint and member, evaluated by numpy.


ADDITIVE = "additive"
FORMS = (ADDITIVE, "mlp", "tcn")
"""A weighted sum of fixed functions, a feed-forward network, and a causal temporal convolution."""
LOG_VARIANCE = (-10.0, 4.0)
"""Bounds of the log variance that a network may state, over the square of the joint's scale."""


@dataclass(frozen=True)
class Network:
    """M members of a network for each of n joints.

    h_0 is what the form sees of a window, h_{k+1} = tanh(h_k W_k + b_k), and the head gives the mean and the logarithm
    of the variance of the residual, (mean, log variance) = h_K W_K + b_K, over the joint's scale. ``additive`` has no
    hidden layer: its head sees the functions of a basis. The ``mlp`` sees all channels now and the past of the joint's
    own dq. In the ``tcn`` each layer joins two neighbouring samples to one: a
    causal convolution of kernel 2 whose dilation doubles from layer to layer, of which only what the last sample needs
    is computed; so it has taps = 2^K samples and K layers.

    Attributes:
        form: one of ``FORMS``.
        seen: places of a flat window that the mlp sees, (I,); all of them for the tcn, none for ``additive``.
        weights: W_k, each (M, n, in, out); the last is the head, out = 2.
        biases: b_k, each (M, n, out).
        basis: of ``additive``; ``None`` for the others.

    Source: vandenoord2016, lakshminarayanan2017.
    """

    form: str
    seen: np.ndarray
    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    basis: Basis | None = None

    @property
    def members(self) -> int:
        """Number M of members."""
        return int(self.weights[0].shape[0])

    def hidden(self, windows: np.ndarray) -> np.ndarray:
        """What the head sees, h_K, (M, n, N, hidden), of windows (n, N, taps, C); one for all members of a basis."""
        # its functions hold no past: memory is among the channels
        if self.basis is not None:
            return self.basis.features(windows[:, :, -1])[None]
        n, count = windows.shape[:2]
        flat = windows.reshape(n, count, -1)
        h = (flat[:, :, self.seen] if self.form == "mlp" else flat)[None]
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            # two neighbouring samples are one row of the convolution's matrix
            h = h.reshape(*h.shape[:2], -1, weight.shape[2])
            h = np.tanh(h @ weight + bias[:, :, None])
        return h.reshape(self.members, n, count, -1)

    def heads(self, hidden: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and log variance over the joint's scale, each (M, n, N)."""
        out = hidden @ self.weights[-1] + self.biases[-1][:, :, None]
        return out[..., 0], np.clip(out[..., 1], *LOG_VARIANCE)

    def outputs(self, windows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and log variance of every member, each (M, n, N), of windows (n, N, taps, C)."""
        return self.heads(self.hidden(windows))


# A trained residual network: the torque that no effect explains, near its training data.


CHUNK = 1000
"""Samples that are evaluated at once."""


@dataclass(frozen=True, eq=False)
class ResidualNetwork:
    """Residual torque of an arm with n joints: trust(x) times the mean of the members, within bounds.

    Attributes:
        inputs: what it sees.
        networks: the members, in one or several forms.
        chosen: which of them speaks on each joint, -1 if none does, (n,).
        trust: its factor of trust.
        scale: torque of an output of 1 [N m], (n,).
        bound: the torque never exceeds it [N m], (n,).
        cutoff: of the low-pass that the residual had passed when it was learnt [Hz].
    """

    inputs: Inputs
    networks: tuple[Network, ...]
    chosen: np.ndarray
    trust: Trust
    scale: np.ndarray
    bound: np.ndarray
    cutoff: float

    def check(self, n_joints: int) -> None:
        """Check that it is of an arm with so many joints; raises ``InputError`` otherwise."""
        if self.inputs.n != n_joints:
            raise InputError(
                f"the residual network is of an arm with {self.inputs.n} joints, this one has {n_joints}",
                "train one for this arm, or remove the line residual:",
                where="residual",
            )

    def torque(self, motion: Motion, load: np.ndarray) -> np.ndarray:
        """Residual torque [N m], (N, n); ``load`` is the torque that the corrected arm predicts [N m], (N, n)."""
        self.check(motion.q.shape[1])
        count = len(motion.t)
        # windows of a whole recording would fill the memory
        rows = np.array_split(np.arange(count), max(1, -(-count // CHUNK)))
        # the memory of a motion is followed from its beginning, once
        series = channels(motion, load)
        parts = [
            self.of_windows(self.inputs.windows_of(series, motion.rate, chunk))
            for chunk in rows
        ]
        return np.concatenate(parts)

    def of_windows(self, windows: np.ndarray) -> np.ndarray:
        """The same of normalised windows (n, N, taps, C); one sample of a running arm is N = 1."""
        # array operations that a tensor knows as well: so it is exported
        mean = np.zeros((self.inputs.n, 1))
        for k, network in enumerate(self.networks):
            speaks = (self.chosen == k)[:, None]
            # one that no joint has chosen costs nothing
            if not speaks.any():
                continue
            output, _ = network.outputs(windows)
            mean = mean + output.sum(axis=0) / network.members * speaks
        # the present sample, and of it what tells a state
        near = windows[:, :, -1, self.inputs.layout.neighbourhood]
        torque = self.trust.factor(near) * self.scale[:, None] * mean
        bound = self.bound[:, None]
        return np.clip(torque, -bound, bound).transpose(1, 0)


# The file ``residual.npz``: a residual network as arrays, without pickle.


SCHEMA = 2
LARGEST_COUNT = 1000
"""Taps of a window, or layers of a network, beyond which it is no network of Gapscope [1]."""
_OF_BASIS = ("low", "high", "own", "everything")
_REMEDY = "train it again, or remove the line residual: from corrected.yaml"


def write_residual(residual: ResidualNetwork, path: Path | str) -> None:
    """Write a network; ``path`` never holds half of one.

    Raises:
        GapscopeError: the file cannot be written.
    """
    inputs = residual.inputs
    arrays = {
        "schema": SCHEMA,
        **{name: getattr(inputs, name) for name in ("taps", "spacing", "mean", "std")},
        "forms": [network.form for network in residual.networks],
        "landmarks": residual.trust.landmarks,
        "radius": residual.trust.radius,
    }
    for name in ("chosen", "scale", "bound", "cutoff"):
        arrays[name] = getattr(residual, name)
    # arrays go by the form: there is one network of each
    for network in residual.networks:
        of_form = {"layers": len(network.weights), "seen": network.seen}
        for k, weight in enumerate(network.weights):
            of_form |= {f"weight{k}": weight, f"bias{k}": network.biases[k]}
        if network.basis is not None:
            of_form |= {name: getattr(network.basis, name) for name in _OF_BASIS}
        arrays |= {f"{network.form}.{name}": of_form[name] for name in of_form}
    with atomic_write(path) as aside, aside.open("wb") as stream:
        np.savez_compressed(stream, **arrays)


def read_residual(path: Path | str) -> ResidualNetwork:
    """Read a network.

    Raises:
        InputError: the file is missing, cut short, no residual network, or its arrays do not fit together.
    """
    path = Path(path)
    arrays = read_arrays(path, _REMEDY)

    def array(name: str, *shape: int | None, kinds: str = "fiub") -> np.ndarray:
        """An array, numbers by default, of a shape in which ``None`` stands for any length."""
        if name not in arrays:
            raise InputError(
                f"is no residual network: {name} is missing", _REMEDY, file=path
            )
        value, problem = arrays[name], ""
        pairs = zip(shape, value.shape, strict=False)
        fits = all(wanted in (None, length) for wanted, length in pairs)
        if value.dtype.kind not in kinds or value.ndim != len(shape) or not fits:
            lengths = ", ".join("any" if x is None else str(x) for x in shape)
            expected = "numbers" if "f" in kinds else "names"
            problem = (
                f"holds {value.dtype} of shape {value.shape}, expected {expected} of "
                f"shape ({lengths})"
            )
        elif value.dtype.kind == "f" and not np.isfinite(value).all():
            problem = "holds values that are not finite"
        if problem:
            raise InputError(problem, _REMEDY, file=path, where=name)
        return value

    def count(name: str) -> int:
        number = int(array(name))
        # a damaged number must not make arrays of any size
        if not 0 <= number <= LARGEST_COUNT:
            raise InputError(
                f"is {number}, expected 0 to {LARGEST_COUNT}",
                _REMEDY,
                file=path,
                where=name,
            )
        return number

    def network(form: str) -> Network:
        layers = range(count(f"{form}.layers"))
        basis = None
        if form == ADDITIVE:
            basis = Basis(*(array(f"{form}.{x}", None, None) for x in _OF_BASIS))
        return Network(
            form,
            array(f"{form}.seen", None),
            tuple(array(f"{form}.weight{k}", None, n, None, None) for k in layers),
            tuple(array(f"{form}.bias{k}", None, n, None) for k in layers),
            basis,
        )

    schema = int(array("schema"))
    forms = ["unknown"]
    # forms of another schema may mean anything: they are not read
    if schema == SCHEMA:
        forms = [str(form) for form in array("forms", None, kinds="U")]
    if schema != SCHEMA or not set(forms) <= set(FORMS):
        raise InputError(
            f"is of schema {schema} and forms {', '.join(forms)}; known are schema {SCHEMA} and {', '.join(FORMS)}",
            "train it again, or use the version of Gapscope that wrote it",
            file=path,
        )
    # the number of joints by one array; all others have to agree
    n = len(array("scale", None))
    layout = Layout(n)
    mean, std = (array(name, n, layout.channels) for name in ("mean", "std"))
    inputs = Inputs(n, count("taps"), float(array("spacing")), mean, std)
    near = len(layout.neighbourhood)
    found = ResidualNetwork(
        inputs=inputs,
        networks=tuple(map(network, forms)),
        chosen=array("chosen", n),
        trust=Trust(array("landmarks", n, None, near), array("radius", n)),
        scale=array("scale", n),
        bound=array("bound", n),
        cutoff=float(array("cutoff")),
    )
    # whether its weights fit together, a window tells
    windows = np.zeros((n, 1, inputs.taps, layout.channels))
    try:
        found.of_windows(windows)
        for one in found.networks:
            one.outputs(windows)
    except (ValueError, IndexError, TypeError) as error:
        raise InputError(
            f"its weights do not fit together ({error})", _REMEDY, file=path
        ) from None
    return found
