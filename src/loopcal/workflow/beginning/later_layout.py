"""Files of a later day in another layout than the first ones, read by what the machine fits."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from loopcal.files.cameras.folder import tables_of
from loopcal.files.recognition.conditions import by_condition, degrees_of
from loopcal.files.recognition.converting import Reading, dataset_of, quaternions, readings_of
from loopcal.files.recognition.joins import Fields, joined
from loopcal.files.recognition.joint_sets import computed_column, named_joints
from loopcal.files.recognition.layouts import Layout, layouts
from loopcal.files.recognition.logs import at_rest
from loopcal.files.recognition.meanings import Meaning
from loopcal.files.recognition.robots import parallel_machine
from loopcal.files.recognition.sources import sources_of_all
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Family, Mechanism
from loopcal.units import to_si
from loopcal.workflow.beginning.searching import Machine, every_way, machine_of
from loopcal.workflow.beginning.understanding import understood

_FORMS = frozenset({"point", "pose", "spherical", "length"})
"""Instruments whose readings are all columns."""
_PLACES = {"point": ("m", "m", "m"), "spherical": ("m", "rad", "rad")}
"""Units of instruments that read where a point is, of which one may take the place of another."""

_FIRST = re.compile(r"-?([^-+*]+)")
"""The column that an expression such as J3+J2 begins with: the joint's own one."""


def later_layout(
    entries: Sequence[Any], mechanism: Mechanism, columns: Mapping[str, Any] | None = None
) -> Dataset | None:
    """The readings by the only columns and units in which a calibrated machine fits them.

    columns: those of the joints on the first day, by quantity, some of them computed.
    None for a machine that this cannot be asked of: of closed loops in a plane or without an
    instrument, with constants other than orientations, payloads and temperatures, or with other
    instruments than trackers, poses and lengths.
    Raises InputError where nothing fits, or several.
    """
    forms = [family.form for family in mechanism.families]
    machine = _machine(mechanism)
    if machine is None or not forms or not _FORMS.issuperset(forms):
        return None
    sources, _ = at_rest(sources_of_all(tables_of(entries)), machine.joints)
    fields, stated = _conditions(joined(sources), mechanism)
    oriented = {name for of in mechanism.orientations for name in of.columns}
    if mechanism.pose_constants.keys() - mechanism.latest.keys() - oriented - stated.keys():
        return None
    present = len(named_joints(fields.fields, machine.joints))
    if len(machine.joints) < 2 * present < 2 * len(machine.joints):
        return None  # the layout of the first day, of which a column is missing
    every = layouts(fields.fields, len(machine.joints), machine.joints)
    by_joint = [str((columns or {}).get(name, {}).get("column", name)) for name in machine.joints]
    every += tuple(filter(None, (_computed(layout, by_joint) for layout in every)))
    ways = sorted(every_way(machine, every), key=lambda way: way.share)
    way = understood(machine, every, fields, None, ways)
    kinds = [meaning.seen.kind for meaning in way.seen]
    if len(kinds) != len(forms) or not all(map(_serves, kinds, forms)):
        return None
    joints = zip(machine.joints, way.layout.joints, machine.units, way.units, strict=True)
    readings = {name: Reading(way.joints[name], si, f, of) for name, f, si, of in joints} | stated
    for family, meaning in zip(mechanism.families, way.seen, strict=True):
        readings |= _placed(replace(meaning, turns=None), family)
        for orientation in mechanism.orientations:
            if orientation.turns == family.readings[-3:] and meaning.turns is not None:
                written = orientation.written(quaternions(meaning.turns))
                units = orientation.units
                readings |= {n: Reading(v, units[n], None, units[n]) for n, v in written.items()}
    made = dataset_of(fields.poses, readings)
    names = dict.fromkeys(source.name for source in sources)
    meant = [
        *way.words,
        *(f"the {n} {r.field.label} in {r.unit}" for n, r in stated.items() if r.field),
    ]
    words = f"Other columns than on the first day, read as {'; '.join(meant)}."
    source = replace(made.source, file=", ".join(names), rows_read=len(made), read_as=words)
    return replace(made, source=source)


def _computed(layout: Layout, expressions: Sequence[str]) -> Layout | None:
    """With joints computed from columns of other names as on the first day; None where none was."""
    first = [match[1].strip() if (match := _FIRST.match(text)) else text for text in expressions]
    if first == list(expressions) or len(set(first)) < len(first):
        return None
    labels = {name: field.label for name, field in zip(first, layout.joints, strict=True)}
    names = re.compile("|".join(map(re.escape, sorted(labels, key=len, reverse=True))))
    texts = [names.sub(lambda match: labels[match[0]], text) for text in expressions]
    made = [computed_column(layout.joints, text) for text in texts]
    return replace(layout, joints=tuple(j for j in made if j)) if all(made) else None


def _serves(kind: str, form: str) -> bool:
    """Whether an instrument of a kind reads what one of a form did."""
    return kind == form or (form in _PLACES and kind in (*_PLACES, "pose"))


def _placed(meaning: Meaning, family: Family) -> dict[str, Reading]:
    """What a family reads, of range and angles as coordinates and the reverse."""
    if meaning.seen.kind == family.form:
        return readings_of(meaning, family.readings)
    x, y, z = values = meaning.position.T
    if family.form == "spherical":
        flat = np.hypot(x, y)
        values = np.array([np.hypot(flat, z), np.arctan2(y, x), np.arctan2(z, flat)])
    every = zip(family.readings, values, _PLACES[family.form], strict=True)
    return {name: Reading(v, si, None, si) for name, v, si in every}


def _machine(mechanism: Mechanism) -> Machine | None:
    """What the joints move; None where the columns would not show it."""
    if mechanism.chain:
        return None if mechanism.home else Machine(mechanism, tuple(mechanism.joints))
    robot = parallel_machine(mechanism)
    return None if robot is None else machine_of(robot, "the first day")


def _conditions(fields: Fields, mechanism: Mechanism) -> tuple[Fields, dict[str, Reading]]:
    """The columns without those of conditions; payload and temperature where a machine has them."""
    some = by_condition(fields, mechanism.joints)
    gone = {id(f) for columns in some.values() for f in columns}
    units = mechanism.pose_constants
    readings = {}
    for name, columns in some.items():
        of = degrees_of(columns[0]) if columns and name == "temperature" else "kg"
        if columns and name in units and of is not None:
            readings[name] = Reading(to_si(columns[0].values, of), units[name], columns[0], of)
    kept = tuple(f for f in fields.fields if id(f) not in gone)
    return replace(fields, fields=kept), readings
