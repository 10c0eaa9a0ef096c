"""An order of poses with short joint travel: nearest neighbour, then 2-opt.

All joints move at once. So the way between two poses is as long as the longest of their moves, each
in shares of its range.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
# 2-opt of dozens of poses settles in a few rounds; the bound keeps ties from going on forever.
_ROUNDS = 50


def route(joints: Array) -> list[int]:
    """Order of poses (j, n), the first one first; joints in shares of their ranges."""
    n = joints.shape[1]
    if n < 3:
        return list(range(n))
    away = np.abs(joints[:, :, None] - joints[:, None, :]).max(axis=0)
    order = _nearest(away)
    for _ in range(_ROUNDS):
        if not _uncrossed(order, away):
            break
    return order


def travel(joints: Array, order: list[int]) -> float:
    """Length of the way through the poses in this order."""
    at = joints[:, order]
    return float(np.abs(np.diff(at, axis=1)).max(axis=0).sum()) if at.shape[1] > 1 else 0.0


def _nearest(away: Array) -> list[int]:
    order, left = [0], set(range(1, len(away)))
    while left:
        near = min(left, key=lambda j: (away[order[-1], j], j))
        order.append(near)
        left.remove(near)
    return order


def _uncrossed(order: list[int], away: Array) -> bool:
    """Turn round parts of the way that are shorter so; whether any was."""
    n, changed = len(order), False
    for i in range(n - 2):
        at = np.array(order)
        a, b = at[i], at[i + 1]
        c = at[i + 2 :]
        after = np.append(at[i + 3 :], -1)
        # the way ends anywhere: turning round its end drops one link only
        old = away[a, b] + np.where(after >= 0, away[c, after], 0.0)
        new = away[a, c] + np.where(after >= 0, away[b, after], 0.0)
        j = int(np.argmax(old - new))
        if old[j] - new[j] > 1e-12:
            end = i + 2 + j
            order[i + 1 : end + 1] = order[i + 1 : end + 1][::-1]
            changed = True
    return changed
