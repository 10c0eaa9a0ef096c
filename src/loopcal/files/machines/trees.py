"""Whole robots in mechanism files: trees of bodies, of a URDF or listed row by row."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from loopcal.errors import InputError, placed
from loopcal.files.machines.attached import Instruments
from loopcal.files.machines.machine_type import ChainTable, MachineType, UrdfPath, looked_at
from loopcal.files.machines.mechanism_writer import SOURCE
from loopcal.files.machines.serial import NominalJoint
from loopcal.files.machines.urdf import read_tree
from loopcal.files.outputs import expanded
from loopcal.files.toml.place import Place, Scope
from loopcal.keys import Key
from loopcal.mechanisms.bodies import NAME, Hanging, tree_machine
from loopcal.mechanisms.effects.gravity import Load
from loopcal.mechanisms.mechanism import Mechanism
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
        return Hanging(self.name, self.parent, self.joint, row, self.fixed)


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
    if (model.file is None) == (not model.body):
        words = "neither a file nor bodies are" if model.file is None else "a file and bodies are"
        raise InputError(
            f"{words} given, but exactly one of the two must describe the robot",
            code="conflicting-keys",
            place=str(place.at("body" if model.body else "file")),
            remedy='name the robot: file = "robot.urdf", or list its bodies',
        )
    entries = [*entry.instrument, *entry.observation]
    nominal: dict[str, float] = {}
    masses: tuple[Load, ...] = ()
    source, root = model.source, model.root or BASE
    if model.file is None:
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
    with placed(place.at("body" if model.body else "file")):
        machine = tree_machine(bodies, root=root, name=model.name, masses=masses)
    if source is not None:
        found = expanded(source, Path(place.file).parent, place.at("source")).absolute()
        machine = replace(machine, description={**machine.description, SOURCE: str(found)})
    return looked_at(machine, entries, scope, place, nominal)


def _named(entries: Any, root: str | None) -> Iterator[str]:
    """The bodies that instruments look at and from."""
    for entry in entries:
        pair = (getattr(entry, key, None) for key in ("on", "against", "sees"))
        for name in (*pair, *(getattr(entry, "between", None) or ())):
            if name not in (None, root, "base", "body"):
                yield str(name)


TYPES = {"tree": MachineType(Tree, Tree, tree)}
