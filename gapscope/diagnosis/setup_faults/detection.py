"""Setup faults of a case: tested before any physics, since they look like large physics.

Time stamps are read from the recordings themselves. For everything else the torque decides: a fault is named if an
ordinary arm, with unknown load, inertials, friction, torque scales and springs, explains held-out torque decisively
better once the recordings are read as the fault would have it. Faults are corrected one after the other, best first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gapscope.arm.case import Case
from gapscope.arm.dynamics.rigid_body import RigidBody
from gapscope.arm.errors import GapscopeError
from gapscope.arm.io.plausibility import PLAUSIBLE_RATES
from gapscope.arm.root_mean_square import rms
from gapscope.diagnosis.gap.plausible_data import check_rates, select_windows
from gapscope.diagnosis.setup_faults.clocks import (
    find_stamps,
    find_torque_clock,
)
from gapscope.diagnosis.setup_faults.fault_search import (
    faults_by_torque,
    is_of_other_bodies,
    unit_of_nominal_arm,
)
from gapscope.diagnosis.setup_faults.found_fault import FoundFault, merged, repaired
from gapscope.diagnosis.thresholds import NO_TORQUE, VISIBLE_EFFECT
from gapscope.effects.corrected import CorrectedArm
from gapscope.effects.setup_faults import LateTorque, TimeStamps
from gapscope.model.conditioning import (
    Segment,
    condition,
)
from gapscope.model.readings import UNUSUAL, as_mounted
from gapscope.model.torque_gap import torque_gap


def find_setup_faults(case: Case) -> tuple[FoundFault, ...]:
    """Setup faults of a case, in the order in which they must be corrected.

    Args:
        case: the case as it was read.

    Raises:
        InputError: time stamps cannot be put right.
    """
    if not case.recordings:
        return ()
    # stamps first: every filter and derivative rests on them
    stamps = find_stamps((*case.recordings, *case.judged))
    even = repaired(case, stamps)
    check_rates(even)
    # then one clock: the search compares motion and torque row by row
    clock = find_torque_clock(select_windows(even))
    if clock is not None:
        stamps = (*stamps, clock)
        even = repaired(case, stamps)
    shown = faults_by_torque(select_windows(even))
    # gaps are those of the case as it was read, stamps included
    return _with_gaps(select_windows(case), merged((*stamps, *shown)))


def _that_close(case: Case, faults: tuple[FoundFault, ...]) -> tuple[FoundFault, ...]:
    """Faults whose repair closes as much of the gap as an effect has to close to be named."""
    while faults:
        least = min(faults, key=_closes)
        if _closes(least) >= VISIBLE_EFFECT:
            break
        # one after the other: without it the others may close more
        others = tuple(fault for fault in faults if fault is not least)
        faults = _with_gaps(select_windows(case), others)
    return faults


def _closes(fault: FoundFault) -> float:
    """How much larger the gap is without a fault, RMS over joints [1]; infinite if not the torque alone shows it."""
    without, after = fault.gap_without_this, fault.gap_after
    if fault.log_odds is None or without is None or after is None:
        return np.inf
    return float(rms(without, None) - rms(after, None))


def on_one_clock(case: Case) -> Case:
    """The case on an even clock, the same for motion and torque, as far as the channels and the nominal arm tell.

    What is compared row by row, such as a control law with its torque, asks for that before other faults are known.
    """
    # which velocities are whose is not known yet
    every = (*case.recordings, *case.judged)
    even = repaired(case, find_stamps(every, by_velocity=False))
    clock = find_torque_clock(select_windows(even))
    return even if clock is None else repaired(even, (clock,))


def _with_gaps(case: Case, faults: tuple[FoundFault, ...]) -> tuple[FoundFault, ...]:
    """The faults with the torque gap of the nominal arm with and without each."""
    if not faults:
        return ()
    nominal, all_repaired = nominal_gap(case), nominal_gap(repaired(case, faults))
    out = []
    for k, fault in enumerate(faults):
        # of a single fault these are known already
        only_this, without_this = all_repaired, nominal
        if len(faults) > 1:
            only_this = nominal_gap(repaired(case, (fault,)))
            without_this = nominal_gap(repaired(case, faults[:k] + faults[k + 1 :]))
        out.append(
            replace(
                fault,
                gap_before=nominal,
                gap_after=all_repaired,
                gap_with_only_this=only_this,
                gap_without_this=without_this,
            )
        )
    return tuple(out)


def upright(case: Case) -> Case:
    """The case with the gravity that its torque shows, if its base is mounted turned."""
    return replace(case, arm=as_mounted(case.arm, _segments(select_windows(case))))


def is_another_arm(case: Case, faults: Sequence[FoundFault]) -> bool:
    """Whether the recordings are of another arm than the nominal one, or their torque is in another unit.

    Then its bodies explain less of the torque than its faults ask for; or it is far off and beyond what the drives
    can give.

    Args:
        case: the case, faults of its set-up put right.
        faults: these.
    """
    mounted = upright(case)
    gap = nominal_gap(mounted)
    if gap is None:
        return False
    # a wrong load is as far off, but stays within what the drives give
    if rms(gap, None) > NO_TORQUE and _beyond_its_drives(mounted):
        return True
    # when the torque was recorded says nothing of bodies
    of_bodies = [f for f in faults if f.name not in (TimeStamps.name, LateTorque.name)]
    # each fault is as improbable as another robot, and was fitted
    owed = sum(UNUSUAL + fault.charge for fault in of_bodies) - UNUSUAL
    return is_of_other_bodies(select_windows(mounted), owed)


def _beyond_its_drives(case: Case) -> bool:
    """Whether the torque of a joint is in the RMS beyond the largest that the robot file allows; 0 there is silence."""
    limit = RigidBody(case.arm).effort_limits()
    torque = np.vstack([r.tau for r in case.recordings if r.tau is not None])
    return bool(((rms(torque, 0) > limit) & (limit > 0)).any())


def as_nominal_arm(
    case: Case, faults: Sequence[FoundFault]
) -> tuple[tuple[FoundFault, ...], bool]:
    """Faults of the set-up with which a case is of its nominal arm, and whether it is of another one all the same.

    Of another arm only the faults of time are kept: what else its torque seems to show is how the two arms differ. The
    bodies of two arms of one joint differ by a factor alone, so that its torque is in another unit.

    Args:
        case: the case as it was read.
        faults: that its torque shows.
    """
    if not is_another_arm(repaired(case, tuple(faults)), faults):
        return _that_close(case, tuple(faults)), False
    of_time = only_of_time(faults)
    # without the other faults, which were found against bodies that do not fit
    right = select_windows(repaired(case, of_time))
    unit = unit_of_nominal_arm(right) if case.arm.n_joints == 1 else None
    if unit is None:
        return of_time, True
    return _with_gaps(select_windows(case), (*of_time, unit)), False


def only_of_time(faults: Sequence[FoundFault]) -> tuple[FoundFault, ...]:
    """The faults of time stamps among others."""
    return tuple(fault for fault in faults if fault.name == TimeStamps.name)


def nominal_gap(case: Case) -> np.ndarray | None:
    """Torque NRMSE of the nominal arm over all recordings with a torque, (n,); ``None`` if it makes no sense."""
    segments, arm = _segments(case), case.arm
    if not segments:
        return None
    try:
        gap = torque_gap(CorrectedArm(arm), RigidBody(arm), segments).nrmse
    except (GapscopeError, ValueError):
        return None
    return gap if np.isfinite(gap).all() else None


def _segments(case: Case) -> list[Segment]:
    """Segments of all recordings with a torque; none if they cannot be conditioned."""
    recordings = tuple(r for r in (*case.recordings, *case.judged) if r.tau is not None)
    # stamps in another unit: filters cannot take such a rate
    if not recordings or min(r.rate for r in recordings) < PLAUSIBLE_RATES[0]:
        return []
    try:
        return [s for r in recordings for s in condition(r)]
    except (GapscopeError, ValueError):
        return []
