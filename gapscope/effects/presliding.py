"""Presliding: dry friction that builds up over a small distance after each reversal, as bristles that bend.

Dahl's state s = z / z_s, the bend of the bristles over the distance z_s at which they slip, follows the joint by

    ds/dt = dq/dt / z_s (1 - s sgn(dq/dt))

and takes the place of sgn(dq/dt) in the laws of dry friction (dahl1976). At rest it keeps its value, where the sign of
the velocity says nothing.
"""

from __future__ import annotations

import numpy as np

from gapscope.arm.nominal import smooth_sign


def friction_direction(
    position: np.ndarray, velocity: np.ndarray, distance: np.ndarray
) -> np.ndarray:
    """What stands for sgn v in dry friction [1], between -1 and 1, shape (N, n).

    Args:
        position: q [rad], a series in time, shape (N, n).
        velocity: dq [rad/s], (N, n).
        distance: z_s [rad], (n,); where it is 0 friction follows the smoothed sign of the velocity at once, which is
            also where the state begins elsewhere.
    """
    direction = smooth_sign(velocity)
    bends = np.flatnonzero(distance)
    if bends.size:
        first = direction[0, bends]
        direction[:, bends] = _bend(position[:, bends], distance[bends], first)
    return direction


def _bend(position: np.ndarray, distance: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Dahl's state along a path [rad], (N, k), with z_s and the state at first of shape (k,).

    A step dq without reversal takes s to sgn dq + (s - sgn dq) exp(-|dq| / z_s), exactly: an affine map, so that the
    state is the running composition of maps, which takes log2 N passes over the series instead of N steps.
    """
    step = np.diff(position, axis=0, prepend=position[:1])
    factor = np.exp(-np.abs(step) / distance)
    state = np.sign(step) * (1.0 - factor)
    state[0] = first
    reach = 1
    while reach < len(position):
        # the map of the last `reach` steps after that of the `reach` steps before them
        state[reach:] += factor[reach:] * state[:-reach].copy()
        factor[reach:] *= factor[:-reach].copy()
        reach *= 2
    return state
