"""How far the joints of a machine may go: limits as stated, else what is known of its type."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from loopcal.mechanisms.mechanism import Mechanism


@dataclass(frozen=True)
class Limit:
    """Range of a joint's reading [SI]; source: "limits" as stated, or "turn": half a turn either
    way, because nobody states any."""

    low: float
    high: float
    source: str


def joint_limits(mechanism: Mechanism) -> Mapping[str, Limit]:
    """The joints of a serial arm, by name; slides without stated limits are left out."""
    listed = (mechanism.description or {}).get("joints", ())
    stated = {joint.name: getattr(joint, "limits", None) for joint in listed}
    turning = {s.joint for s in mechanism.chain if s.joint and s.motion[0] == "r"}
    found = {name: Limit(-math.pi, math.pi, "turn") for name in sorted(turning)}
    found |= {
        name: Limit(span[0], span[1], "limits") for name, span in stated.items() if span is not None
    }
    return {q: limit for q, limit in found.items() if q in mechanism.quantities}
