"""All laws of the generator, by name."""

from __future__ import annotations

from gapscope.blind_check.generator.law import Law
from gapscope.blind_check.generator.laws.actuation import ACTUATION
from gapscope.blind_check.generator.laws.body import BODY
from gapscope.blind_check.generator.laws.faults import FAULTS
from gapscope.blind_check.generator.laws.friction import FRICTION
from gapscope.blind_check.generator.laws.outside import OUTSIDE
from gapscope.blind_check.generator.laws.sensing import SENSING
from gapscope.blind_check.generator.laws.transmission import TRANSMISSION

LAWS: dict[str, Law] = {
    law.name: law
    for law in (
        *FRICTION,
        *BODY,
        *TRANSMISSION,
        *ACTUATION,
        *SENSING,
        *FAULTS,
        *OUTSIDE,
    )
}
INSIDE = tuple(
    law.name for law in (*FRICTION, *BODY, *TRANSMISSION, *ACTUATION, *SENSING)
)
"""Names of the effects that are in the catalogue."""
SETUP = tuple(law.name for law in FAULTS)
"""Names of the faults of the set-up."""
BEYOND = tuple(law.name for law in OUTSIDE)
"""Names of the laws outside the catalogue."""
