"""What a project file may say, with the JSON Schema of it for editors and other programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from loopcal.document.verdict import QUESTIONS
from loopcal.files.machines.effects import Effects
from loopcal.files.machines.instruments import Instruments
from loopcal.files.machines.mechanism_parts import Amount, ParameterEntries, Units, Value
from loopcal.files.machines.registry import kinds, table_of
from loopcal.files.project.fit_schema import FitEntry
from loopcal.files.toml.by_type import ByType
from loopcal.files.toml.model import (
    Finite,
    Model,
    NameOrNumber,
    OneOf,
    OrPlain,
    Sd,
    UnitName,
    complaint,
    plain_number_as,
)

Length = Annotated[int, Field(ge=1)]


class MechanismFile(Model):
    """A mechanism in a file of its own."""

    file: str = Field(
        description="Path of the mechanism file, relative to the project; ${NAME} is replaced "
        "by the environment variable NAME.",
        examples=["arm.toml"],
    )
    instrument: Instruments | None = Field(
        default=None, description="What is read of the machine, in place of the file's own."
    )
    effect: Effects | None = Field(
        default=None, description="What geometry does not explain, in place of the file's own."
    )


def _mechanism_form(value: Any) -> str:
    if isinstance(value, Mapping) and ("type" in value or "file" not in value):
        return str(value.get("type", "serial"))
    return "file"


MechanismEntry = Annotated[
    Any,
    ByType(
        lambda: ("file", *kinds()),
        lambda kind: MechanismFile if kind == "file" else table_of(kind),
        _mechanism_form,
    ),
]


class ColumnEntry(Model):
    """Where the readings of a quantity stand."""

    column: NameOrNumber = Field(
        description="Name of the column, its number from 1, or 0: the number of the row."
    )
    unit: UnitName | None = None
    sd_column: NameOrNumber | None = Field(
        default=None, description="Column with the sd of each reading."
    )
    coverage: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None,
        description="Coverage factor of that column, where it holds an expanded uncertainty: 2 "
        "for k = 2. The sd is the column divided by it.",
    )
    sd_unit: UnitName | None = Field(default=None, description="Without one, that of the readings.")
    sd_at_least: Sd | None = Field(
        default=None,
        description="Smallest sd to believe, in the unit of the sds: for columns that were "
        "rounded, where 0 would call a reading exact.",
    )
    check: bool = Field(default=True, description="false: the values are right though strange.")


def _column(value: Any) -> Any:
    return {"column": value} if isinstance(value, str | int) else value


_ColumnOrName = Annotated[ColumnEntry, OrPlain(_column, ("string", "integer"))]


class FileEntry(Model):
    """A file of readings, and which of its columns is which quantity."""

    file: str = Field(
        description="CSV, TSV or other text, XLSX, Parquet (or a folder of it), MATLAB v5; "
        "relative to the project; ${NAME} is replaced by the environment variable NAME.",
        examples=["poses.csv", "${LOOPCAL_DATA}/left_arm.csv"],
    )
    pose: NameOrNumber | None = Field(
        default=None,
        description="Column of the pose ids; 0: the numbers of the rows, by which files are joined "
        "row by row.",
    )
    units: Units = Field(default=Units(), description="Units of the columns that state none.")
    columns: dict[str, _ColumnOrName] | None = Field(
        default=None,
        description="Quantity = its column; a quantity that is absent has a column of its own "
        "name.",
        examples=[{"theta_1": {"column": "S", "unit": "deg"}, "x": "x_tracker"}],
    )
    sheet: NameOrNumber | None = Field(default=None, description="XLSX: name or number from 1.")
    variable: str | None = Field(default=None, description="MATLAB: name of the variable.")
    header: bool | None = Field(default=None, description="Whether the first row holds names.")
    delimiter: str | None = Field(default=None, examples=[",", ";", "\t"])
    decimal: Literal[".", ","] | None = None
    encoding: str | None = Field(default=None, examples=["utf-8", "utf-16", "cp1252"])


class JoinEntry(FileEntry):
    """Another file with readings of the same poses, joined by their ids."""

    instrument: list[str] = Field(
        default=[],
        description="Instruments without readings of their own (a ball in a socket, a probe on a "
        "plane) that were used in the poses of this file, and in no others.",
    )


class DataEntry(FileEntry):
    """The readings: a file, perhaps others joined by pose id, and what is left out."""

    exclude: list[NameOrNumber] = Field(default=[], description="Ids of poses to leave out.")
    every: Length = Field(default=1, description="Keep the 1st, (every + 1)th, ... row.")
    stream: bool | None = Field(
        default=None,
        description="Parquet: whether poses are read in chunks, sweep by sweep, instead of being "
        "held in memory; by default from two million rows on, and for a folder of files.",
    )
    join: list[JoinEntry] = Field(
        default=[], description="Further files with readings of the same poses."
    )


Row = list[Finite]


Kind = Literal["mpe", "sd"]
Coverage = Annotated[float, Field(gt=0, allow_inf_nan=False)] | Literal["uniform"]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]


class TrackerEntry(Model):
    """A tracker by its name, or by figures as its maker prints them."""

    name: str | None = Field(default=None, examples=["leica-at500"])
    range: str | None = Field(
        default=None, description="Along the line of sight.", examples=["10 um + 0.3 um/m"]
    )
    transverse: str | None = Field(
        default=None,
        description="Across the line of sight, in each of the two directions.",
        examples=["15 um + 6 um/m", "2 arcsec"],
    )
    kind: Kind | None = Field(
        default=None, description="mpe: maximum permissible error (unless stated); or sd."
    )
    coverage: Coverage | None = Field(
        default=None, description='Maximum permissible error over sd: 2, or "uniform" (sqrt 3).'
    )


def _tracker(value: Any) -> Any:
    if isinstance(value, bool | int | float | list):
        raise complaint(f"{value!r} is given", 'give a name, say "leica-at500", or a table')
    return {"name": value} if isinstance(value, str) else value


_TrackerOrName = Annotated[TrackerEntry, OrPlain(_tracker, ("string",))]


class EncoderEntry(Model):
    """Figures of an encoder; what is stated adds in quadrature."""

    bits: Annotated[int, Field(ge=1, le=64)] | None = Field(
        default=None, description="It distinguishes 2^bits positions per turn."
    )
    counts: Positive | None = Field(default=None, description="Or so many positions per turn.")
    accuracy: str | None = Field(default=None, examples=["5 arcsec"])
    kind: Kind | None = Field(default=None, description="Of the accuracy; mpe unless stated.")
    coverage: Coverage | None = Field(
        default=None, description='Maximum permissible error over sd: 2, or "uniform" (sqrt 3).'
    )
    gear: Positive = Field(
        default=1.0, description="Turns of the encoder per turn of the joint, which divide all."
    )


class NoiseEntry(Model):
    """How uncertain readings are: an sd, or a covariance of several quantities together."""

    sd: Sd | None = Field(default=None, description="0: exact, never corrected; inf: not measured.")
    covariance: list[Row] | None = Field(
        default=None,
        description="Of the quantities of the key in their order, the same in all poses.",
    )
    covariance_columns: list[NameOrNumber] | None = Field(
        default=None,
        description="Columns of the data with the covariance in each pose: all of it row by row, "
        "or from the diagonal to the right (xx, xy, xz, yy, yz, zz).",
    )
    tracker: _TrackerOrName | None = Field(
        default=None,
        description="Of the coordinates of a point together: a tracker by name, or its figures.",
        examples=["leica-at500", {"range": "10 um + 0.3 um/m", "transverse": "15 um + 6 um/m"}],
    )
    station: list[Finite] | None = Field(
        default=None, description="Where the tracker stands in the frame of its readings."
    )
    encoder: EncoderEntry | None = Field(default=None, examples=[{"bits": 20}])
    rounded_to: Positive | None = Field(
        default=None, description="Step of the readings: an sd of step / sqrt(12), in quadrature."
    )
    unit: UnitName | None = Field(
        default=None,
        description="Of sd, rounded_to and station; a covariance is in its square.",
    )
    estimate: Literal["each", "group"] | None = Field(
        default=None,
        description="Learn the sds from the calibration, beginning from those stated: one factor "
        "for each quantity of the key, or one for all. Absent: taken as given.",
    )


NoiseEntries = Annotated[
    dict[str, Annotated[NoiseEntry, plain_number_as("sd")]],
    Field(
        description="By quantity, glob, the joined names of all outputs, or several of these "
        "with commas; later lines win.",
        examples=[{"theta_*": {"sd": 5e-5, "unit": "rad"}, "xyz": {"sd": 10, "unit": "um"}}],
    ),
]


class SdEntry(Model):
    """An sd with its unit."""

    sd: Sd
    unit: UnitName | None = None


Sds = dict[str, Annotated[SdEntry, plain_number_as("sd")]]


class PriorEntry(SdEntry):
    """How well the nominal values are known."""

    estimate: Literal["group"] | None = Field(
        default=None,
        description="group: these parameters share one sd, which is learnt from the calibration; "
        "the sd stated is its expected size, known to a factor of e.",
    )


Priors = dict[str, Annotated[PriorEntry, plain_number_as("sd")]]


class ModelEntry(Model):
    """One of several models of the machine."""

    name: str
    effects: list[str] = Field(
        default=[], description="Names of the mechanism's effects that are switched on."
    )
    fixed: list[str] = Field(
        default=[], description="Parameters, by name or glob, that this model does not estimate."
    )


class CompareEntry(Model):
    """Models that `loopcal calibrate --compare` judges by poses they have not seen.

    The one without effects, "geometric", is always among them.
    """

    model: list[ModelEntry] = Field(min_length=1)


class RangeEntry(Model):
    """Where a quantity is driven in a simulation."""

    from_: Finite = Field(alias="from")
    to: Finite
    step: Annotated[float, Field(gt=0, allow_inf_nan=False)] | None = Field(
        default=None, description="With steps all combinations are simulated, without random poses."
    )
    unit: UnitName | None = None


class SimulationEntry(Model):
    """How `loopcal simulate` makes readings: poses, the true machine, the noise."""

    poses: Length | None = Field(default=None, description="How many random poses.")
    ranges: dict[str, RangeEntry] = Field(
        min_length=1,
        description="Of every quantity that is driven, and of known constants.",
        examples=[{"theta_1": {"from": -90, "to": 90, "unit": "deg"}}],
    )
    truth: dict[str, Annotated[Value, plain_number_as("value")]] = Field(
        default={}, description="True values of parameters, by name or glob; else the nominal ones."
    )
    perturb: Sds = Field(
        default={},
        description="sd of a random deviation of the truth from nominal, by name or glob.",
    )
    noise: NoiseEntries = Field(
        default={}, description="The true noise, where it is not what [noise] says."
    )


class SpanEntry(Model):
    """Range of a reading in the region where the machine works."""

    from_: Finite = Field(alias="from")
    to: Finite
    unit: UnitName | None = None


class VerdictEntry(Model):
    """What the verdict judges, and which of its answers are required."""

    tolerance: Amount | None = Field(
        default=None,
        description="Distance that 95 % of poses in the working region shall keep.",
        examples=[{"value": 0.3, "unit": "mm"}],
    )
    region: dict[str, SpanEntry] = Field(
        default={},
        description="Where the machine works, by reading; default: the ranges of [simulation], "
        "else the joints' limits.",
        examples=[{"theta_1": {"from": -90, "to": 90, "unit": "deg"}}],
    )
    require: list[Annotated[str, OneOf(QUESTIONS)]] = Field(
        default=[], description="End with exit code 4 unless these questions are answered yes."
    )


class BoxEntry(Model):
    """A box in the frame of the machine's base; a coordinate that is absent is not limited."""

    x: SpanEntry | None = None
    y: SpanEntry | None = None
    z: SpanEntry | None = None


class SightEntry(Model):
    """What the instrument can see."""

    station: list[Finite] = Field(
        default=[0.0, 0.0, 0.0],
        description="Where the instrument stands in the frame of its readings.",
    )
    unit: UnitName | None = Field(default=None, description="Of the station.")
    normal: list[Finite] | None = Field(
        default=None,
        description="Direction in the body's frame that the reflector looks along.",
        examples=[[0, 0, 1]],
    )
    within: Amount | None = Field(
        default=None,
        description="Largest angle between that direction and the line to the instrument; "
        "default: 30 degrees.",
        examples=[{"value": 30, "unit": "deg"}],
    )


class PlanEntry(Model):
    """Where `loopcal plan` may choose poses."""

    candidates: Length = Field(default=3000, description="How many random poses to choose among.")
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="Of the random poses.")
    ranges: dict[str, SpanEntry] = Field(
        default={},
        description="Of each quantity that is driven; default: the joints' limits, else the ranges "
        "of [simulation].",
        examples=[{"theta_1": {"from": -90, "to": 90, "unit": "deg"}}],
    )
    reach: BoxEntry | None = Field(default=None, description="Where the end point must be.")
    keep_out: list[BoxEntry] = Field(
        default=[],
        description="Boxes that neither the end point, nor the links of a serial arm, nor the line "
        "of sight may touch.",
    )
    sight: SightEntry | None = Field(
        default=None, description="Line of sight and incidence at the reflector."
    )
    forbidden: str | None = Field(
        default=None,
        description="File of readings, in the columns of [data], near which (1 degree, 1 mm) no "
        "pose may be.",
    )
    model_error: Literal["structured", "none"] = Field(
        default="structured",
        description="structured: choose poses that also show what geometry does not explain.",
    )


class RecordEntry(Model):
    """Who measured what, when and with what: for result.json, the report and the record."""

    laboratory: str | None = Field(default=None, description="Laboratory, with its address.")
    country: str | None = Field(
        default=None, description="Country of the laboratory: two letters of ISO 3166-1."
    )
    performed_at: (
        Literal["laboratory", "customer", "laboratoryBranch", "customerBranch", "other"] | None
    ) = Field(default=None, description="Whose place it was where the machine was calibrated.")
    place: str | None = Field(default=None, description="Where the machine was calibrated.")
    number: str | None = Field(
        default=None,
        description="Unique number of the record; by default it follows from its content.",
    )
    customer: str | None = Field(default=None, description="Customer, with a way to reach them.")
    machine: str | None = Field(default=None, description="Make and model of the machine.")
    serial: str | None = Field(default=None, description="Serial number of the machine.")
    received: str | None = Field(default=None, description="Day on which the machine was received.")
    date: str | None = Field(default=None, description="Day of the measurement.")
    issued: str | None = Field(default=None, description="Day on which the record is issued.")
    procedure: str | None = Field(
        default=None,
        description="Procedure by which the machine was measured.",
    )
    temperature: str | None = Field(default=None, description="Temperature during the measurement.")
    payload: str | None = Field(default=None, description="Payload of the machine.")
    warm_up: str | None = Field(default=None, description="How the machine was warmed up.")
    speed: str | None = Field(default=None, description="Speed between the poses.")
    instrument: str | None = Field(default=None, description="What measured: make and model.")
    instrument_serial: str | None = Field(
        default=None,
        description="Serial number of the instrument.",
    )
    traceability: str | None = Field(
        default=None,
        description="Calibration of the instrument: certificate, laboratory, date.",
    )
    adjustment: str | None = Field(
        default=None,
        description="What was adjusted after this calibration, and when.",
    )
    deviations: str | None = Field(default=None, description="Deviations from the procedure.")
    operator: str | None = Field(default=None, description="Who measured.")
    authorised_by: str | None = Field(default=None, description="Who authorises the record.")
    accreditation: str | None = Field(
        default=None,
        description="Accreditation of the laboratory; with it the record is a certificate.",
    )
    note: str | None = Field(default=None, description="Anything else that a reader should know.")


class ProjectModel(Model):
    """One calibration: a mechanism, its readings, and what is known of both."""

    schema_: Literal[1] = Field(alias="schema", description="Version of this format.")
    title: str | None = None
    mechanism: MechanismEntry | None = None
    data: DataEntry | None = None
    noise: NoiseEntries = Field(default={})
    prior: Priors = Field(
        default={},
        description="Prior sds of parameters by name or glob, inf: flat; later lines win.",
        examples=[
            {"d_*": {"sd": 1.0, "unit": "mm"}},
            {"c_*": {"sd": 1.0, "unit": "mrad", "estimate": "group"}},
        ],
    )
    parameters: ParameterEntries = Field(default={})
    fit: FitEntry = FitEntry()
    verdict: VerdictEntry = VerdictEntry()
    record: RecordEntry = RecordEntry()
    compare: CompareEntry | None = None
    plan: PlanEntry = PlanEntry()
    simulation: SimulationEntry | None = None


class _Toml(GenerateJsonSchema):
    """TOML knows no null: a key that is not stated is absent. And keys are their own titles."""

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        made = super().default_schema(schema)
        if made.get("default", 0) is None:
            del made["default"]
        return made

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def project_schema() -> dict[str, Any]:
    """The JSON Schema (draft 2020-12) of a project file."""
    made = ProjectModel.model_json_schema(by_alias=True, schema_generator=_Toml)
    made["title"] = "loopcal project"
    return {"$schema": _Toml.schema_dialect} | made
