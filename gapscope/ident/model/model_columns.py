"""The model of the pipeline, tau = W x: rigid bodies, rotors and friction of joints and coupled motors, offsets."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.joint_units import units_of
from gapscope.arm.motions.motion import Motion
from gapscope.arm.nominal import NominalArm
from gapscope.ident.model.friction_law import FrictionLaw, drives
from gapscope.ident.model.regressor import Regressor

SMOOTH = ("rotor", "damping", "offset")
"""Quantities of drives whose columns do not depend on the friction law."""
LEAST_ARM = 0.05
"""Lever that a link's first moment is at least counted with in its unit [m]."""


class ModelColumns:
    """W with tau = W x for an arm of n joints.

    First the ten inertial parameters of each link, rotor inertia I [kg m^2], viscous friction b [N m s/rad] and offset
    o [N m] of each joint, and I and b of each motor that moves several joints (``I6m``: motor 6, on the side of joint
    6); then dry friction by a ``FrictionLaw``: c and d [N m] of joints and coupled motors.

    The friction law counts positions and speeds of slides in what counts as a radian of them.

    Args:
        arm: the nominal arm; its coupling says which motors move several joints.
        body: rigid bodies of the arm; built if ``None``.
    """

    def __init__(
        self,
        arm: NominalArm,
        body: RigidBody | None = None,
    ) -> None:
        self.arm, self.body = arm, body or RigidBody(arm)
        self.drives, self.labels = drives(arm)
        self.regressor = Regressor(arm, self.body, SMOOTH)
        self._motors = arm.coupled_motors
        own = arm.per_radian[[motor - 1 for motor in self._motors]]
        self.per_radian = np.r_[arm.per_radian, own]
        self.links = 10 * arm.n_joints

    @property
    def coupled(self) -> tuple[str, ...]:
        """Labels of the coupled motors, ``6m``."""
        return self.labels[self.arm.n_joints :]

    def names(self, law: FrictionLaw) -> tuple[str, ...]:
        """Names of x, shape (p,)."""
        smooth = [f"{symbol}{label}" for symbol in ("I", "b") for label in self.coupled]
        dry = [f"{shape}{label}" for shape in law.shapes for label in self.labels]
        return (*self.regressor.names, *smooth, *dry)

    def units(self, law: FrictionLaw) -> tuple[str, ...]:
        """Units of x, shape (p,)."""
        slides = (*self.arm.sliding, *(self.arm.sliding[m - 1] for m in self._motors))
        coupled = slides[self.arm.n_joints :]
        dry = units_of("N m", slides) * len(law.shapes)
        smooth = (*units_of("kg m^2", coupled), *units_of("N m s/rad", coupled))
        return (*self.regressor.units, *smooth, *dry)

    def nominal(self, law: FrictionLaw) -> np.ndarray:
        """The x of the nominal arm and its data sheet, shape (p,)."""
        sheet = self.regressor.nominal()
        # rotor inertia and viscous friction of coupled motors are no part of the sheet
        motors = np.zeros(2 * len(self.coupled))
        dry = np.zeros((len(law.shapes), len(self.drives)))
        # the data sheet gives Coulomb friction of the joints alone
        dry[0, : self.arm.n_joints] = self.arm.coulomb
        return np.concatenate([sheet, motors, dry.ravel()])

    def smooth(self, motion: Motion) -> np.ndarray:
        """Columns that do not depend on the friction law, shape (N, n, p_smooth)."""
        motors = self.drives[self.arm.n_joints :]
        links = self.regressor.matrix(motion)
        inertia = _along(motion.ddq @ motors.T, motors)
        viscous = _along(motion.dq @ motors.T, motors)
        return np.concatenate([links, inertia, viscous], axis=2)

    def dry(self, motion: Motion, law: FrictionLaw) -> np.ndarray:
        """Columns of dry friction, shape (N, n, p_dry)."""
        # of drives that slide, what counts as a radian is one
        to = self.drives.T / self.per_radian
        return np.concatenate(
            [
                _along(x, self.drives)
                for x in law.columns(motion.q @ to, motion.dq @ to)
            ],
            axis=2,
        )

    def matrix(self, motion: Motion, law: FrictionLaw) -> np.ndarray:
        """W of a motion of N samples, shape (N, n, p)."""
        return np.concatenate([self.smooth(motion), self.dry(motion, law)], axis=2)

    def scale(self, law: FrictionLaw) -> np.ndarray:
        """Change of x that counts as 100 %, shape (p,); infinite for parameters that the nominal arm need not have.

        Mass m; first moments m max(|c|, 5 cm); inertia about the joint frame, half its trace.
        """
        out = np.full(len(self.names(law)), np.inf)
        links = self.body.inertial_parameters().reshape(-1, 10)
        for link, (m, hx, hy, hz, xx, _, yy, _, _, zz) in enumerate(links):
            # links of almost no mass still may gain some
            mass = max(m, 1e-2)
            length = float(np.sqrt(hx**2 + hy**2 + hz**2))
            moment = max(length, LEAST_ARM * mass)
            inertia = max(0.5 * (xx + yy + zz), mass * (0.2 * LEAST_ARM) ** 2)
            first = 10 * link
            out[first] = mass
            out[first + 1 : first + 4] = moment
            out[first + 4 : first + 10] = inertia
        return out


def _along(series: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Columns along the drives' directions: (N, k) and (k, n) to (N, n, k)."""
    return series[:, None, :] * directions.T[None]
