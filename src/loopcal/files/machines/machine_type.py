"""A type of machine in mechanism files: what its table may say, and what is built of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

from loopcal.errors import placed
from loopcal.files.machines.attached import Effects, instruments
from loopcal.files.machines.parameter_entries import PARAMETERS, SAME, StatedParameter, Units
from loopcal.files.toml.place import Place, Scope
from loopcal.keys import Key, Made
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.machine import Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.structure.structured import structured

if TYPE_CHECKING:
    from loopcal.mechanisms.serial import Joint


@dataclass(frozen=True)
class MechanismTable:
    """What mechanisms of all types may say."""

    units: Annotated[Units, Key("Units of numbers that state none; without them m and rad.")] = (
        field(default_factory=Units)
    )
    effect: Annotated[
        Effects, Key("What geometry does not explain; zero parameters change nothing.")
    ] = ()
    parameters: Annotated[Mapping[str, StatedParameter], PARAMETERS] = field(default_factory=dict)


@dataclass(frozen=True)
class MachineTable(MechanismTable):
    """What machines of all types may say."""

    structure: Annotated[
        Annotated[Mapping[str, Any], Made(structured, later=True)] | None,
        Key("The model error that the machine has beyond geometry."),
    ] = None
    same: Annotated[Mapping[str, tuple[str, ...]], SAME] = field(default_factory=dict)


@dataclass(frozen=True)
class ArmTable(MachineTable):
    """What arms of all types may say."""

    gravity: Annotated[
        tuple[float, float, float] | None,
        Key("Direction in which gravity pulls, in the base of the machine. Default: [0, 0, -1]."),
    ] = None
    mass: Annotated[
        tuple[Load, ...],
        Key(
            "What links weigh, in place of a URDF's masses of the same names; joints then yield to "
            "the moment of what hangs on them."
        ),
    ] = ()
    payload: Annotated[
        str | None,
        Key("Name of the known constant [kg] that the tool carries in each pose."),
    ] = None
    station: Annotated[
        str | None,
        Key(
            "Name of the place from which an arm of transitions is looked at: six further "
            "parameters NAME_x ... NAME_rx, which `loopcal update` estimates and writes."
        ),
    ] = None


@dataclass(frozen=True)
class ChainTable(ArmTable):
    """What chains of all types may say."""

    fix_redundant: Annotated[
        bool,
        Key(
            "Whether to fix parameters that are indistinguishable from others, chosen from the "
            "geometry; `loopcal check` reports the reason for each."
        ),
    ] = True
    remarks: Annotated[
        tuple[str, ...],
        Key("What `loopcal check` reports, such as why a parameter is fixed."),
    ] = ()


UrdfPath = Annotated[
    str | None,
    Key(
        "Path of the URDF, relative to this file; ${NAME} is replaced by the environment "
        "variable NAME.",
        example="robot.urdf",
    ),
]

Build = Callable[[Any, Any, Scope, Place], Mechanism]


@dataclass(frozen=True)
class MachineType:
    """The declarations of a type's table, and what builds the mechanism of it.

    make: has the name of the type and its keys; common: the keys that it shares with others;
    build(stated, entry, scope, place): without effects and parameters, stated being what is made of
    the common keys; joints: those of an arm with dimensions and a point of its own, as a table of
    the type "serial" lists them for any instrument.
    """

    make: Callable[..., Any]
    common: Callable[..., Any]
    build: Build
    joints: Callable[[], Sequence[Joint]] | None = None

    def listed(self) -> list[dict[str, Any]]:
        """The joints of a table of the type "serial", with what differs from a plain joint."""
        joints = self.joints() if self.joints else ()
        return [{"name": j.name, "form": j.form, "direction": j.direction} for j in joints]


def looked_at(
    machine: Machine,
    entries: Any,
    scope: Scope,
    place: Place,
    nominal: Mapping[str, float] | None = None,
) -> Mechanism:
    """The mechanism of a machine and the [[instrument]] entries; None stands for a `point`, whose
    target has another name than a joint.

    Raises InputError at the instrument that does not fit.
    """
    at = place.at("instrument")
    target = "target" if "tool_x" in machine.parameters else "tool"
    looking = (
        [point(target=target)] if entries is None else instruments(entries, machine, scope, at)
    )
    with placed(at):
        return assemble(machine, looking, nominal)
