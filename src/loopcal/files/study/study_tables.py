"""What a study file may say: scenarios, methods, and what they share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

from loopcal.files.machines.parameter_entries import (
    PARAMETERS,
    PRIOR,
    StatedParameter,
    StatedPrior,
    Units,
)
from loopcal.files.project.fit_table import Method, Settings, Start
from loopcal.files.project.noise_table import NOISE, StatedNoise
from loopcal.files.project.project_schema import MechanismEntry
from loopcal.files.project.simulation_table import SharedSimulation
from loopcal.keys import Key


@dataclass(frozen=True)
class Published:
    """One draw that somebody printed: the errors of each method, true minus estimate."""

    errors: Annotated[
        Mapping[str, Mapping[str, float]],
        Key(
            "Method = the error of each parameter, true minus estimate.",
            example={"implicit-loop": {"l2": -14.3, "l3": 20.7}},
        ),
    ]
    units: Annotated[Units, Key("Of the errors; without them m and rad.")] = field(
        default_factory=Units
    )


@dataclass(frozen=True)
class ScenarioTable:
    """One experiment, repeated draw by draw."""

    name: Annotated[str, Key("Name of the scenario.", least=1)]
    simulation: Annotated[
        SharedSimulation, Key("What this scenario adds to what all share, or replaces.")
    ] = field(default_factory=SharedSimulation)
    noise: Annotated[
        Mapping[str, StatedNoise],
        replace(
            NOISE,
            says="What the estimator assumes, and true unless simulation.noise states another.",
        ),
    ] = field(default_factory=dict)
    prior: Annotated[Mapping[str, StatedPrior], PRIOR] = field(default_factory=dict)
    published: Annotated[Published | None, Key("Errors of one draw in print.")] = None


@dataclass(frozen=True)
class MethodTable(Settings):
    """One way to calibrate the readings of a draw."""

    method: Method = field(kw_only=True)
    start: Start = "nominal"
    name: Annotated[str | None, Key("Without one, that of the method.", least=1)] = None
    noise: Annotated[
        Mapping[str, StatedNoise], replace(NOISE, says="What this method assumes instead.")
    ] = field(default_factory=dict)
    prior: Annotated[Mapping[str, StatedPrior], PRIOR] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Its name, else that of its method."""
        return self.name or self.method


@dataclass(frozen=True)
class StudyTables:
    """A Monte Carlo study: scenarios, methods, and how many draws of each."""

    schema_: Annotated[int, Key("Version of this format.", choices=(1,))]
    scenarios: Annotated[tuple[ScenarioTable, ...], Key("The scenarios.", least=1, most=1000)]
    methods: Annotated[tuple[MethodTable, ...], Key("The methods, each for every draw.", least=1)]
    title: Annotated[str | None, Key("Title of the study.")] = None
    draws: Annotated[int, Key("Draws per scenario.", low=1)] = 1000
    seed: Annotated[int, Key("Seed of all draws.", low=0)] = 0
    mechanism: Annotated[MechanismEntry | None, Key("The machine, in place or in a file.")] = None
    parameters: Annotated[Mapping[str, StatedParameter], PARAMETERS] = field(default_factory=dict)
    noise: Annotated[Mapping[str, StatedNoise], NOISE] = field(default_factory=dict)
    prior: Annotated[Mapping[str, StatedPrior], PRIOR] = field(default_factory=dict)
    simulation: Annotated[SharedSimulation, Key("What all scenarios share.")] = field(
        default_factory=SharedSimulation
    )
