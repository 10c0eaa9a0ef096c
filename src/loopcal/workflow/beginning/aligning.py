"""Two files without ids of which one lacks rows: their order, proved by the nominal machine.

Twelve neighbouring rows, tried some rows apart, place the machine. It then predicts the point of
every row of joints. A row of the instrument belongs to the row whose point is nearest, if no other
one is nearly as near and all follow each other in order.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import listed
from loopcal.estimation.problem.alignment import align
from loopcal.files.recognition.fields import Source
from loopcal.files.recognition.joins import Fields, paired
from loopcal.files.recognition.layouts import Layout
from loopcal.files.recognition.meanings import positions
from loopcal.presentation.shown import with_unit
from loopcal.units import to_si
from loopcal.workflow.beginning.searching import CLEARLY, Machine, Understood, every_way

Rows = NDArray[np.intp]
_BLOCK, _BLOCKS, _MOST_LOST = 12, 9, 20
"""Rows that place the machine, so many places where these are tried, and rows that may be lost."""
_PLACED = 0.02
"""A placed nominal machine misses its readings by a smaller share of their spread."""

Reader = Callable[[Fields], tuple[Machine, Sequence[Layout]]]
"""The machine and the ways to read columns."""


def aligned(sources: Sequence[Source], read: Reader) -> Fields | None:
    """The tables side by side in the only order that the nominal machine allows; else None."""
    if len(sources) != 2 or any(source.ids is not None for source in sources):
        return None
    lengths = [len(source) for source in sources]
    least, lost = min(lengths), abs(lengths[0] - lengths[1])
    if least < _BLOCK or not 0 < lost <= _MOST_LOST:
        return None
    longer = lengths.index(max(lengths))
    for begin in np.unique(np.linspace(0, least - _BLOCK, _BLOCKS).astype(int)):
        for shift in range(lost + 1):
            rows = [np.arange(begin, begin + _BLOCK) + shift * (i == longer) for i in (0, 1)]
            machine, layouts = read(_side_by_side(sources, rows))
            way = min(every_way(machine, layouts), key=lambda u: u.share, default=None)
            if way is None or way.share > _PLACED:
                continue
            if (fields := _matched(sources, machine, way, rows)) is not None:
                return fields
    return None


def _side_by_side(sources: Sequence[Source], rows: Sequence[Rows]) -> Fields:
    fields = tuple(
        replace(f, values=f.values[some])
        for source, some in zip(sources, rows, strict=True)
        for f in source.fields
    )
    return Fields(tuple(sources), tuple(str(i) for i in range(len(rows[0]))), fields)


def _matched(
    sources: Sequence[Source], machine: Machine, way: Understood, where: Sequence[Rows]
) -> Fields | None:
    """The rows that belong together, from the rows `where` that placed the machine."""
    meaning = way.seen[0]
    tables = [source.fields[0].table for source in sources]
    joints = tables.index(way.layout.joints[0].table)
    whole = {(f.table, f.position): f for source in sources for f in source.fields}
    if meaning.seen.kind not in ("point", "spherical") or meaning.fit is None:
        return None
    position = tuple(whole[f.table, f.position] for f in meaning.seen.position)
    columns = [whole[f.table, f.position] for f in way.layout.joints]
    if {f.table for f in position} != {tables[1 - joints]} or len({f.table for f in columns}) > 1:
        return None
    read = {
        name: to_si(f.values, of)
        for name, f, of in zip(machine.joints, columns, way.units, strict=True)
    }
    points = positions(replace(meaning.seen, position=position), *meaning.read_in)
    body = machine.bodies(read).at(meaning.fit.targets[0])
    motion = align(body[where[joints]].T, points[where[1 - joints]].T)
    placed = body @ motion.rotation.T + motion.shift
    apart = np.linalg.norm(points[:, None] - placed[None], axis=2)
    # The rows of the shorter table each have one partner in the longer one.
    few = int(np.argmin(apart.shape))
    apart = apart if few == 0 else apart.T
    partner, ranked = apart.argmin(axis=1), np.sort(apart, axis=1)
    # Written so that NaN is no proof.
    if not (CLEARLY * ranked[:, 0] < ranked[:, 1]).all() or not (np.diff(partner) > 0).all():
        return None
    every = np.arange(len(partner))
    of_points, of_joints = (every, partner) if few == 0 else (partner, every)
    pairs = (of_joints, of_points) if joints == 0 else (of_points, of_joints)
    less = 1 - joints if few == 0 else joints
    gone = sorted({*range(apart.shape[1])} - {*partner.tolist()})
    remark = (
        f"{sources[less].name} has no row beside {listed([str(i + 1) for i in gone])} of "
        f"{sources[1 - less].name}: the rows are joined in the only order in which the nominal "
        f"machine fits, off by {with_unit(float(np.median(ranked[:, 0])), 'm', 2)} where the next "
        f"row is off by {with_unit(float(np.median(ranked[:, 1])), 'm', 2)} (medians)"
    )
    return paired(sources, pairs, remark)
