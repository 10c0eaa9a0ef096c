"""Whole robots in mechanism files: trees of bodies, of a URDF or listed row by row."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from loopcal.errors import InputError, listed, placed, unknown_name
from loopcal.files.machines.attached import Instruments
from loopcal.files.machines.machine_type import ChainTable, MachineType, UrdfPath, looked_at
from loopcal.files.machines.mechanism_writer import SOURCE
from loopcal.files.machines.serial import NominalJoint
from loopcal.files.machines.urdf import read_tree
from loopcal.files.outputs import expanded, relative
from loopcal.files.toml.place import Place, Scope
from loopcal.files.toml.reader import read_toml
from loopcal.keys import Key
from loopcal.mechanisms.bodies import NAME, Hanging, tree_machine
from loopcal.mechanisms.chain import Triple
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.origins import LinkJoint
from loopcal.mechanisms.tree import BASE


@dataclass(frozen=True)
class BodyTable(Hanging):
    """A body below its parent, with the nominal values of its row."""

    row: Annotated[
        NominalJoint | None,
        Key("The row of Denavit and Hartenberg that ties it; its name is what is read."),
    ] = None

    @property
    def hanging(self) -> Hanging:
        """The body alone."""
        row = None if self.row is None else self.row.joint
        return Hanging(self.name, self.parent, self.joint, row, self.fixed, self.standing)


@dataclass(frozen=True)
class StandingRobot:
    """One of several robots under one ground, by its URDF."""

    file: Annotated[str, Key("Path of the URDF, relative to this file.")]
    prefix: Annotated[str, Key("Begins the names of its bodies and joints, such as left_.")] = ""
    root: Annotated[
        str | None, Key("Link that stands on the ground. Default: the root of the URDF.")
    ] = None
    use: Annotated[
        tuple[str, ...],
        Key("Links that are looked at, without prefix. Default: those that the instruments name."),
    ] = ()
    xyz: Annotated[
        Triple,
        Key("Where its root stands beside that of the first robot, roughly.", unit="m"),
    ] = (0.0, 0.0, 0.0)
    rpy: Annotated[Triple, Key("Roll, pitch and yaw of it, roughly.", unit="rad")] = (0.0, 0.0, 0.0)

    def hangs(self, body: Hanging) -> Hanging:
        """One of its bodies with the names that it has beside other robots."""
        joint = body.joint
        assert joint is not None  # of a URDF
        if joint.mimic:
            mimic = replace(joint.mimic, joint=f"{self.prefix}{joint.mimic.joint}")
            joint = replace(joint, mimic=mimic)
        joint = replace(joint, name=f"{self.prefix}{joint.name}")
        return Hanging(f"{self.prefix}{body.name}", f"{self.prefix}{body.parent}", joint)

    def weighs(self, load: Load) -> Load:
        """What one of its links weighs, by the names of `hangs`."""
        return replace(load, name=f"{self.prefix}{load.name}", joint=f"{self.prefix}{load.joint}")


@dataclass(frozen=True)
class Tree(ChainTable):
    """A robot of several arms, heads or hands: bodies that hang on each other."""

    name: Annotated[str, Key("Name of the machine.")] = NAME
    file: UrdfPath = None
    root: Annotated[
        str | None,
        Key(
            "Body that stands for the ground, in which stations stand. Default: the root of the "
            "URDF; of listed bodies base."
        ),
    ] = None
    use: Annotated[
        tuple[str, ...],
        Key(
            "Links of the URDF that are looked at; the joints from the root to them are "
            "calibrated. Default: those that the instruments name."
        ),
    ] = ()
    body: Annotated[tuple[BodyTable, ...], Key("The bodies, in place of a file.")] = ()
    robot: Annotated[
        tuple[StandingRobot, ...],
        Key(
            "Several robots, in place of a file. The root of the first one is the ground; six "
            "parameters PREFIXmount_x, ... say where another one stands."
        ),
    ] = ()
    source: Annotated[
        str | None,
        Key("Path of the URDF that listed bodies were read from; `loopcal export` patches it."),
    ] = None
    instrument: Annotated[
        Instruments, Key("What is read of its bodies, each from the ground or another body.")
    ] = ()
    observation: Annotated[Instruments, Key("The same as instrument; behind these.")] = ()


def tree(model: Tree, entry: Any, scope: Scope, place: Place) -> Mechanism:
    """The robot of a table of the type "tree".

    Raises InputError at the key, body or line of the URDF that does not fit.
    """
    ways = {"file": model.file is not None, "body": bool(model.body), "robot": bool(model.robot)}
    given = [key for key, is_there in ways.items() if is_there]
    if len(given) != 1:
        raise InputError(
            f"{listed(given)} are given, but one of them must describe the robot"
            if given
            else "neither a file nor bodies are given",
            code="conflicting-keys",
            place=str(place.at(given[-1] if given else "file")),
            remedy='name the robot: file = "robot.urdf", or list its bodies',
        )
    entries = [*entry.instrument, *entry.observation]
    nominal: dict[str, float] = {}
    masses: tuple[Load, ...] = ()
    source, root = model.source, model.root or BASE
    if model.robot:
        root, bodies, masses = _side_by_side(model, entries, place)
    elif model.file is None:
        bodies = tuple(body.hanging for body in model.body)
        for i, body in enumerate(model.body):
            if body.row is not None:
                nominal |= body.row.nominal(body.name, place.at("body", i, "row"))
    else:
        source = model.file
        path = expanded(model.file, Path(place.file).parent, place.at("file"))
        leaves = model.use or tuple(dict.fromkeys(_named(entries, model.root)))
        if not leaves:
            raise InputError(
                "no body of the robot is named",
                code="missing-key",
                place=str(place.at("use")),
                remedy='name the links that are looked at: use = ["left_hand", "right_hand"]',
            )
        root, bodies, masses = read_tree(path, leaves, model.root)
    with placed(place.at(*given)):
        machine = tree_machine(bodies, root=root, name=model.name, masses=masses)
    if source is not None:
        found = expanded(source, Path(place.file).parent, place.at("source")).absolute()
        machine = replace(machine, description={**machine.description, SOURCE: str(found)})
    return looked_at(machine, entries, scope, place, nominal)


def tree_table(path: Path, folder: Path) -> dict[str, Any]:
    """The [mechanism] that a file of the type "tree" describes, for a project in this folder.

    Without its instruments. Raises InputError for a file of another type.
    """
    table = dict(read_toml(path))
    if table.get("type") != "tree":
        raise InputError(
            f"it describes a machine of the type {table.get('type')!r}",
            code="invalid-value",
            place=path.name,
            remedy='observations between two bodies need the type "tree"',
        )
    for key in ("schema", "instrument", "observation"):
        table.pop(key, None)

    def moved(entry: dict[str, Any]) -> dict[str, Any]:
        file = entry.get("file")
        return entry if file is None else {**entry, "file": relative(path.parent / file, folder)}

    if "robot" in table:
        table["robot"] = [moved(dict(one)) for one in table["robot"]]
    return moved(table)


def _side_by_side(
    model: Tree, entries: Any, place: Place
) -> tuple[str, tuple[Hanging, ...], tuple[Load, ...]]:
    """The ground, the bodies and the masses of several robots."""
    ground, bodies, masses = "", list[Hanging](), list[Load]()
    prefixes = sorted((one.prefix for one in model.robot), key=len, reverse=True)
    twice = [p for p in prefixes if prefixes.count(p) > 1]
    if twice:
        raise InputError(
            f"two robots have the prefix {twice[0]!r}",
            code="duplicate-name",
            place=str(place.at("robot")),
            remedy="give each another prefix: one name is one body, one joint and one reading",
        )
    for name in _named(entries, model.root):
        if not name.startswith(tuple(prefixes)):
            raise unknown_name(f"no robot has a prefix that begins {name!r}", name, prefixes)
    for i, one in enumerate(model.robot):
        at = place.at("robot", i)
        named = dict.fromkeys(
            name.removeprefix(one.prefix)
            for name in _named(entries, model.root)
            if next((p for p in prefixes if name.startswith(p)), None) == one.prefix
        )
        leaves = one.use or tuple(named)
        if not leaves:
            raise InputError(
                f"no instrument looks at a body of {one.file!r}",
                code="missing-key",
                place=str(at.at("use")),
                remedy='name the links that are looked at: use = ["hand"]',
            )
        path = expanded(one.file, Path(place.file).parent, at.at("file"))
        with placed(at):
            root, hanging, weights = read_tree(path, leaves, one.root)
        bodies += [one.hangs(body) for body in hanging]
        masses += [one.weighs(load) for load in weights]
        stands = LinkJoint(f"{one.prefix}mount", "fixed", one.xyz, one.rpy)
        if i == 0:
            ground = f"{one.prefix}{root}"
            if any((*one.xyz, *one.rpy)):
                raise InputError(
                    "the root of the first robot is the ground",
                    code="conflicting-keys",
                    place=str(at.at("xyz" if any(one.xyz) else "rpy")),
                    remedy="state where the other robots stand beside it",
                )
        else:
            bodies.append(Hanging(f"{one.prefix}{root}", ground, stands, standing=True))
    return ground, tuple(bodies), tuple(masses)


def _named(entries: Any, root: str | None) -> Iterator[str]:
    """The bodies that instruments look at and from."""
    for entry in entries:
        pair = (getattr(entry, key, None) for key in ("on", "against", "sees"))
        for name in (*pair, *(getattr(entry, "between", None) or ())):
            if name not in (None, root, "base", "body"):
                yield str(name)


TYPES = {"tree": MachineType(Tree, Tree, tree)}
