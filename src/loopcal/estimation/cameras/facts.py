"""What a start finds out about the files, in words with numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Fact:
    """One fact: its code, a sentence for the user, its numbers, and the images concerned.

    applied: whether the start goes on with the corrected data; otherwise it is a warning. No images
    means all of them. poses: how poses of the flange were changed (`hand_changes`).
    """

    code: str
    sentence: str
    values: Mapping[str, float | str] = field(default_factory=dict)
    images: tuple[str, ...] = ()
    applied: bool = False
    poses: str = ""
