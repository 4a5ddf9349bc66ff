"""The columns of a contrast: how the torque changes with bodies, drives and effects, about an arm that only predicts.

The gap y_j of joint j against that arm is taken as

    y_j = X_j beta_g + f_j(x) + A_j theta_b + noise

with X all columns, beta_g their coefficients in group g, f_j an unknown function of the state x that all groups share,
and theta_b what each motion b has of its own (form error).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from gapscope.arm.dynamics.inertials import inertial_scale
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.joint_units import size_per_radian
from gapscope.arm.nominal import NominalArm
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.effect import (
    DryLaw,
    External,
    Inertial,
    LinkChange,
    Path,
    TorqueLaw,
    Transmission,
)
from gapscope.model.jacobian import Bodies, LinearisationPoint, columns
from gapscope.model.rows import Kept, PartOfDesign, Rows, over_deviation
from gapscope.model.terms import Candidate, Term, Terms

WIDE = 2.0
"""Prior of what two groups share whatever its value: RMS torque over the joint's deviation [1]. (physical)"""
LIKELY = 3.0
"""Standard deviations within which what a healthy arm has lies, but for one coordinate in 400 [1]. (statistics)"""
HEALTHY = 1 / LIKELY
"""What a healthy arm has of an effect, over the size that is usual where it is one [1]: 10 % of a torque constant."""
STIFF = 0.3
"""The same of compliance and free play that both share: what bends more is no arm of the catalogue [1]. (physical)"""
PUSHES = 4
"""Parts of a motion in each of which form error may look like a force. (budget)"""
BODIES = 3.0
"""Prior of the bodies, over their nominal size [1]: a URDF may lack a tool, or hold placeholders. (physical)"""
PRECISE = 0.02
"""What a model leaves of a joint's torque at least, when joints are weighed [1]; form error of a column at first."""
ROUNDS = 3
"""Rounds of what settles in a few: weights of joints, sizes of effects, values about which a law is linear. (budget)"""
PER_KELVIN = 0.02
"""Share of its friction by which a joint's changes per kelvin [1/K] [bittencourt2012]. (physical)"""
WAVES, FEWER_WAVES = (24, 48), (8, 16)
"""Waves of which an unknown function of a joint's own state consists, and one of the whole arm's: of two groups, and of
more or of spans. (budget)"""
TAILS = 3
"""Degrees of freedom of Student's t, of which their wave numbers are drawn: rough on all scales. (definition)"""
MAX_KEPT = 20_000_000
"""Numbers of columns, and of what else is kept to be asked for again, up to which they are. (budget)"""
MIN_TORQUE = 1e-6
"""Columns that move no joint by more than this share of its torque say nothing [1]."""


@dataclass(frozen=True)
class FreeArm:
    """An arm that predicts: its bodies need not be possible.

    Attributes:
        arm: the nominal arm, without rotors and friction of its data sheet.
        body: its bodies.
        increments: added to the inertial parameters of each link, (n, 10).
        theta: linear coordinates of the effects that it has, (P,), as ``Terms`` lays them out.
        taken: what a contrast found of the inertial parameters, (10 n,), and of each term: the priors of what is shared
            count from the arm without it.
    """

    arm: NominalArm
    body: RigidBody
    increments: np.ndarray
    theta: np.ndarray
    taken: tuple[np.ndarray, Mapping[Term, np.ndarray]] | None = None

    @classmethod
    def nominal(cls, arm: NominalArm) -> FreeArm:
        """The nominal arm, its rotors and friction as effects, so that they have columns."""
        none = np.zeros(arm.n_joints)
        bare = replace(arm, armature=none, coulomb=none, viscous=none)
        terms = Terms(arm.n_joints, {}, arm.coupled_motors)
        theta = np.zeros(terms.size)
        for effect in terms.definitions:
            sheet = effect.fitted.data_sheet
            if sheet is not None:
                theta[terms.block(effect.name)[0]] = getattr(arm, sheet)
        return cls(bare, RigidBody(arm), np.zeros((arm.n_joints, 10)), theta)

    def point(
        self, bodies: Bodies, terms: Terms, theta: np.ndarray | None = None
    ) -> LinearisationPoint:
        """Its torque on a segment, with its effects or with those of other coordinates."""
        theta = self.theta if theta is None else theta
        return LinearisationPoint.of(self.corrected(terms, theta), bodies, terms, theta)

    @property
    def bodies(self) -> RigidBody:
        """Its bodies, possible or not."""
        return self.body.changed(self.increments)

    def corrected(self, terms: Terms, theta: np.ndarray | None = None) -> CorrectedArm:
        """The arm with its effects, or with those of other coordinates."""
        return CorrectedArm(
            self.arm, terms.effects(self.theta if theta is None else theta)
        )


@dataclass(frozen=True)
class Design:
    """Columns on the rows, each in a unit in which it moves some joint's torque by its deviation.

    Attributes:
        rows: M rows of n joints.
        bodies: of each segment.
        terms: all terms, with the nonlinear parameters of those that have some.
        places: of the columns of each term that the rows show.
        units: RMS torque over the joint's scale of one unit of each coordinate of a term, (linear,).
        usual: size of the coordinates of each term that is usual where it is an effect.
        columns: per joint its columns over the joint's scale, (M, p_j).
        active: per joint their places among all columns, (p_j,).
        gap: of the arm that predicts, over the joints' scale [1], (M, n).
        prior: deviation of what all groups share, in units of the columns, (P,).
        taken: what of it the arm has already, in the same units, (P,).
        own: whether a motion may have a value of its own of a column, mask (P,).
        waves: per joint the places of waves of which unknown functions consist: of its own state, and of the arm's.
        noisy: of columns made of the recorded torque, by joint and place among its columns, how much of that torque's
            noise passes into each row, in the unit of the column, (M,).
    """

    rows: Rows
    bodies: list[Bodies]
    terms: Terms
    places: Mapping[Term, np.ndarray]
    units: Mapping[Term, np.ndarray]
    usual: Mapping[Term, float]
    columns: list[np.ndarray]
    active: list[np.ndarray]
    gap: np.ndarray
    prior: np.ndarray
    taken: np.ndarray
    own: np.ndarray
    waves: list[list[np.ndarray]]
    noisy: Mapping[tuple[int, int], np.ndarray]

    @property
    def size(self) -> int:
        """Number P of columns."""
        return len(self.prior)

    @cached_property
    def told(self) -> np.ndarray:
        """Places of the columns of all terms, rising, (T,)."""
        return np.concatenate(list(self.places.values()))

    def shared_torque(self, value: np.ndarray) -> np.ndarray:
        """What coefficients of all columns, (P,), do to the torque, over the joints' scale [1], (M, n)."""
        every = zip(self.columns, self.active, strict=True)
        return np.stack([x @ value[active] for x, active in every], axis=1)

    def size2(self, j: int) -> np.ndarray:
        """Mean square of the columns of a joint over the rows that count, (p_j,)."""
        squares = (self.columns[j] ** 2).sum(axis=0)
        return np.asarray(squares / (self.rows.trust[:, j] ** 2).sum())

    def torque(self, term: Term, value: np.ndarray) -> np.ndarray:
        """What coordinates of a term, (linear,), do to the torque, over the joints' scale [1], (M, n).

        That is nothing if the rows do not show the term.
        """
        out = np.zeros_like(self.gap)
        if term not in self.places:
            return out
        scaled = value * self.units[term]
        for j in range(out.shape[1]):
            out[:, j] = self.of_term(term, j) @ scaled
        return out

    def of_term(self, term: Term, j: int) -> np.ndarray:
        """Columns of a term on a joint from 0, (M, linear); zero where it does nothing that the rows show."""
        out = np.zeros((len(self.gap), len(term.columns)))
        if term in self.places:
            at = self._among[j][self.places[term]]
            out[:, at >= 0] = self.columns[j][:, at[at >= 0]]
        return out

    @cached_property
    def _among(self) -> list[np.ndarray]:
        """Per joint where each column stands among its own; -1 of one that it has not, (P,)."""
        out = [np.full(self.size, -1) for _ in self.active]
        for among, active in zip(out, self.active, strict=True):
            among[active] = np.arange(len(active))
        return out


def shared_basis(made: Design, j: int, noise2: float) -> np.ndarray:
    """Columns Q, (M, K), with y - Q Q^T y what is left of y beside what is shared, as the prior has it.

    Args:
        made: the design.
        j: the joint, from 0.
        noise2: variance of y.
    """
    # ridge regression: the prior as further rows, of whose QR the upper part is kept
    prior = made.prior[made.active[j]]
    scaled = made.columns[j][:, prior > 0] * prior[prior > 0] / np.sqrt(noise2)
    both = np.vstack([scaled, np.eye(scaled.shape[1])])
    return np.asarray(np.linalg.qr(both)[0][: len(scaled)])


def about(
    made: Design, arm: FreeArm, values: Mapping[Candidate, np.ndarray]
) -> tuple[np.ndarray, dict[Candidate, list[np.ndarray]]]:
    """Groups about values of terms that they have of their own, of those whose columns change with them.

    Args:
        made: the design, about what all groups share.
        arm: that all share.
        values: coordinates of what groups have of their own, (linear,) each.

    Returns:
        The gap as that of the design, what the terms do to it added, (M, n); and per joint the columns of each
        candidate, on the rows of its groups, in the units of the design, (M, linear).
    """
    rows, terms = made.rows, made.terms
    moved = moving(values)
    gap = made.gap.copy()
    columns_of = {
        one: [np.zeros((len(gap), len(x))) for _ in made.active]
        for one, x in moved.items()
    }
    for k, bodies in enumerate(made.bodies):
        rows_of = np.flatnonzero(rows.segment == k)
        group = rows.group[rows_of]
        # groups of a segment that have the same of their own
        alike: dict[tuple[Candidate, ...], list[int]] = {}
        for number in np.unique(group).tolist():
            some = tuple(one for one in moved if one.has(number))
            alike.setdefault(some, []).append(number)
        alike.pop((), None)
        for some, numbers in alike.items():
            there = np.isin(group, numbers)
            mine, trust = rows_of[there], rows.trust[rows_of[there]]
            theta = arm.theta.copy()
            for one in some:
                theta[list(one.term.columns)] += moved[one]
            theta, segment = terms.clipped(theta), bodies.segment
            # what the arm predicts there with all that these groups have
            at = arm.point(bodies, terms, theta)
            left = segment.bridged(segment.recorded_torque - at.torque)
            gap[mine] = rows.thin(left, segment)[there] / rows.scale * trust
            matrix = columns(at, rows, {one.effect for one in some})
            for one in some:
                term, places = one.term, list(one.term.columns)
                # inertial columns of the link, combined about the change that it has
                whole, effect = matrix[:, :, places], term.definition
                if is_link_change(term) and isinstance(effect, LinkChange):
                    j, motion = term.joint - 1, segment.motion
                    of_link = bodies.body.link_regressor(
                        j, motion.q, motion.dq, motion.ddq
                    )
                    own = bodies.body.unladen.inertial_parameters().reshape(-1, 10)[j]
                    tangent = effect.tangent(own, j, theta[places])
                    whole = rows.thin(at.as_recorded(of_link) @ tangent, segment)
                whole = whole / rows.scale[:, None] / made.units[term]
                own = whole[there] * trust[:, :, None]
                for j, x in enumerate(columns_of[one]):
                    x[mine] = own[:, j]
    # linear about the values: coordinates count from zero, as those of others do
    for one, value in moved.items():
        scaled = value * made.units[one.term]
        gap += np.stack([x @ scaled for x in columns_of[one]], axis=1)
    return gap, columns_of


def bends(term: Term) -> bool:
    """Whether what a term does is not its columns times its values, or changes what others on its joint do."""
    effect = term.definition
    if isinstance(effect, TorqueLaw):
        return isinstance(effect, DryLaw) and effect.varies_with == "load"
    if isinstance(effect, Path):
        # a limit acts on the recorded torque, whatever the arm has
        return not (effect.additive or effect.limits)
    # a rotor needs torque for the motion that it is seen to make
    return not (isinstance(effect, Inertial) and effect.reach != "arm")


def moving(values: Mapping[Candidate, np.ndarray]) -> dict[Candidate, np.ndarray]:
    """Those of some values about which columns are others: all else adds to them, whatever it is."""
    bent = [one.term for one in values if bends(one.term)]
    # forces on the bodies change nothing between them and the motors
    passed = [t for t in bent if not isinstance(t.definition, (Inertial, External))]
    joints = {term.joint for term in passed}

    def is_carried(term: Term) -> bool:
        """Whether a term acts on a joint whose motion or torque others change on their way to the recorded one."""
        if term.definition.limits:
            return False
        # a motor may turn any joint
        return (
            bool(passed) if term.definition.reach == "motor" else term.joint in joints
        )

    return {
        one: x for one, x in values.items() if one.term in bent or is_carried(one.term)
    }


def lasts(term: Term) -> bool:
    """Whether a term is the same all day: how an arm was built, what bends or has play, and by what it is late."""
    effect = term.definition
    return effect.built_in or effect.delays or isinstance(effect, Transmission)


def is_link_change(term: Term) -> bool:
    """Whether a term changes a link of the arm, and is so a combination of its inertial columns."""
    return isinstance(term.definition, LinkChange) and term.definition.scope == "link"


def design(
    rows: Rows,
    arm: FreeArm,
    shapes: Mapping[Term, tuple[float, ...]],
    units: Mapping[Term, np.ndarray] | None = None,
    only: Collection[str] | None = None,
) -> Design:
    """Columns about an arm.

    Args:
        rows: the rows.
        arm: what all groups share.
        shapes: nonlinear parameters of the terms that have some.
        units: of the terms that another design has, so that their priors are the same.
        only: effects whose terms are wanted; all if ``None``.
    """
    n = arm.arm.n_joints
    terms = Terms(n, dict(shapes), arm.arm.coupled_motors)
    bodies_of, whole = _of_all_segments(rows, arm, terms, only)
    matrix, bodies = whole.terms, whole.inertial
    # columns, the prior of what is shared, and whether a motion may have a value of its own
    blocks = [(bodies * inertial_scale(arm.body), np.full(10 * n, BODIES), False)]
    places, used, usual, count = {}, {}, {}, 10 * n
    nominal = arm.body.inertial_parameters().reshape(n, 10)
    for term in terms.all:
        effect, j = term.definition, term.joint - 1
        if only is not None and term.effect not in only:
            continue
        if is_link_change(term) and isinstance(effect, LinkChange):
            # about an unchanged link
            tangent = effect.tangent(nominal[j], j, np.zeros(len(term.columns)))
            x = bodies[:, :, 10 * j : 10 * j + 10] @ tangent
        elif terms.can_choose(term):
            x = matrix[:, :, list(term.columns)]
        else:
            continue
        unit = _largest(x)
        # of a load on a slide only the mass shows
        if not (unit > MIN_TORQUE).any():
            continue
        # given units keep priors alike when columns are taken again
        unit = (units or {}).get(term, np.maximum(unit, MIN_TORQUE))
        places[term] = np.arange(count, count + len(unit))
        used[term], usual[term] = unit, _usual_size(term, arm.arm)
        count += len(unit)
        prior = _shared(term, unit, usual[term])
        # free bodies and free torque constants cannot be told apart: torque counts as the strongest joint records it
        if "scale" in effect.quantities.values() and j == np.argmax(rows.scale):
            prior = np.zeros(len(unit))
        # a push has columns of its own, a limit shows in the torque itself
        is_form = not (isinstance(effect, External) or effect.limits)
        blocks.append((x / unit, prior, is_form))
    # pushes in parts of a motion: what form error can do to a force
    push = whole.force / np.maximum(_largest(whole.force), MIN_TORQUE**2)
    part = rows.part_of_motion(PUSHES)
    for k in range(PUSHES):
        blocks.append((push * (part == k)[:, None, None], np.zeros(3), True))
    if rows.warmth is not None:
        blocks += _warm(arm, rows.warmth, matrix, terms)
    every, active = [], []
    for j in range(n):
        # joint by joint: all columns of all joints twice over is most of what a diagnosis needs of memory
        x = np.hstack([block[:, j] for block, *_ in blocks]) * rows.trust[:, j, None]
        some = np.flatnonzero((x**2).mean(axis=0) > MIN_TORQUE**2)
        every.append(x[:, some])
        active.append(some)
    # waves come last, each joint's behind those of the joint before
    size = sum(len(prior) for _, prior, _ in blocks)
    waves, first_wave = [], size
    of_joints, of_arm = _waves(rows)
    for j, some in enumerate(active):
        both = [x * rows.trust[:, j, None] for x in (of_joints[j], of_arm)]
        counts = np.cumsum([size, *(x.shape[1] for x in both)])
        mine = [np.arange(a, b) for a, b in pairwise(counts.tolist())]
        size = int(counts[-1])
        waves.append(mine)
        every[j] = np.hstack([every[j], *both])
        active[j] = np.concatenate([some, *mine])
    # without a prior until noise is learnt: ``FormError.primed`` gives them theirs
    blocks.append((matrix[:, :, :0], np.zeros(size - first_wave), False))
    return Design(
        rows=rows,
        bodies=bodies_of,
        terms=terms,
        places=places,
        units=used,
        usual=usual,
        columns=every,
        active=active,
        gap=whole.gap * rows.trust,
        prior=np.concatenate([prior for _, prior, _ in blocks]),
        taken=_taken(arm, places, used, size),
        own=np.concatenate([np.full(len(prior), own) for _, prior, own in blocks]),
        waves=waves,
        noisy=_noisy(rows, terms, places, used, active),
    )


def _largest(columns: np.ndarray) -> np.ndarray:
    """RMS of columns, (M, n, K), on the joint on which it is largest, (K,)."""
    return np.asarray(np.sqrt((columns**2).mean(axis=0)).max(axis=0))


def _warm(
    arm: FreeArm, warmth: np.ndarray, matrix: np.ndarray, terms: Terms
) -> Iterator[tuple[np.ndarray, np.ndarray, bool]]:
    """Friction that follows the temperature of its joint, F (1 + a (T - mean)), to first order in a.

    Each column, (M, n, 1), has a joint's torque as its largest; with its deviation, and that motions have none.
    """
    for term in terms.all:
        if not is_day_friction(term):
            continue
        place = term.columns[0]
        friction = matrix[:, :, [place]] * arm.theta[place]
        column = friction * warmth[:, term.joint - 1, None, None]
        unit = _largest(column)
        if unit > MIN_TORQUE:
            yield column / unit, PER_KELVIN * unit, False


def is_day_friction(term: Term) -> bool:
    """Whether a term is friction as a data sheet has it, which differs from day to day."""
    return term.parametrisation.data_sheet is not None and not term.definition.built_in


def _of_all_segments(
    rows: Rows, arm: FreeArm, terms: Terms, only: Collection[str] | None
) -> tuple[list[Bodies], PartOfDesign]:
    """What a design takes of all segments, one after the other, over the joints' scale [1]."""
    count = len(rows.segments)
    parts = [_part(rows, k, arm, terms, only) for k in range(count)]
    fields = zip(*(part for _, part in parts), strict=True)
    whole = PartOfDesign(*map(np.concatenate, fields))
    for x in whole:
        # joints are the second axis
        x /= rows.scale.reshape(-1, *(1,) * (x.ndim - 2))
    return [bodies for bodies, _ in parts], whole


def _part(
    rows: Rows,
    k: int,
    arm: FreeArm,
    terms: Terms,
    only: Collection[str] | None = None,
) -> tuple[Bodies, PartOfDesign]:
    """What a design takes of a segment; what searched parameters do not change is kept until another arm is asked for.

    On long logs that is more than memory should hold.
    """
    segment, searched = rows.segments[k], {term.effect for term in terms.shapes}
    # about another arm nothing of it holds
    if rows.kept is None or rows.kept.about is not arm:
        rows.kept = Kept(arm, {})
    _, kept = rows.kept.parts.get(id(segment), (segment, None))
    bodies = Bodies(arm.bodies, segment)
    if kept is not None and not searched:
        return bodies, kept
    at = arm.point(bodies, terms)
    if kept is not None:
        # terms without values of their searched parameters have columns of zero
        own = columns(at, rows, searched)
        return bodies, kept._replace(terms=kept.terms + own)
    regressor = bodies.regressor()
    # of torque beyond a limit only what reached the joint counts
    delivered = arm.corrected(terms).delivered(segment.recorded_torque, segment.motion)
    part = PartOfDesign(
        columns(at, rows, only),
        # bodies of both groups as their torque is recorded, whatever lies on the way to it
        rows.thin(at.as_recorded(regressor), segment),
        rows.thin(bodies.force, segment),
        rows.thin(segment.bridged(delivered - at.torque), segment),
    )
    # searched columns change from look to look: only others are worth keeping
    if (
        only is None
        and not searched
        and part.terms.size * len(rows.segments) < MAX_KEPT
    ):
        rows.kept.parts[id(segment)] = segment, part
    return bodies, part


def _waves(rows: Rows) -> tuple[list[np.ndarray], np.ndarray]:
    """Waves of each joint's own state, and of the state of all joints, of RMS torque 1 together on each row, (M, K).

    An unknown function f ~ N(0, omega^2) of the state x, over its deviation, that is alike where states are near, is

        f(x) = sum_k c_k sqrt(2 / K) cos(w_k x + p_k),    c_k ~ N(0, omega^2)

    with wave numbers w_k drawn from the spectral density of its covariance [rahimi2007].
    """
    # a joint that is counted the other way round has the same functions
    skewness = ((rows.position - rows.position.mean(axis=0)) ** 3).sum(axis=0)
    sense = np.where(skewness < 0, -1.0, 1.0)
    state = np.hstack([rows.position * sense, rows.velocity * sense])
    state = over_deviation(state)
    n = rows.position.shape[1]
    # what spans have of their own is looked for, and then asked, beside the same functions
    few = rows.parted or rows.group.max() >= 2
    of_joint, of_arm = FEWER_WAVES if few else WAVES
    own = [drawn_waves(state[:, [j, n + j]], of_joint) for j in range(n)]
    return own, drawn_waves(state, of_arm)


def drawn_waves(state: np.ndarray, count: int) -> np.ndarray:
    """Waves of a state, (M, d), the same ones whenever they are drawn: (M, K)."""
    d = state.shape[1]
    rng = np.random.default_rng(d)
    tails = np.sqrt(rng.chisquare(TAILS, count) / TAILS)
    # normal over the root of chi-squared is Student's t; in more dimensions
    # states lie farther apart, so waves are longer
    numbers = rng.normal(size=(d, count)) / tails / np.sqrt(d / 2)
    phases = rng.uniform(0, 2 * np.pi, count)
    return np.sqrt(2 / count) * np.cos(state @ numbers + phases)


def fitted_arm(rows: Rows, arm: NominalArm, groups: Collection[int]) -> FreeArm:
    """The arm that predicts some groups best: bodies, rotors, friction, springs and offsets, whatever they are.

    Ridge regression: inertials within three times their own size of the nominal ones, all else twice the deviation of
    the torque; joints weighted by what is left. From then on ``rows`` are trusted less where its dry friction may hold
    a joint.
    """
    start = FreeArm.nominal(arm)
    # every arm has them on each joint, of a size that only the data say
    free = [
        e
        for e in Terms(arm.n_joints, {}, arm.coupled_motors).definitions
        if (e.reach == "joint" and not e.fitted.nonlinear)
        and (np.isinf(e.fitted.usual) or e.fitted.data_sheet is not None)
    ]
    made, given = design(rows, start, {}, only={e.name for e in free}), rows.trust
    dry = [made.terms.block(e.name)[0] for e in free if isinstance(e, DryLaw)]
    prior = np.where(untaken(made), 0.0, made.prior)
    # other groups say nothing of the arm, whatever they have, nor of how much torque is wide
    told = np.isin(rows.group, list(groups))
    size = np.zeros(made.size)
    for x, active in zip(made.columns, made.active, strict=True):
        own = np.sqrt((x[told] ** 2).mean(axis=0))
        size[active] = np.maximum(size[active], own)
    of_terms = slice(10 * arm.n_joints, None)
    prior[of_terms] /= np.maximum(size[of_terms], MIN_TORQUE)
    left = np.full(arm.n_joints, PRECISE)
    for _ in range(ROUNDS):
        # joints weigh by what is left of them, so the fit is repeated
        trust = rows.trust[told]
        weight = trust / given[told]
        normal, right = np.eye(made.size), np.zeros(made.size)
        for j, (x, active) in enumerate(zip(made.columns, made.active, strict=True)):
            mine = prior[active] > 0
            places, by = active[mine], weight[:, j, None] / left[j]
            scaled = x[np.ix_(told, mine)] * prior[places] * by
            normal[np.ix_(places, places)] += scaled.T @ scaled
            right[places] += scaled.T @ (made.gap[told, j] * by[:, 0])
        inverse = np.linalg.inv(normal)
        value = prior * (inverse @ right)
        missed = (made.gap - made.shared_torque(value))[told] * weight
        rms = np.sqrt((missed**2).sum(axis=0) / (trust**2).sum(axis=0))
        left = np.maximum(rms, PRECISE)
        found = moved(start, made, value)
        # where its friction may hold it rows count less in the next round
        friction = np.abs(found.theta[dry]).sum(axis=0)
        unsure = _unsure_friction(made, prior * np.sqrt(np.diag(inverse)), rows)
        rows.held(friction + unsure, left, arm.per_radian)
    return replace(found, taken=None)


def _unsure_friction(made: Design, std: np.ndarray, rows: Rows) -> np.ndarray:
    """Deviation of the joints' dry friction [N m], (n,), from those of what is shared.

    Of a joint that rests, friction may take all that its torque does.
    """
    out = rows.scale.copy()
    for term, places in made.places.items():
        if isinstance(term.definition, DryLaw):
            j = term.joint - 1
            out[j] = min(out[j], float(std[places][0] / made.units[term][0]))
    return out


def possible(arm: FreeArm, made: Design, value: np.ndarray) -> np.ndarray:
    """Values of what is shared, (P,), as far as the arm can take them."""
    out, theta = value.copy(), arm.theta.copy()
    for term in _linear(made):
        theta[list(term.columns)] += value[made.places[term]] / made.units[term]
    # clipped as a whole: coordinates of one effect may bound each other
    change = made.terms.clipped(theta) - arm.theta
    for term in _linear(made):
        out[made.places[term]] = change[list(term.columns)] * made.units[term]
    return out


def moved(arm: FreeArm, made: Design, value: np.ndarray) -> FreeArm:
    """The arm with values of what is shared, (P,), taken into it.

    Compliance and free play stay linear: their columns are those of their beginning.
    """
    n, theta = arm.arm.n_joints, arm.theta.copy()
    before = arm.taken or (np.zeros(10 * n), {})
    bodies = value[: 10 * n] * inertial_scale(arm.body)
    terms = {}
    for term in _linear(made):
        change = value[made.places[term]] / made.units[term]
        theta[list(term.columns)] += change
        terms[term] = before[1].get(term, 0.0) + change
    return replace(
        arm,
        increments=arm.increments + bodies.reshape(n, 10),
        theta=made.terms.clipped(theta),
        taken=(before[0] + bodies, terms),
    )


def untaken(made: Design) -> np.ndarray:
    """Mask of what is shared that no arm takes, (P,): unknown functions, and terms that stay linear."""
    out = np.ones(made.size, dtype=bool)
    out[: 10 * made.gap.shape[1]] = False
    for term in _linear(made):
        out[made.places[term]] = False
    return out


def _linear(made: Design) -> list[Term]:
    """Terms whose columns are those of their law about the arm."""
    return [
        term
        for term in made.places
        if term.definition.locally_linear and not term.parametrisation.nonlinear
    ]


def _taken(
    arm: FreeArm,
    places: Mapping[Term, np.ndarray],
    units: Mapping[Term, np.ndarray],
    size: int,
) -> np.ndarray:
    """What the arm has already of what is shared, in units of the columns, (P,)."""
    out = np.zeros(size)
    if arm.taken is None:
        return out
    bodies, terms = arm.taken
    out[: len(bodies)] = bodies / inertial_scale(arm.body)
    for term, value in terms.items():
        if term in places:
            out[places[term]] = value * units[term]
    return out


def _usual_size(term: Term, arm: NominalArm) -> float:
    """Size of a term's coordinates that is usual where it is an effect."""
    effect, size = term.definition, term.parametrisation.usual
    if effect.scope != "joint" or effect.reach == "motor" or len(effect.needed) > 1:
        return size
    slides = arm.sliding[term.joint - 1]
    return size * float(size_per_radian(effect.parameters[0].unit, [slides])[0])


def _shared(term: Term, unit: np.ndarray, usual: float) -> np.ndarray:
    """Deviation of what all groups may share of a term, in units of its columns, (linear,)."""
    effect = term.definition
    # the bodies are free already
    # what is searched may be everybody's or a group's own: both are candidates
    if isinstance(effect, LinkChange) or effect.fitted.nonlinear:
        return np.zeros(len(unit))
    if isinstance(effect, Transmission):
        return np.full(len(unit), STIFF)
    if effect.fitted.data_sheet is not None or np.isinf(usual):
        prior = np.full(len(unit), WIDE)
        if effect.fitted.constant is not None:
            # the offset of its joint has it: two that do the same would share it, and bounds cut off one of them
            prior[effect.fitted.constant] = 0.0
        return prior
    # what has a usual size cannot be told from free bodies otherwise; a healthy arm has less
    return np.minimum(HEALTHY * usual * unit, WIDE)


def _noisy(
    rows: Rows,
    terms: Terms,
    places: Mapping[Term, np.ndarray],
    units: Mapping[Term, np.ndarray],
    active: list[np.ndarray],
) -> dict[tuple[int, int], np.ndarray]:
    """Share of the recorded torque's noise in the columns of limits: all where the torque is beyond, in their unit."""
    out = {}
    for term, (place, *_) in places.items():
        if not term.definition.limits:
            continue
        j, limit = term.joint - 1, terms.shapes[term][0]
        beyond = [
            rows.thin((np.abs(np.asarray(s.torque)[:, j]) > limit).astype(float), s)
            for s in rows.segments
        ]
        at = int(np.searchsorted(active[j], place))
        out[j, at] = np.concatenate(beyond) / units[term][0]
    return out
