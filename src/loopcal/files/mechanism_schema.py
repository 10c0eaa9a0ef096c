"""What a mechanism file may say, type by type. Read with `mechanism_file`, which resolves it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Discriminator, Field, Tag

from loopcal.files.instrument_schema import Instruments
from loopcal.files.model import Finite, Model, Sd, UnitName, complaint, plain_number_as
from loopcal.units import unit


def _of(dimension: str) -> AfterValidator:
    def check(name: str) -> str:
        if unit(name).dimension != dimension:
            words = f"{name!r} is a unit of {unit(name).dimension}"
            raise complaint(words, f"give a unit of {dimension}")
        return name

    return AfterValidator(check)


class Units(Model):
    """Units of the numbers that state none; without them m and rad."""

    length: Annotated[UnitName, _of("length")] | None = None
    angle: Annotated[UnitName, _of("angle")] | None = None

    def by_dimension(self) -> dict[str, str]:
        """Dimension -> name of its unit, for those stated."""
        both = {"length": self.length, "angle": self.angle}
        return {dimension: name for dimension, name in both.items() if name is not None}


class Value(Model):
    """A number with its unit."""

    value: Finite
    unit: UnitName | None = None


Amount = Annotated[Value, plain_number_as("value", Value)]
Motion = Literal["tx", "ty", "tz", "rx", "ry", "rz"]
Motions = Annotated[
    dict[Motion, Amount],
    Field(
        description="Fixed, exactly known motions in the order of writing: displacements along "
        "x, y, z and turns about them.",
        examples=[{"rz": 90, "tx": 0.1}],
    ),
]


class ParameterEntry(Model):
    """What is known of a parameter: nominal value, how well it is known, whether it is fixed."""

    value: Finite | None = None
    unit: UnitName | None = Field(default=None, description="Of the value and of the sd.")
    sd: Sd | None = Field(
        default=None, description="Prior sd: how well the value is known; inf: not at all."
    )
    fixed: bool | None = Field(default=None, description="true: not estimated.")


ParameterEntries = Annotated[
    dict[str, Annotated[ParameterEntry, plain_number_as("value", ParameterEntry)]],
    Field(
        description="Parameters by name or glob; later lines win.",
        examples=[{"alpha_*": {"fixed": True}, "d_1": {"sd": 1.0, "unit": "mm"}}],
    ),
]


class BasePlacement(Model):
    """Where the instrument sees the base: Tx Ty Tz Rz Ry Rx, six parameters base_x ... base_rx."""

    x: Amount | None = None
    y: Amount | None = None
    z: Amount | None = None
    rz: Amount | None = None
    ry: Amount | None = None
    rx: Amount | None = None


class ToolPoint(Model):
    """The measured point in the last joint's frame."""

    x: Amount | None = None
    y: Amount | None = None
    z: Amount | None = None


class JointEntry(Model):
    """A joint; of the nominal values those that its form has, absent ones being 0."""

    name: str = Field(description="The quantity that is read.")
    form: Literal["dh", "mdh", "hayati", "transition-x", "transition-y", "transition-z"] = "dh"
    kind: Literal["revolute", "prismatic"] = "revolute"
    direction: Literal[1, -1] = Field(
        default=1, description="-1: the reading counts against the axis."
    )
    before: Motions = Field(default={})
    after: Motions = Field(default={})
    a: Amount | None = None
    d: Amount | None = None
    alpha: Amount | None = None
    beta: Amount | None = None
    offset: Amount | None = None
    x: Amount | None = None
    y: Amount | None = None
    z: Amount | None = None
    phix: Amount | None = None
    phiy: Amount | None = None
    phiz: Amount | None = None

    def nominal(self) -> dict[str, Value]:
        """The nominal values given, by key."""
        values = {key: getattr(self, key) for key in NOMINAL_KEYS}
        return {key: value for key, value in values.items() if value is not None}


NOMINAL_KEYS = ("a", "d", "alpha", "beta", "offset", "x", "y", "z", "phix", "phiy", "phiz")


class PlanarTwoLink(Model):
    """The planar two-link arm: xA, yA, l2, l3, phi20, phi30; reads xP, yP, phi2, phi3."""

    type: Literal["planar-two-link"]
    name: str = "planar two-link arm"
    units: Units = Units()
    parameters: ParameterEntries = Field(default={})


def _base_form(value: Any) -> str:
    return "flag" if isinstance(value, bool) else "placement"


class Serial(Model):
    """A serial arm: a chain of joints, its tool point measured in the instrument's frame."""

    type: Literal["serial"]
    name: str = "serial arm"
    units: Units = Units()
    base: (
        Annotated[
            Annotated[bool, Tag("flag")] | Annotated[BasePlacement, Tag("placement")],
            Discriminator(_base_form),
        ]
        | None
    ) = Field(
        default=None,
        description="Whether six parameters place the base in the instrument's frame, or their "
        "nominal values; by default they do unless all joints are transitions.",
    )
    tool: ToolPoint = ToolPoint()
    point: Annotated[list[str], Field(min_length=3, max_length=3)] = Field(
        default=["x", "y", "z"], description="Names of the measured coordinates."
    )
    joint: list[JointEntry] = Field(min_length=1, description="From the base to the tip.")
    instrument: Instruments | None = None
    parameters: ParameterEntries = Field(default={})


class Motoman(Model):
    """The Motoman MA1400 with its 27 parameters; reads theta_1 to theta_6 and x, y, z."""

    type: Literal["motoman-ma1400"]
    name: str = "Motoman MA1400"
    units: Units = Units()
    before: Motions = Field(default={})
    parameters: ParameterEntries = Field(default={})


class Function(Model):
    """What is read and what is constant in loops written as a Python function f(x, p).

    The function itself is named where the project is used: --mechanism FILE.py:FUNCTION.
    """

    type: Literal["function"]
    name: str | None = None
    units: Units = Units()
    quantities: dict[str, UnitName] = Field(
        default={}, description="What is read in each pose, and its unit."
    )
    known: dict[str, UnitName] = Field(
        default={}, description="Constants that vary by pose and carry no error, and their unit."
    )
    outputs: list[str] = Field(
        default=[], description="The quantities that the loops predict from the rest."
    )
    loops: list[str] | None = Field(default=None, description="Names of the equations.")
    parameters: ParameterEntries = Field(default={})


AnyMechanism = PlanarTwoLink | Serial | Motoman | Function
TaggedMechanism = (
    Annotated[PlanarTwoLink, Tag("planar-two-link")]
    | Annotated[Serial, Tag("serial")]
    | Annotated[Motoman, Tag("motoman-ma1400")]
    | Annotated[Function, Tag("function")]
)
TYPES: dict[str, type[AnyMechanism]] = {
    "planar-two-link": PlanarTwoLink,
    "serial": Serial,
    "motoman-ma1400": Motoman,
    "function": Function,
}
