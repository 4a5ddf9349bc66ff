"""Moving bodies whose inertials no real body has; they are simulated as they are, with a warning."""

from __future__ import annotations

import numpy as np

from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.dynamics.robot_file import listed

EXCESS = 1e-3
"""Share by which the largest moment may exceed the sum of the others, for rounding."""


def odd_inertials(body: RigidBody) -> tuple[str, ...]:
    """What is odd about the moving bodies of an arm, merged with what is fixed to them; a sentence each."""
    notes = []
    for joint, (name, link) in enumerate(zip(body.joints, body.links, strict=True), 1):
        inertia = body.model.inertias[int(link)]
        moments = np.linalg.eigvalsh(inertia.inertia)
        place = f"{body.file}: the link moved by joint {joint} ({name})"
        if inertia.mass == 0 and not moments.any():
            notes.append(
                f"{place} has no <inertial>: it is simulated without mass; give it one if it has any"
            )
        elif inertia.mass == 0:
            notes.append(
                f"{place} has moments of inertia but no mass, which no body has; correct <mass>"
            )
        elif moments[2] > (1 + EXCESS) * (moments[0] + moments[1]):
            notes.append(
                f"{place} has the principal moments of inertia {listed(moments)} kg m^2, of which no body has one "
                "above the sum of the others: they are simulated as they are; correct <inertia> if you can"
            )
    return tuple(notes)
