"""What a mechanism file may say of a parallel machine. Read with `parallel_entries`."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from loopcal.files.machines.effect_schema import MechanismModel
from loopcal.files.machines.instrument_schema import Instruments
from loopcal.files.machines.mechanism_parts import Amount, ParameterEntries, Units


class ParallelMachine(MechanismModel):
    """What all parallel machines have; their geometry is in their parameters."""

    name: str | None = None
    units: Units = Units()
    home: dict[str, Amount] = Field(
        default={},
        description="Where quantities that nobody reads usually stand: the search for them begins "
        "there.",
        examples=[{"platform_z": {"value": 700, "unit": "mm"}}],
    )
    instrument: Instruments = Field(default=[])
    parameters: ParameterEntries = Field(default={})


class PassiveMachine(ParallelMachine):
    """A parallel machine that may have sensors in its passive joints."""

    type: Literal["four-bar", "five-bar", "three-rrr", "stewart-gough"]
    passive: list[str] = Field(
        default=[],
        description="Passive joints that are read: theta_2, phi_1 of a four-bar; phi_1 ... of a "
        "five-bar and a 3-RRR; alpha_1, beta_1 ... of a Stewart-Gough platform.",
    )


class Delta(ParallelMachine):
    """A delta, with rails or with arms, whose platform never turns."""

    type: Literal["linear-delta", "rotary-delta"]
