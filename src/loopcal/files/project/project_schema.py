"""What a project file may say, with the JSON Schema of it for editors and other programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from loopcal.errors import placed, refuse_repeated
from loopcal.files.machines.attached import Effects, Instruments
from loopcal.files.machines.parameter_entries import (
    PARAMETERS,
    PRIOR,
    SAME,
    StatedParameter,
    StatedPrior,
)
from loopcal.files.machines.registry import kinds, table_of
from loopcal.files.project.data_table import DataTable
from loopcal.files.project.fit_table import FitTable
from loopcal.files.project.noise_table import NOISE, StatedNoise
from loopcal.files.project.plan_table import PlanTable, VerdictTable
from loopcal.files.project.simulation_table import SimulationTable
from loopcal.files.toml.place import Place
from loopcal.files.toml.tables import ByType, table
from loopcal.keys import Key
from loopcal.mechanisms.effects.effect import Model, with_only
from loopcal.mechanisms.mechanism import Mechanism


@dataclass(frozen=True)
class MechanismFile:
    """A mechanism in a file of its own."""

    file: Annotated[
        str,
        Key(
            "Path of the mechanism file, relative to the project; ${NAME} is replaced by the "
            "environment variable NAME.",
            example="arm.toml",
        ),
    ]
    instrument: Annotated[
        Instruments | None, Key("What is read of the machine, in place of the file's own.")
    ] = None
    effect: Annotated[
        Effects | None, Key("What geometry does not explain, in place of the file's own.")
    ] = None


def _mechanism_form(value: Any) -> str:
    if isinstance(value, Mapping) and ("type" in value or "file" not in value):
        return str(value.get("type", "serial"))
    return "file"


MechanismEntry = Annotated[
    Any,
    ByType(
        lambda: ("file", *kinds()),
        lambda kind: table(MechanismFile) if kind == "file" else table_of(kind),
        _mechanism_form,
    ),
]


@dataclass(frozen=True)
class ModelTable(Model):
    """One of several models of the machine."""

    name: Annotated[str, Key("Name of the model.")] = field(kw_only=True)


@dataclass(frozen=True)
class CompareTable:
    """Models that `loopcal calibrate --compare` judges by poses they have not seen.

    The one without effects, "geometric", is always among them.
    """

    model: Annotated[tuple[ModelTable, ...], Key("The models, one table each.", least=1)]

    def models(self, mechanism: Mechanism, place: Place) -> Mapping[str, Model]:
        """By name. Raises InputError for two of one name, effects and parameters not there."""
        names = [stated.name for stated in self.model]
        at = place.at("model")
        refuse_repeated(names, "{!r} names two models", place=lambda i: at.at(i, "name"))
        for i, stated in enumerate(self.model):
            with placed(at.at(i)):
                with_only(mechanism, stated)
        return dict(zip(names, self.model, strict=True))


@dataclass(frozen=True)
class RecordTable:
    """Who measured what, when and with what: for result.json, the report and the record."""

    laboratory: Annotated[str | None, Key("Laboratory, with its address.")] = None
    country: Annotated[str | None, Key("Country of the laboratory: two letters of ISO 3166-1.")] = (
        None
    )
    performed_at: Annotated[
        str | None,
        Key(
            "Whose place it was where the machine was calibrated.",
            choices=("laboratory", "customer", "laboratoryBranch", "customerBranch", "other"),
        ),
    ] = None
    place: Annotated[str | None, Key("Where the machine was calibrated.")] = None
    number: Annotated[
        str | None, Key("Unique number of the record; by default it follows from its content.")
    ] = None
    customer: Annotated[str | None, Key("Customer, with a way to reach them.")] = None
    machine: Annotated[str | None, Key("Make and model of the machine.")] = None
    serial: Annotated[str | None, Key("Serial number of the machine.")] = None
    received: Annotated[str | None, Key("Day on which the machine was received.")] = None
    date: Annotated[
        str | None,
        Key(
            "Day of the measurement, as 2026-11-02 or 2026-11-02 to 2026-11-04; a history takes it."
        ),
    ] = None
    issued: Annotated[str | None, Key("Day on which the record is issued.")] = None
    procedure: Annotated[str | None, Key("Procedure by which the machine was measured.")] = None
    temperature: Annotated[str | None, Key("Temperature during the measurement.")] = None
    payload: Annotated[str | None, Key("Payload of the machine.")] = None
    warm_up: Annotated[str | None, Key("How the machine was warmed up.")] = None
    speed: Annotated[str | None, Key("Speed between the poses.")] = None
    instrument: Annotated[str | None, Key("What measured: make and model.")] = None
    instrument_serial: Annotated[str | None, Key("Serial number of the instrument.")] = None
    traceability: Annotated[
        str | None, Key("Calibration of the instrument: certificate, laboratory, date.")
    ] = None
    instrument_calibrated: Annotated[
        str | None,
        Key(
            "Day of that certificate, as 2026-03-01; default: the only such day in traceability.",
        ),
    ] = None
    instrument_due: Annotated[
        str | None, Key("Last day on which that certificate counts, as 2027-03-01.")
    ] = None
    instrument_scale: Annotated[
        float | None,
        Key(
            "sd of the scale of its lengths, by data sheet or certificate.",
            unit="1",
            positive=True,
            example={"value": 2, "unit": "ppm"},
        ),
    ] = None
    temperature_sd: Annotated[
        float | None,
        Key(
            "sd of the temperature of the machine about the one stated.",
            unit="K",
            positive=True,
            difference=True,
            example={"value": 0.5, "unit": "K"},
        ),
    ] = None
    expansion: Annotated[
        float | None,
        Key(
            "Thermal expansion of the machine, relative to its length.",
            unit="1/K",
            positive=True,
            example={"value": 11.5, "unit": "ppm/K"},
        ),
    ] = None
    adjustment: Annotated[
        str | None, Key("What was adjusted after this calibration, and when.")
    ] = None
    deviations: Annotated[str | None, Key("Deviations from the procedure.")] = None
    operator: Annotated[str | None, Key("Who measured.")] = None
    authorised_by: Annotated[str | None, Key("Who authorises the record.")] = None
    accreditation: Annotated[
        str | None, Key("Accreditation of the laboratory; with it the record is a certificate.")
    ] = None
    note: Annotated[str | None, Key("Anything else that a reader should know.")] = None


@dataclass(frozen=True)
class ProjectTables:
    """One calibration: a mechanism, its readings, and what is known of both."""

    schema_: Annotated[int, Key("Version of this format.", choices=(1,))]
    title: Annotated[str | None, Key("Title of the calibration.")] = None
    mechanism: Annotated[MechanismEntry | None, Key("The machine, in place or in a file.")] = None
    data: Annotated[DataTable | None, Key("The readings.")] = None
    noise: Annotated[Mapping[str, StatedNoise], NOISE] = field(default_factory=dict)
    prior: Annotated[Mapping[str, StatedPrior], PRIOR] = field(default_factory=dict)
    parameters: Annotated[Mapping[str, StatedParameter], PARAMETERS] = field(default_factory=dict)
    same: Annotated[Mapping[str, tuple[str, ...]], SAME] = field(default_factory=dict)
    fit: Annotated[FitTable, Key("How to fit.")] = field(default_factory=FitTable)
    verdict: Annotated[VerdictTable, Key("What the verdict judges.")] = field(
        default_factory=VerdictTable
    )
    record: Annotated[RecordTable, Key("Who measured what, when and with what.")] = field(
        default_factory=RecordTable
    )
    compare: Annotated[CompareTable | None, Key("Models to compare.")] = None
    plan: Annotated[PlanTable, Key("Where poses may be planned.")] = field(
        default_factory=PlanTable
    )
    simulation: Annotated[SimulationTable | None, Key("How readings are simulated.")] = None


class _Toml(GenerateJsonSchema):
    """TOML knows no null: a key that is not stated is absent. And keys are their own titles."""

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        made = super().default_schema(schema)
        # A schema without a default counts as 0 here, not as None.
        if made.get("default", 0) is None:
            del made["default"]
        return made

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def project_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a project file."""
    made: dict[str, Any] = table(ProjectTables).model_json_schema(
        by_alias=True, schema_generator=_Toml
    )
    made["title"] = "loopcal project"
    return {"$schema": _Toml.schema_dialect} | made
