"""The part of a project file that says where a calibration begins: values and prior sds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from loopcal.files.toml.writer import line, one_line


@dataclass(frozen=True)
class Start:
    """A parameter's nominal value and its prior sd [unit]."""

    value: float
    sd: float
    unit: str


def start_to_toml(remarks: Sequence[str], starts: Mapping[str, Start]) -> str:
    """The sections [parameters] and [prior] of a project file, every digit of them."""
    parts = [
        *(f"# {one_line(words)}" for words in remarks),
        "",
        "[parameters]",
        *(line(name, {"value": s.value, "unit": s.unit}) for name, s in starts.items()),
        "",
        "[prior]",
        *(line(name, {"sd": s.sd, "unit": s.unit}) for name, s in starts.items()),
    ]
    return "\n".join(parts) + "\n"
