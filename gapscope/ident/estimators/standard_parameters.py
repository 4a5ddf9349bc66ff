"""What estimators of standard parameters share: which columns belong to which link, a reference body, the factor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gapscope.arm.dynamics.rigid_body import INERTIAL_PARAMETERS
from gapscope.arm.errors import InputError
from gapscope.ident.estimators.linear_estimator import (
    Factor,
    column_norms,
    joint_noise,
    whitened,
)
from gapscope.ident.model.linear_problem import Problem
from gapscope.ident.model.pseudo_inertia import is_consistent, pseudo_inertia
from gapscope.ident.model.solvable import check_samples, unit_warnings

NOT_NEGATIVE = re.compile(r"[Ibcds]\d+")
"""Names of rotor inertia, viscous and Coulomb friction, which take energy or store it and cannot be negative."""
REFERENCE_MASS = 1.0
"""Mass of the body that replaces a link if there is no prior [kg]."""
REFERENCE_RADIUS = 0.1
"""Its radius of gyration about each plane [m]."""
LEAST_NOISE = 1e-4
"""Noise is taken to be at least this share of the torque's RMS, which keeps the programme well scaled [1]."""


@dataclass(frozen=True)
class StandardColumns:
    """Columns of standard parameters, L links.

    Attributes:
        links: places of each link's ten parameters, shape (L, 10).
        others: places of the rest, shape (o,).
        bounded: which of those may not be negative, shape (o,).
    """

    links: np.ndarray
    others: np.ndarray
    bounded: np.ndarray

    @classmethod
    def of(cls, names: Sequence[str]) -> StandardColumns:
        """Found by name; raises ``InputError`` if no link has all ten parameters in their order."""
        names = tuple(names)
        starts = [
            i
            for i, name in enumerate(names)
            if re.fullmatch(r"m\d+", name)
            and names[i : i + 10]
            == tuple(f"{parameter}{name[1:]}" for parameter in INERTIAL_PARAMETERS)
        ]
        if not starts:
            raise InputError(
                "no link has its ten standard parameters among the columns",
                "build the problem from all columns of Regressor.matrix, not from base columns",
                where="names",
            )
        links = np.array(starts)[:, None] + np.arange(10)
        others = np.setdiff1d(np.arange(len(names)), links)
        bounded = np.array(
            [NOT_NEGATIVE.fullmatch(names[i]) is not None for i in others], dtype=bool
        )
        if any(re.fullmatch(r"m[xyz]?\d+|I[xyz]{2}\d+", names[i]) for i in others):
            raise InputError(
                "some link lacks some of its ten parameters",
                "give all ten, in order",
                where="names",
            )
        return cls(links, others, bounded)


@dataclass(frozen=True)
class ReferenceParameters:
    """The bodies and coefficients that a pull draws to.

    Attributes:
        links: inertial parameters, shape (L, 10), consistent.
        mass: the unit of mass per link [kg], shape (L,).
        radius: the unit of length per link [m], shape (L,).
        others: shape (o,).
        other_units: what counts as a change of one, shape (o,).
    """

    links: np.ndarray
    mass: np.ndarray
    radius: np.ndarray
    others: np.ndarray
    other_units: np.ndarray

    @classmethod
    def of(
        cls, columns: StandardColumns, prior: np.ndarray | None, names: Sequence[str]
    ) -> ReferenceParameters:
        """Of a prior, shape (p,), or the same body for every link if there is none."""
        if prior is None:
            return cls._same_body(columns)
        prior = np.asarray(prior, dtype=float)
        links, others = prior[columns.links], prior[columns.others]
        wrong = np.flatnonzero(~is_consistent(links))
        if len(wrong):
            raise InputError(
                f"the prior of {names[columns.links[wrong[0], 0]]} and its link is no physical body",
                "correct mass, centre of mass and inertia in the URDF, or estimate without a prior",
                where="prior",
            )
        mass = links[:, 0]
        # radius of gyration: the mean second moment over the mass
        second = np.trace(pseudo_inertia(links)[:, :3, :3], axis1=1, axis2=2)
        radius = np.sqrt(second / 3 / mass)
        units = np.where(np.abs(others) > 0, np.abs(others), 1.0)
        return cls(
            links=links,
            mass=mass,
            radius=radius,
            others=others,
            other_units=units,
        )

    @classmethod
    def _same_body(cls, columns: StandardColumns) -> ReferenceParameters:
        """A ball of ``REFERENCE_MASS`` and ``REFERENCE_RADIUS`` for every link."""
        count = len(columns.links)
        inertia = 2 * REFERENCE_MASS * REFERENCE_RADIUS**2
        body = [REFERENCE_MASS, 0, 0, 0, inertia, 0, inertia, 0, 0, inertia]
        zeros = np.zeros(len(columns.others))
        return cls(
            links=np.tile(np.array(body, dtype=float), (count, 1)),
            mass=np.full(count, REFERENCE_MASS),
            radius=np.full(count, REFERENCE_RADIUS),
            others=zeros,
            other_units=zeros + 1.0,
        )

    @property
    def link_units(self) -> np.ndarray:
        """What counts as a change of one of each inertial parameter, shape (L, 10)."""
        powers = np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
        return self.mass[:, None] * self.radius[:, None] ** powers


def standard_factor(
    problem: Problem, prior: np.ndarray | None
) -> tuple[Factor, tuple[str, ...]]:
    """Equations whitened per joint as a triangle of standard columns, which may lack rank; and warnings of the unit.

    Raises:
        InputError: the samples are not finite, or the arm rests.
    """
    check_samples(problem, full_rank=False)
    factor = Factor.of(*problem.stacked())
    norms = column_norms(factor.triangle)
    unit = factor.triangle / norms
    free = np.linalg.lstsq(unit, factor.rotated, rcond=1e-9)[0] / norms
    warnings: tuple[str, ...] = ()
    if prior is not None:
        warnings = unit_warnings(problem, np.asarray(prior, dtype=float))
    least = LEAST_NOISE * float(np.sqrt((problem.torque**2).mean()))
    # standard columns lack rank: a free fit serves for the noise alone
    noise = np.maximum(joint_noise(problem, free), least)
    return Factor.of(*whitened(problem, noise)), warnings
