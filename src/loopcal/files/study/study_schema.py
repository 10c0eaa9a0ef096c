"""What a study file may say: scenarios, methods, and what they share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from loopcal.files.machines.mechanism_parts import ParameterEntries, Units
from loopcal.files.project.fit_schema import MethodName, SettingsEntry, StartName
from loopcal.files.project.project_schema import (
    Length,
    MechanismEntry,
    NoiseEntries,
    Priors,
    RangeEntry,
    SimulationEntry,
)
from loopcal.files.toml.model import Finite, Model

Name = Annotated[str, Field(min_length=1)]


class PublishedEntry(Model):
    """One draw that somebody printed: the errors of each method, true minus estimate."""

    units: Units = Field(default=Units(), description="Of the errors; without them m and rad.")
    errors: dict[str, dict[str, Finite]] = Field(
        description="Method = the error of each parameter, true minus estimate.",
        examples=[{"implicit-loop": {"l2": -14.3, "l3": 20.7}}],
    )


class SharedSimulation(SimulationEntry):
    """What the simulations of all scenarios share; a scenario may add and replace."""

    ranges: dict[str, RangeEntry] = Field(default={})


class ScenarioEntry(Model):
    """One experiment, repeated draw by draw."""

    name: Name
    simulation: SharedSimulation = SharedSimulation()
    noise: NoiseEntries = Field(
        default={},
        description="What the estimator assumes, and true unless simulation.noise states another.",
    )
    prior: Priors = Field(default={})
    published: PublishedEntry | None = None


class MethodEntry(SettingsEntry):
    """One way to calibrate the readings of a draw."""

    name: Name | None = Field(default=None, description="Without one, that of the method.")
    method: MethodName
    start: StartName = "nominal"
    noise: NoiseEntries = Field(default={}, description="What this method assumes instead.")
    prior: Priors = Field(default={})


class StudyModel(Model):
    """A Monte Carlo study: scenarios, methods, and how many draws of each."""

    schema_: Literal[1] = Field(alias="schema", description="Version of this format.")
    title: str | None = None
    draws: Length = 1000
    seed: Annotated[int, Field(ge=0)] = 0
    mechanism: MechanismEntry | None = None
    parameters: ParameterEntries = Field(default={})
    noise: NoiseEntries = Field(default={})
    prior: Priors = Field(default={})
    simulation: SharedSimulation = SharedSimulation()
    scenarios: Annotated[list[ScenarioEntry], Field(min_length=1, max_length=1000)]
    methods: Annotated[list[MethodEntry], Field(min_length=1)]
