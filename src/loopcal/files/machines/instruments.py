"""The [[instrument]] tables of a mechanism file: what they may say, and what looks at a machine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import Field

from loopcal.files.machines.entries import Make, Units, built, table
from loopcal.files.toml.by_type import ByType
from loopcal.files.toml.place import Place
from loopcal.mechanisms.machine import Instrument, Machine


def _instruments() -> Mapping[str, Make]:
    from loopcal.mechanisms.instruments.registry import INSTRUMENTS

    return INSTRUMENTS


Instruments = Annotated[
    list[
        Annotated[Any, ByType(_instruments, lambda kind: table(_instruments()[kind], "Instrument"))]
    ],
    Field(
        description="What is read of the machine's body. With an empty list the machine has "
        "to calibrate itself by redundant sensors."
    ),
]


def instruments(
    entries: Sequence[Any], machine: Machine, units: Units, place: Place
) -> list[Instrument]:
    """The instruments of these tables, to look at a machine.

    units: dimension -> unit of numbers that state none. Raises InputError at the table that does
    not fit.
    """
    return [
        built(_instruments()[entry.type], entry, units, place.at(i), dimension=machine.dimension)
        for i, entry in enumerate(entries)
    ]
