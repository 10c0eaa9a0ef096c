"""Files of a later day in another layout than the first ones, read by what the machine fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from loopcal.files.cameras.folder import tables_of
from loopcal.files.recognition.converting import Reading, dataset_of, readings_of
from loopcal.files.recognition.joins import joined
from loopcal.files.recognition.layouts import layouts
from loopcal.files.recognition.logs import at_rest
from loopcal.files.recognition.sources import sources_of_all
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.workflow.beginning.searching import Machine, every_way
from loopcal.workflow.beginning.understanding import understood

_FORMS = frozenset({"point", "spherical", "length"})
"""Instruments whose readings are all columns."""


def later_layout(entries: Sequence[Any], mechanism: Mechanism) -> Dataset | None:
    """The readings by the only columns and units in which a calibrated machine fits them.

    None for a machine that this cannot be asked of: with a closed loop, loads or temperatures, or
    other instruments than trackers and lengths. Raises InputError where nothing fits, or several.
    """
    forms = [family.form for family in mechanism.families]
    conditions = mechanism.pose_constants.keys() - mechanism.latest.keys()
    if mechanism.home or not mechanism.chain or conditions:
        return None
    if not forms or not _FORMS.issuperset(forms):
        return None
    machine = Machine(mechanism, tuple(mechanism.joints))
    sources, _ = at_rest(sources_of_all(tables_of(entries)), machine.joints)
    fields = joined(sources)
    every = layouts(fields.fields, len(machine.joints), machine.joints)
    ways = sorted(every_way(machine, every), key=lambda way: way.share)
    way = understood(machine, every, fields, None, ways)
    if [meaning.seen.kind for meaning in way.seen] != forms:
        return None
    columns = zip(machine.joints, way.layout.joints, machine.units, way.units, strict=True)
    readings = {name: Reading(way.joints[name], si, f, of) for name, f, si, of in columns}
    for family, meaning in zip(mechanism.families, way.seen, strict=True):
        readings |= readings_of(meaning, family.readings)
    made = dataset_of(fields.poses, readings)
    names = dict.fromkeys(source.name for source in sources)
    words = f"Other columns than on the first day, read as {'; '.join(way.words)}."
    source = replace(made.source, file=", ".join(names), rows_read=len(made), read_as=words)
    return replace(made, source=source)
