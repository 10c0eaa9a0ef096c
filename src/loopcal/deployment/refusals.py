"""Targets that are not corrected, each for a reason with a name and a number."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Reason = Literal[
    "configuration-changed",
    "configuration-missing",
    "moved-too-far",
    "not-reached",
    "not-stated",
    "outside-limits",
    "singular",
]


@dataclass(frozen=True)
class Refusal:
    """Why a target stays as it is, in words for a user."""

    reason: Reason
    words: str
