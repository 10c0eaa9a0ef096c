"""What a mechanism file may say, type by type. Read with `mechanism_file`, which resolves it."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from loopcal.files.machines.chain_schema import ChainModel, Exponentials, Urdf
from loopcal.files.machines.effect_schema import MechanismModel
from loopcal.files.machines.instrument_schema import Instruments
from loopcal.files.machines.mechanism_parts import Amount, Motions, ParameterEntries, Units, Value
from loopcal.files.machines.parallel_schema import Delta, PassiveMachine
from loopcal.files.toml.model import Model, UnitName


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


class PlanarTwoLink(MechanismModel):
    """The planar two-link arm: xA, yA, l2, l3, phi20, phi30; reads xP, yP, phi2, phi3.

    With instruments of its own it is the links alone, l2, l3, phi20, phi30, and reads phi2, phi3.
    """

    type: Literal["planar-two-link"]
    name: str = "planar two-link arm"
    units: Units = Units()
    instrument: Instruments | None = None
    parameters: ParameterEntries = Field(default={})


def _base_form(value: Any) -> str:
    return "flag" if isinstance(value, bool) else "placement"


class Serial(ChainModel):
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
    fix_redundant: bool = Field(
        default=False, description="As of a chain of joint origins, where it is asked for."
    )
    instrument: Instruments | None = None
    parameters: ParameterEntries = Field(default={})


class Motoman(MechanismModel):
    """The Motoman MA1400 with its 27 parameters; reads theta_1 to theta_6 and x, y, z."""

    type: Literal["motoman-ma1400"]
    name: str = "Motoman MA1400"
    units: Units = Units()
    before: Motions = Field(default={})
    parameters: ParameterEntries = Field(default={})


class Function(MechanismModel):
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


AnyMechanism = (
    PlanarTwoLink | Serial | Urdf | Exponentials | PassiveMachine | Delta | Motoman | Function
)
TaggedMechanism = (
    Annotated[PlanarTwoLink, Tag("planar-two-link")]
    | Annotated[Serial, Tag("serial")]
    | Annotated[Urdf, Tag("urdf")]
    | Annotated[Exponentials, Tag("exponentials")]
    | Annotated[PassiveMachine, Tag("four-bar")]
    | Annotated[PassiveMachine, Tag("five-bar")]
    | Annotated[PassiveMachine, Tag("three-rrr")]
    | Annotated[PassiveMachine, Tag("stewart-gough")]
    | Annotated[Delta, Tag("linear-delta")]
    | Annotated[Delta, Tag("rotary-delta")]
    | Annotated[Motoman, Tag("motoman-ma1400")]
    | Annotated[Function, Tag("function")]
)
TYPES: dict[str, type[AnyMechanism]] = {
    "planar-two-link": PlanarTwoLink,
    "serial": Serial,
    "urdf": Urdf,
    "exponentials": Exponentials,
    "four-bar": PassiveMachine,
    "five-bar": PassiveMachine,
    "three-rrr": PassiveMachine,
    "stewart-gough": PassiveMachine,
    "linear-delta": Delta,
    "rotary-delta": Delta,
    "motoman-ma1400": Motoman,
    "function": Function,
}
