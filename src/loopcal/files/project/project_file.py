"""Project files (TOML): one calibration as it is written, resolved into our own types."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.document.aliases import of_project
from loopcal.document.plain import finite_only
from loopcal.errors import InputError
from loopcal.files.machines.mechanism_file import (
    ParameterChange,
    mechanism_from_data,
    read_mechanism,
)
from loopcal.files.machines.parameter_entries import changed, prior_sds, with_priors
from loopcal.files.machines.python_function import Loops
from loopcal.files.outputs import expanded
from loopcal.files.project.data_table import DataTable, data_files
from loopcal.files.project.fit_table import FitTable
from loopcal.files.project.noise_table import Noises, noises
from loopcal.files.project.plan_table import PlanTable, VerdictTable
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import checked_schema, read_toml, shown, toml_data
from loopcal.measurements.plan_settings import PlanSettings
from loopcal.mechanisms.effects.effect import Model
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameters

if TYPE_CHECKING:
    from loopcal.files.project.simulation_table import SimulationSettings
    from loopcal.files.toml.tables import Tables


@dataclass(frozen=True)
class Project:
    """One calibration, SI throughout.

    path: of the file, None for standard input; folder: to which its paths are relative;
    mechanism: with the nominal values, priors and fixed parameters of the project; data and
    simulation: None where the project has no such table; inputs: the file as read, as plain
    data (inf as a text, for JSON knows no such number); compare: models by name; planned: the table
    [plan].
    """

    title: str
    path: Path | None
    folder: Path
    mechanism: Mechanism
    data: DataTable | None
    noise: Noises
    fit: FitTable
    verdict: VerdictTable
    planned: PlanTable
    simulation: SimulationSettings | None
    inputs: Mapping[str, Any]
    compare: Mapping[str, Model]

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            return of_project(self, name)

    @property
    def name(self) -> str:
        """How messages call the project."""
        return shown(self.path or "-")

    def __repr__(self) -> str:
        return f"<Project {self.title!r}: {self.mechanism!r}>"

    def _repr_html_(self) -> str:
        from html import escape  # only notebooks ask

        return f"<p><b>{escape(self.title)}</b></p>{self.mechanism._repr_html_()}"

    @property
    def plan(self) -> PlanSettings:
        """Where poses may be planned; the end point counts in the region of the verdict."""
        return self.planned.settings(self.mechanism, self.verdict.region)


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
    from loopcal.files.project.names import scope_of
    from loopcal.files.project.project_schema import ProjectTables
    from loopcal.files.toml.tables import read_tables

    place = Place(shown(path))
    data = read_toml(path) if text is None else toml_data(text, place.file)
    checked_schema(data, place)
    if "type" in data and "mechanism" not in data:
        raise InputError(
            "this is a mechanism file, not a project file",
            code="wrong-file-type",
            place=place.file,
            remedy=f'name a project with [mechanism] file = "{Path(place.file).name}"',
        )
    tables = read_tables(ProjectTables, data, place)
    real = None if str(path) == "-" else Path(path)
    folder = Path() if real is None else real.parent
    machine = _mechanism(tables, data, folder, mechanism)
    scope = scope_of(machine)
    noise = noises(tables.made("noise"), machine, place.at("noise"))
    verdict, simulation = tables.made("verdict", scope), tables.made("simulation", scope)
    if simulation is not None:
        simulation = simulation.settings(machine, noise, place.at("simulation"))
        # A simulated machine works where it was driven, unless the project states otherwise.
        if not verdict.region:
            verdict = replace(verdict, region={n: r.span for n, r in simulation.ranges.items()})
    compared = tables.made("compare")
    return Project(
        title=tables.made("title") or (real.stem if real else machine.name),
        path=real,
        folder=folder,
        mechanism=machine,
        data=data_files(tables.made("data", scope), machine, noise, place.at("data")),
        noise=noise,
        fit=tables.made("fit", scope),
        verdict=verdict,
        planned=tables.made("plan", scope),
        simulation=simulation,
        inputs=finite_only(data),
        compare={} if compared is None else compared.models(machine, place.at("compare")),
    )


def _mechanism(
    tables: Tables, data: Mapping[str, Any], folder: Path, definition: Loops | Mechanism | None
) -> Mechanism:
    parameters, priors, place = tables.made("parameters"), tables.made("prior"), tables.place

    def stated(before: Parameters) -> Parameters:
        after = changed(before, parameters, place.at("parameters"))
        return changed(after, prior_sds(priors), place.at("prior"))

    made = stated_mechanism(tables, data, folder, definition, stated)
    # Stated again: `stated` only chose which parameters of a chain are fixed.
    made = made.with_parameters(changed(made.parameters, parameters, place.at("parameters")))
    return with_priors(made, priors, place.at("prior"))


def stated_mechanism(
    tables: Tables,
    data: Mapping[str, Any],
    folder: Path,
    definition: Loops | Mechanism | None,
    change: ParameterChange,
) -> Mechanism:
    """The mechanism of a project or study, without what these say of its parameters.

    definition: the loops of a mechanism of the type "function", or a whole mechanism for a file
    that describes none. change: what the file states of parameters. Raises InputError where there
    is none, or one that cannot be read.
    """
    stated, place = data.get("mechanism"), tables.place
    mechanism_place = place.at("mechanism")
    if stated is None:
        if not isinstance(definition, Mechanism):
            words = "describes no mechanism" if definition is None else "declares no quantities"
            raise InputError(
                f"the project {words}",
                code="missing-key",
                place=place.file,
                remedy='add [mechanism] with file = "..." or type = "serial", "planar-two-link", '
                '"motoman-ma1400" or "function"',
            )
        return definition
    if "type" not in stated and "file" in stated:
        path = expanded(stated["file"], folder, mechanism_place.at("file"))
        return read_mechanism(
            path,
            function=definition,
            instruments=stated.get("instrument"),
            effects=stated.get("effect"),
            same=data.get("same"),
            told=change,
        )
    parameters = tables.made("parameters")
    if "same" in data:
        stated = {**stated, "same": data["same"]}
    return mechanism_from_data(
        stated, mechanism_place, function=definition, parameters=parameters, change=change
    )
