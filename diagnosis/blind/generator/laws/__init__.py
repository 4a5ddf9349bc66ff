"""All laws of the generator, by name."""

from __future__ import annotations

from diagnosis.blind.generator.law import Law
from diagnosis.blind.generator.laws.actuation import ACTUATION
from diagnosis.blind.generator.laws.body import BODY
from diagnosis.blind.generator.laws.faults import FAULTS
from diagnosis.blind.generator.laws.friction import FRICTION
from diagnosis.blind.generator.laws.outside import OUTSIDE
from diagnosis.blind.generator.laws.sensing import SENSING
from diagnosis.blind.generator.laws.transmission import TRANSMISSION

LAWS: dict[str, Law] = {
    law.name: law for law in (*FRICTION, *BODY, *TRANSMISSION, *ACTUATION, *SENSING, *FAULTS, *OUTSIDE)
}
INSIDE = tuple(law.name for law in (*FRICTION, *BODY, *TRANSMISSION, *ACTUATION, *SENSING))
"""Names of the effects that stand in the catalogue."""
SETUP = tuple(law.name for law in FAULTS)
"""Names of the faults of the set-up."""
BEYOND = tuple(law.name for law in OUTSIDE)
"""Names of the laws outside the catalogue."""
