"""Several rows of one pose: shots of one point as their mean, targets as columns of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from loopcal.files.recognition.fields import STILL, Field
from loopcal.files.recognition.headers import Heading, stem
from loopcal.files.recognition.joint_sets import usual_joints
from loopcal.presentation.shown import significant

MOST_TARGETS = 8
_ALIKE = 1e-2
"""Shots of one pose agree to this share of the span of all poses."""
_MOST = 0.9
"""The share of the shots that agree."""
ROUNDING = 1e-12
"""An sd below this share of the span comes from computing the mean."""


@dataclass(frozen=True, eq=False)
class Shots:
    """Columns with one row per key, the mean of its shots, and what to say of them."""

    fields: tuple[Field, ...]
    keys: list[Any]
    remark: str = ""


def pooled(fields: Sequence[Field], keys: Sequence[Any]) -> Shots | None:
    """The mean of the rows of each key; None where they are not alike, and so no shots of one pose.

    Rows are alike where half of the columns that vary agree.
    """
    every, where = list(dict.fromkeys(keys)), {key: i for i, key in enumerate(dict.fromkeys(keys))}
    if len(every) == len(keys):
        return Shots(tuple(fields), every)
    rows = np.array([where[key] for key in keys])
    varying = [f for f in fields if f.span > 0.0 and not f.is_time]
    pooled, scatters, alike = list[Field](), list[str](), 0
    for field in fields:
        finite = np.isfinite(field.values)
        counts = np.bincount(rows[finite], minlength=len(every))
        sums = np.bincount(rows[finite], field.values[finite], len(every))
        means = np.divide(sums, counts, out=np.full(len(every), np.nan), where=counts > 0)
        pooled.append(replace(field, values=means))
        off = (field.values - means[rows])[finite & (counts[rows] > 1)]
        # Pooled sd: each mean takes one degree of freedom of its shots.
        freedom = int(np.maximum(counts - 1, 0).sum())
        sd = float(np.sqrt(np.square(off).sum() / freedom)) if freedom else 0.0
        # A few shots may have failed: the fit names poses that do not belong.
        same = not len(off) or np.quantile(np.abs(off), _MOST) <= _ALIKE * field.span
        alike += field in varying and bool(same)
        if same and sd > ROUNDING * field.span:
            scatters.append(f"{field.label} {significant(sd, 2)}")
    if 2 * alike < len(varying):
        return None
    scatter = f" (sd of one: {', '.join(scatters[:9])}, as the file has them)" if scatters else ""
    remark = f"{len(keys)} rows are several shots of {len(every)}: their means are used{scatter}."
    return Shots(tuple(pooled), every, remark)


def widened(
    fields: Sequence[Field], ids: Sequence[str], labels: Sequence[str]
) -> tuple[Field, ...] | None:
    """Columns with a row per id; what differs between labels has a column for each of them.

    None where the labels are not few, and where the joints differ: each label counts its own poses.
    """
    kinds, poses = list(dict.fromkeys(labels)), list(dict.fromkeys(ids))
    if not 1 < len(kinds) <= MOST_TARGETS:
        return None
    # Rows of the three coordinates of one point, and not of three points.
    axes = {*map(stem, kinds)} == {*"xyz"}
    endings = [stem(kind) if axes else str(k) for k, kind in enumerate(kinds, 1)]
    place = {pose: i for i, pose in enumerate(poses)}
    rows = np.array([place[i] for i in ids]), np.array([kinds.index(k) for k in labels])
    wide = [np.full((len(poses), len(kinds)), np.nan) for _ in fields]
    for cells, field in zip(wide, fields, strict=True):
        cells[rows] = field.values
    # nanmin would warn of poses without any reading.
    low = [np.nan_to_num(cells, nan=np.inf).min(axis=1) for cells in wide]
    high = [np.nan_to_num(cells, nan=-np.inf).max(axis=1) for cells in wide]
    apart = [
        bool(((most - least)[most >= least] > STILL * field.span).any())
        for least, most, field in zip(low, high, fields, strict=True)
    ]
    joints = usual_joints([f for f in fields if f.span > 0.0])
    moved = [differs for field, differs in zip(fields, apart, strict=True) if field in joints]
    if moved and all(moved):
        return None
    differing = [field.stem for field, differs in zip(fields, apart, strict=True) if differs]
    columns: list[Field] = []
    for field, cells, least, most, differs in zip(fields, wide, low, high, apart, strict=True):
        if not (differs or any(_of_one_point(field.stem, other) for other in differing)):
            columns.append(replace(field, values=np.where(most >= least, least, np.nan)))
            continue
        header = field.heading or Heading("", f"column_{field.position + 1}")
        for k, (kind, ending) in enumerate(zip(kinds, endings, strict=True)):
            named = Heading(
                f"{header.text} of {kind}".strip(), f"{header.stem}_{ending}", header.unit
            )
            columns.append(Field(field.table, field.position, named, cells[:, k]))
    return tuple(columns)


def _of_one_point(stem: str, other: str) -> bool:
    """Whether these are names of two coordinates of one point, as `x_sd` and `y_sd`."""
    letters = [{a, b} for a, b in zip(stem, other, strict=False) if a != b]
    return len(stem) == len(other) and len(letters) == 1 and letters[0] < {*"xyz"}
