"""Project files (TOML): one calibration as it is written, resolved into our own types."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.errors import InputError
from loopcal.files.machines.identifiable import Told
from loopcal.files.machines.mechanism_file import mechanism_from_data, read_mechanism
from loopcal.files.machines.parameter_entries import changed
from loopcal.files.machines.python_function import Loops
from loopcal.files.paths import expanded
from loopcal.files.project.compare_entries import compare_spec
from loopcal.files.project.data_entries import DataSpec, data_files
from loopcal.files.project.fit_entries import FitSpec, fit_spec
from loopcal.files.project.noise_entries import NoiseSpec, noise_spec
from loopcal.files.project.plan_entries import plan_settings
from loopcal.files.project.verdict_entries import VerdictSpec, verdict_spec
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import checked_schema, read_toml, shown, toml_data
from loopcal.measurements.plan_settings import PlanSettings
from loopcal.mechanisms.effects.model import Model
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters
from loopcal.mechanisms.prior import check_estimate
from loopcal.mechanisms.terms import stated_terms

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import PriorEntry, ProjectModel
    from loopcal.files.project.simulation_entries import SimulationSpec
    from loopcal.files.study.study_schema import StudyModel


@dataclass(frozen=True)
class Project:
    """One calibration, SI throughout.

    path: of the file, None for standard input; folder: to which its paths are relative;
    mechanism: with the nominal values, priors and fixed parameters of the project; data and
    simulation: None where the project has no such table; inputs: the file as read, as plain
    data (inf as a text, for JSON knows no such number); compare: models by name.
    """

    title: str
    path: Path | None
    folder: Path
    mechanism: Mechanism
    data: DataSpec | None
    noise: NoiseSpec
    fit: FitSpec
    verdict: VerdictSpec
    plan: PlanSettings
    simulation: SimulationSpec | None
    inputs: Mapping[str, Any]
    compare: Mapping[str, Model]

    @property
    def name(self) -> str:
        """How messages call the project."""
        return shown(self.path or "-")


def read_project(
    path: str | Path,
    *,
    text: str | bytes | None = None,
    mechanism: Loops | Mechanism | None = None,
) -> Project:
    """The project of a file; "-" is standard input, or `text`, with paths from where we stand.

    mechanism: the loops f(x, p) that a project of the type "function" declares, or a whole
    mechanism for a project that describes none.

    Raises InputError, naming file and key, for all that cannot be read or does not fit.
    """
    from loopcal.files.project.project_schema import ProjectModel
    from loopcal.files.toml.model import validated

    place = Place(shown(path))
    data = read_toml(path) if text is None else toml_data(text, place.file)
    checked_schema(data, place)
    model = validated(ProjectModel, data, place)
    real = None if str(path) == "-" else Path(path)
    folder = Path() if real is None else real.parent
    machine = _mechanism(model, data, folder, mechanism, place)
    noise = noise_spec(model.noise, machine.quantities, machine.quantity_group, place.at("noise"))
    simulation = _simulation(model, machine, noise, place.at("simulation"))
    verdict = verdict_spec(model.verdict, machine, simulation, place.at("verdict"))
    return Project(
        title=model.title or (real.stem if real else machine.name),
        path=real,
        folder=folder,
        mechanism=machine,
        data=data_spec(model, machine, place),
        noise=noise,
        fit=fit_spec(model.fit, machine, place.at("fit")),
        verdict=verdict,
        plan=plan_settings(model.plan, machine, verdict, place.at("plan")),
        simulation=simulation,
        inputs=plain(data),
        compare=compare_spec(model.compare, machine, place.at("compare")),
    )


def data_spec(model: ProjectModel, mechanism: Mechanism, place: Place) -> DataSpec | None:
    """Where a project says the readings of this mechanism are; None where it does not."""
    if model.data is None:
        return None
    noise = noise_spec(
        model.noise, mechanism.quantities, mechanism.quantity_group, place.at("noise")
    )
    return data_files(model.data, mechanism, noise, place.at("data"))


def _simulation(
    model: ProjectModel, machine: Mechanism, noise: NoiseSpec, place: Place
) -> SimulationSpec | None:
    if model.simulation is None:
        return None
    from loopcal.files.project.simulation_entries import simulation_spec

    return simulation_spec(model.simulation, machine, noise, place)


def _mechanism(
    model: ProjectModel,
    data: Mapping[str, Any],
    folder: Path,
    given: Loops | Mechanism | None,
    place: Place,
) -> Mechanism:
    def told(parameters: Parameters) -> Parameters:
        said = changed(parameters, model.parameters, place.at("parameters"))
        return changed(said, _priors(model.prior), place.at("prior"))

    made = stated_mechanism(model, data, folder, given, place, told)
    said = changed(made.parameters, model.parameters, place.at("parameters"))
    return with_priors(made.with_parameters(said), model.prior, place.at("prior"))


def stated_mechanism(
    model: ProjectModel | StudyModel,
    data: Mapping[str, Any],
    folder: Path,
    given: Loops | Mechanism | None,
    place: Place,
    told: Told | None = None,
) -> Mechanism:
    """The mechanism of a project or study, without what these say of its parameters.

    given: the loops of a mechanism of the type "function", or a whole mechanism for a file that
    describes none; told: what will be said of the parameters. Raises InputError where there is
    none, or one that cannot be read.
    """
    stated = data.get("mechanism")
    here = place.at("mechanism")
    if stated is None:
        if not isinstance(given, Mechanism):
            words = "describes no mechanism" if given is None else "declares no quantities"
            raise InputError(
                f"the project {words}",
                code="missing-key",
                place=place.file,
                remedy='add [mechanism] with file = "..." or type = "serial", "planar-two-link", '
                '"motoman-ma1400" or "function"',
            )
        return given
    if "type" not in stated and "file" in stated:
        path = expanded(stated["file"], folder, here.at("file"))
        return read_mechanism(
            path,
            function=given,
            instruments=stated.get("instrument"),
            effects=stated.get("effect"),
            told=told,
        )
    return mechanism_from_data(stated, here, function=given, parameters=model.parameters, told=told)


def with_priors(mechanism: Mechanism, entries: Mapping[str, PriorEntry], place: Place) -> Mechanism:
    """The mechanism with the prior sds of a file, and a term for each that is learnt.

    Raises InputError for a name that stands for nothing, a unit that does not fit, and for an sd
    to be learnt that is 0 or inf.
    """
    parameters = changed(mechanism.parameters, _priors(entries), place)
    for key, entry in entries.items():
        try:
            if entry.estimate is not None:
                check_estimate(key, entry.estimate, entry.sd)
        except InputError as error:
            raise error.at(str(place.at(key))) from None
    keys = {key: entry.estimate is not None for key, entry in entries.items()}
    try:
        terms = stated_terms(mechanism.terms, parameters, keys)
    except InputError as error:
        raise error.at(str(place)) from None
    return replace(mechanism, parameters=parameters, terms=terms)


def _priors(entries: Mapping[str, PriorEntry]) -> dict[str, Any]:
    """Prior sds as entries of parameters."""
    from loopcal.files.machines.mechanism_parts import ParameterEntry

    return {key: ParameterEntry(sd=entry.sd, unit=entry.unit) for key, entry in entries.items()}


def plain(value: Any) -> Any:
    """TOML data as JSON can hold it: infinite numbers become the texts "inf" and "-inf"."""
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [plain(inner) for inner in value]
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value
