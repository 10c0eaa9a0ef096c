"""Study files (TOML): scenarios and methods of a Monte Carlo study, resolved into our own types."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError, nearest
from loopcal.estimation.calibrate import refuse_noise
from loopcal.estimation.fit import Fit
from loopcal.files.machines.parameter_entries import changed, in_si
from loopcal.files.machines.python_function import Loops
from loopcal.files.project.fit_entries import fit_of
from loopcal.files.project.noise_entries import NoiseSpec, noise_spec
from loopcal.files.project.project_file import plain, stated_mechanism, with_priors
from loopcal.files.project.simulation_entries import SimulationSpec, simulation_spec
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import checked_schema, read_toml, shown, toml_data
from loopcal.files.versions import version
from loopcal.measurements.noise import MODEL, Noise
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import NoiseEntry
    from loopcal.files.study.study_schema import (
        MethodEntry,
        PublishedEntry,
        ScenarioEntry,
        SharedSimulation,
        StudyModel,
    )


@dataclass(frozen=True)
class StudyMethod:
    """One way to calibrate a scenario's readings: the arguments of `calibrate`, by a name.

    The mechanism has the priors; noise is what the method is told.
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
    simulation: SimulationSpec
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
    from loopcal.files.study.study_schema import StudyModel
    from loopcal.files.toml.model import validated

    place = Place(shown(path))
    data = read_toml(path) if text is None else toml_data(text, place.file)
    checked_schema(data, place)
    model = validated(StudyModel, data, place)
    real = None if str(path) == "-" else Path(path)
    folder = Path() if real is None else real.parent

    def told(parameters: Parameters) -> Parameters:
        return changed(parameters, model.parameters, place.at("parameters"))

    made = stated_mechanism(model, data, folder, mechanism, place, told)
    machine = made.with_parameters(told(made.parameters))
    names = [entry.name or entry.method for entry in model.methods]
    _refuse_repeated(names, place.at("methods"))
    _refuse_repeated([entry.name for entry in model.scenarios], place.at("scenarios"))
    scenarios = tuple(
        _scenario(model, i, machine, place.at("scenarios", i)) for i in range(len(model.scenarios))
    )
    return Study(
        title=model.title or (real.stem if real else machine.name),
        path=real,
        draws=model.draws,
        seed=model.seed,
        scenarios=scenarios,
        fingerprint=_fingerprint(data, scenarios),
    )


def _fingerprint(data: Mapping[str, Any], scenarios: Sequence[Scenario]) -> str:
    told = {key: value for key, value in data.items() if key not in ("title", "draws")}
    told["scenarios"] = [
        {key: value for key, value in scenario.items() if key != "published"}
        for scenario in data["scenarios"]
    ]
    machine = scenarios[0].mechanism
    parts = [
        version(),
        json.dumps(plain(told), sort_keys=True),
        str(machine.tape),
        *map(str, machine.parameters),
    ]
    return sha256("\n".join(parts).encode("utf-8")).hexdigest()


def _refuse_repeated(names: Sequence[str], place: Place) -> None:
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(
                f"the name {name!r} is given twice",
                code="duplicate-name",
                place=str(place.at(i, "name")),
                remedy="give each a unique name",
            )


def _scenario(model: StudyModel, index: int, machine: Mechanism, place: Place) -> Scenario:
    entry, top = model.scenarios[index], Place(place.file)
    mechanism = with_priors(machine, model.prior, top.at("prior"))
    mechanism = with_priors(mechanism, entry.prior, place.at("prior"))
    told = _noise(model.noise, machine, top.at("noise")).followed_by(
        _noise(entry.noise, machine, place.at("noise"))
    )
    spec = _simulation(model.simulation, entry, mechanism, told, place)
    methods = tuple(
        _method(given, mechanism, told, top.at("methods", i))
        for i, given in enumerate(model.methods)
    )
    published = _published(entry.published, mechanism, methods, place.at("published"))
    return Scenario(entry.name, mechanism, spec, spec.noise.noise(), methods, published)


def _noise(
    entries: Mapping[str, NoiseEntry], mechanism: Mechanism, place: Place, *, learnt: bool = False
) -> NoiseSpec:
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
    return noise_spec(entries, mechanism.quantities, mechanism.quantity_group, place)


def _simulation(
    shared: SharedSimulation,
    entry: ScenarioEntry,
    mechanism: Mechanism,
    told: NoiseSpec,
    place: Place,
) -> SimulationSpec:
    own = entry.simulation
    here, top = place.at("simulation"), Place(place.file).at("simulation")
    for given, at in ((shared, top), (own, here)):
        _noise(given.noise, mechanism, at.at("noise"))
    both = shared.model_copy(
        update={
            "poses": shared.poses if own.poses is None else own.poses,
            "ranges": {**shared.ranges, **own.ranges},
            "truth": {**shared.truth, **own.truth},
            "perturb": {**shared.perturb, **own.perturb},
            "noise": {**shared.noise, **own.noise},
        }
    )
    made = simulation_spec(both, mechanism, told, here)
    made.refuse_missing()
    return made


def _method(entry: MethodEntry, mechanism: Mechanism, told: NoiseSpec, place: Place) -> StudyMethod:
    fit = fit_of(entry, place)
    if fit.method.exact and (entry.noise or entry.prior):
        key = "noise" if entry.noise else "prior"
        raise InputError(
            f"the method {fit.method.name} uses no {key}",
            code="unsupported",
            place=str(place.at(key)),
            remedy="leave it out, or choose a method that weights the readings",
        )
    noise = told.followed_by(_noise(entry.noise, mechanism, place.at("noise"), learnt=True)).noise()
    try:
        refuse_noise(fit, noise)
    except InputError as error:
        raise error.at(str(place)) from None
    return StudyMethod(
        entry.name or entry.method,
        with_priors(mechanism, entry.prior, place.at("prior")),
        noise,
        fit,
    )


def _published(
    entry: PublishedEntry | None,
    mechanism: Mechanism,
    methods: Sequence[StudyMethod],
    place: Place,
) -> dict[str, dict[str, float]]:
    """Errors [SI], true minus estimate, by method and parameter."""
    if entry is None:
        return {}
    units = entry.units.by_dimension()
    free = [p.name for p in mechanism.parameters if not p.fixed]
    names = [method.name for method in methods]
    found: dict[str, dict[str, float]] = {}
    for method, errors in entry.errors.items():
        here = place.at("errors", method)
        if method not in names:
            raise InputError(
                f"there is no method {method!r} in this study",
                code="unknown-name",
                place=str(here),
                remedy=nearest(method, names),
            )
        for name in errors:
            if name not in free:
                raise InputError(
                    f"{name!r} is not an estimated parameter",
                    code="unknown-name",
                    place=str(here.at(name)),
                    remedy=nearest(name, free),
                )
        found[method] = {
            name: in_si(value, None, mechanism.parameters[name].unit, here.at(name), units)
            for name, value in errors.items()
        }
    return found
