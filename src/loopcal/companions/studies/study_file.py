"""Study files (TOML): scenarios and methods of a Monte Carlo study, resolved into our own types."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from loopcal.document.plain import finite_only
from loopcal.errors import InputError, placed, refuse_repeated, unknown_name
from loopcal.estimation.calibrate import refuse_noise
from loopcal.estimation.fit import Fit
from loopcal.files.machines.parameter_entries import (
    PARAMETERS,
    PRIOR,
    StatedParameter,
    StatedPrior,
    Units,
    by_dimension,
    changed,
    in_si,
    with_priors,
)
from loopcal.files.machines.python_function import Loops
from loopcal.files.project.fit_table import Method, Settings, Start
from loopcal.files.project.noise_table import NOISE, Noises, StatedNoise, noises
from loopcal.files.project.project_file import stated_mechanism
from loopcal.files.project.project_schema import MechanismEntry
from loopcal.files.project.simulation_table import SharedSimulation, SimulationSettings
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import checked_schema, read_toml, shown, toml_data
from loopcal.files.versions import version
from loopcal.keys import Key
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters

if TYPE_CHECKING:
    from loopcal.files.toml.tables import Tables


@dataclass(frozen=True)
class StudyMethod:
    """One way to calibrate a scenario's readings: the arguments of `calibrate`, by a name.

    The mechanism has the priors; noise is stated to the method.
    """

    name: str
    mechanism: Mechanism
    noise: Noise
    fit: Fit


@dataclass(frozen=True)
class Scenario:
    """One experiment: the machine, how it is simulated, and the methods that calibrate it.

    published: method -> parameter -> error [SI], true minus estimate, of a draw in print.
    """

    name: str
    mechanism: Mechanism
    simulation: SimulationSettings
    noise: Noise
    methods: tuple[StudyMethod, ...]
    published: Mapping[str, Mapping[str, float]]

    @property
    def estimated(self) -> tuple[str, ...]:
        """The parameters that at least one method estimates; another may hold them fixed."""
        free = {p.name for m in self.methods for p in m.mechanism.parameters if not p.fixed}
        return tuple(name for name in self.mechanism.parameters.names if name in free)


@dataclass(frozen=True)
class Study:
    """A study as it was read, SI throughout.

    fingerprint: of all that its numbers depend on; how many draws, the title and what was
    published are no part of it.
    """

    title: str
    path: Path | None
    draws: int
    seed: int
    scenarios: tuple[Scenario, ...]
    fingerprint: str

    @property
    def name(self) -> str:
        """How messages call the study."""
        return shown(self.path or "-")

    @property
    def methods(self) -> tuple[str, ...]:
        """Names of the methods, in their order."""
        return tuple(method.name for method in self.scenarios[0].methods)


def read_study(
    path: str | Path,
    *,
    text: str | bytes | None = None,
    mechanism: Loops | Mechanism | None = None,
) -> Study:
    """The study of a file; "-" is standard input, or `text`, with paths from where we stand.

    mechanism: the loops f(x, p), for a mechanism of the type "function".

    Raises InputError, naming file and key, for all that cannot be read or does not fit.
    """
    from loopcal.files.toml.tables import read_tables

    place = Place(shown(path))
    data = read_toml(path) if text is None else toml_data(text, place.file)
    checked_schema(data, place)
    tables = read_tables(StudyTables, data, place)
    real = None if str(path) == "-" else Path(path)
    folder = Path() if real is None else real.parent
    entries = tables.made("parameters")

    def stated(parameters: Parameters) -> Parameters:
        return changed(parameters, entries, place.at("parameters"))

    made = stated_mechanism(tables, data, folder, mechanism, stated)
    machine = made.with_parameters(stated(made.parameters))
    methods: tuple[MethodTable, ...] = tables.made("methods")
    _refuse_repeated([method.title for method in methods], place.at("methods"))
    listed = tables.listed("scenarios", ScenarioTable)
    _refuse_repeated([one.made("name") for one in listed], place.at("scenarios"))
    scenarios = tuple(_scenario(tables, one, methods, machine) for one in listed)
    return Study(
        title=tables.made("title") or (real.stem if real else machine.name),
        path=real,
        draws=tables.made("draws"),
        seed=tables.made("seed"),
        scenarios=scenarios,
        fingerprint=_fingerprint(data, scenarios),
    )


def _fingerprint(data: Mapping[str, Any], scenarios: Sequence[Scenario]) -> str:
    content = {key: value for key, value in data.items() if key not in ("title", "draws")}
    content["scenarios"] = [
        {key: value for key, value in scenario.items() if key != "published"}
        for scenario in data["scenarios"]
    ]
    machine = scenarios[0].mechanism
    # Another version may fit the same draws otherwise.
    parts = [
        version(),
        json.dumps(finite_only(content), sort_keys=True),
        str(machine.tape),
        *map(str, machine.parameters),
    ]
    return sha256("\n".join(parts).encode("utf-8")).hexdigest()


def _refuse_repeated(names: Sequence[str], place: Place) -> None:
    refuse_repeated(names, "the name {!r} is given twice", place=lambda i: place.at(i, "name"))


def _scenario(
    shared: Tables, stated: Tables, methods: Sequence[MethodTable], machine: Mechanism
) -> Scenario:
    mechanism, noise = machine, Noises()
    for tables in (shared, stated):  # the scenario's own come last and win
        mechanism = with_priors(mechanism, tables.made("prior"), tables.place.at("prior"))
    for tables in (shared, stated):
        more = _noise(tables.made("noise"), mechanism, tables.place.at("noise"))
        noise = noise.followed_by(more)
    simulation = _simulation(shared, stated, mechanism, noise)
    study_methods = tuple(
        _method(method, mechanism, noise, shared.place.at("methods", i))
        for i, method in enumerate(methods)
    )
    at = stated.place.at("published")
    return Scenario(
        stated.made("name"),
        mechanism,
        simulation,
        simulation.noise.noise(),
        study_methods,
        _published(stated.made("published"), mechanism, study_methods, at),
    )


def _noise(
    entries: Mapping[str, StatedNoise], mechanism: Mechanism, place: Place, *, learnt: bool = False
) -> Noises:
    """The noise stated; learnt: whether it is that of a method, which may learn sds."""
    for key, entry in entries.items():
        if not learnt and (key == MODEL or entry.estimate is not None):
            raise InputError(
                "this noise also drives the simulation, so it cannot be estimated",
                code="unsupported",
                place=str(place.at(key)),
                remedy='state an sd for each quantity here, and "estimate" and "model" in '
                "[methods.noise]",
            )
        if entry.covariance_columns is not None:
            raise InputError(
                "a study has no columns of data",
                code="unsupported",
                place=str(place.at(key, "covariance_columns")),
                remedy="give a covariance that is the same in all poses",
            )
    return noises(entries, mechanism, place)


def _simulation(
    shared: Tables, stated: Tables, mechanism: Mechanism, assumed: Noises
) -> SimulationSettings:
    from loopcal.files.project.names import scope_of

    scope = scope_of(mechanism)
    common, specific = (tables.made("simulation", scope) for tables in (shared, stated))
    top, place = (tables.place.at("simulation") for tables in (shared, stated))
    # Checked one by one: once they are merged, the place of a mistake is lost.
    for simulation, at in ((common, top), (specific, place)):
        _noise(simulation.noise, mechanism, at.at("noise"))
    made: SimulationSettings = replace(
        common,
        poses=common.poses if specific.poses is None else specific.poses,
        ranges={**common.ranges, **specific.ranges},
        truth={**common.truth, **specific.truth},
        perturb={**common.perturb, **specific.perturb},
        noise={**common.noise, **specific.noise},
    ).settings(mechanism, assumed, place)
    made.refuse_missing()
    return made


def _method(entry: MethodTable, mechanism: Mechanism, assumed: Noises, place: Place) -> StudyMethod:
    fit = entry.settings
    if fit.method.exact and (entry.noise or entry.prior):
        key = "noise" if entry.noise else "prior"
        raise InputError(
            f"the method {fit.method.name} uses no {key}",
            code="unsupported",
            place=str(place.at(key)),
            remedy="leave it out, or choose a method that weights the readings",
        )
    method_noise = _noise(entry.noise, mechanism, place.at("noise"), learnt=True)
    noise = assumed.followed_by(method_noise).noise()
    with placed(place):
        refuse_noise(fit, noise)
    return StudyMethod(
        entry.title,
        with_priors(mechanism, entry.prior, place.at("prior")),
        noise,
        fit,
    )


def _published(
    entry: Published | None,
    mechanism: Mechanism,
    methods: Sequence[StudyMethod],
    place: Place,
) -> dict[str, dict[str, float]]:
    """Errors [SI], true minus estimate, by method and parameter."""
    if entry is None:
        return {}
    units = by_dimension(entry.units)
    free = [p.name for p in mechanism.parameters if not p.fixed]
    names = [method.name for method in methods]
    errors_by_method: dict[str, dict[str, float]] = {}
    for method, errors in entry.errors.items():
        method_place = place.at("errors", method)
        if method not in names:
            raise unknown_name(
                f"there is no method {method!r} in this study", method, names, str(method_place)
            )
        for name in errors:
            if name not in free:
                raise unknown_name(
                    f"{name!r} is not an estimated parameter",
                    name,
                    free,
                    str(method_place.at(name)),
                )
        errors_by_method[method] = {
            name: in_si(value, None, mechanism.parameters[name].unit, method_place.at(name), units)
            for name, value in errors.items()
        }
    return errors_by_method


# What a study file may say: scenarios, methods, and what they share.


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
