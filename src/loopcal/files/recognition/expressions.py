"""Joint readings computed from columns: `-J4`, `J2 + 90`, `J3 + J2`, `J1 * 0.0012`.

A joint may count the other way round, from another zero, together with another joint, or in counts
of an encoder. Numbers are in the unit of the first column.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from loopcal.errors import unknown_name
from loopcal.files.recognition.fields import Field
from loopcal.files.recognition.headers import Heading, heading
from loopcal.files.tables.cells import is_number


def joint_columns(fields: Sequence[Field], text: str) -> tuple[Field, ...]:
    """The columns of the joints, from their names or expressions divided by commas.

    Raises InputError for what names no column.
    """
    columns = []
    for part in (part.strip() for part in text.split(",")):
        column = computed_column(fields, part)
        if column is None:
            labels = [f.label for f in fields]
            raise unknown_name(
                f"{part!r} is no column, and no sum of columns and numbers",
                part.lstrip("-"),
                labels,
                "--joints",
            )
        columns.append(column)
    return tuple(columns)


def turned_columns(
    fields: Sequence[Field], columns: Sequence[Field]
) -> tuple[tuple[Field, ...], tuple[int, ...]]:
    """The columns as the file has them, and -1 for each that an expression only turns round."""
    by_label = {f"-{f.label}": f for f in fields}
    plain = [by_label.get(c.label) if c.computed else None for c in columns]
    kept = tuple(p or c for p, c in zip(plain, columns, strict=True))
    return kept, tuple(-1 if p else 1 for p in plain)


def computed_column(fields: Sequence[Field], text: str) -> Field | None:
    """The column of this name, or one computed as the expression says; None where it says nothing.

    >>> import numpy as np
    >>> J = [Field(0, i, heading(f"J{i + 1}"), np.array([10.0 * i])) for i in range(3)]
    >>> computed_column(J, "-J3 + J2 - 90").values
    array([-100.])
    >>> computed_column(J, "J2 + J3 * 0.5").values
    array([20.])
    """
    column = _column(fields, text)
    if column is not None:
        return column
    computed = _sum(fields, text)
    if computed is None:
        return None
    named = Heading(text, computed.stem, computed.unit)
    return replace(computed, heading=named, computed=True)


def _sum(fields: Sequence[Field], text: str) -> Field | None:
    """Terms, as far as needed to the right; a factor multiplies its term alone."""
    term = _term(fields, text)
    if term is not None:
        return term
    for i in sorted((i for i, c in enumerate(text) if i and c in "+-"), reverse=True):
        sign, last = (1.0 if text[i] == "+" else -1.0), text[i + 1 :].strip()
        number = is_number(last)
        other = None if number else _term(fields, last)
        rest = _sum(fields, text[:i].strip()) if number or other else None
        if rest is not None:
            added = other.values if other else float(last)
            return replace(rest, values=rest.values + sign * added)
    if text.startswith("-"):
        rest = _term(fields, text[1:].strip())
        return rest and replace(rest, values=-rest.values)
    return None


def _term(fields: Sequence[Field], text: str) -> Field | None:
    """A column, or one with a factor."""
    column = _column(fields, text)
    name, _, factor = text.rpartition("*")
    if column is None and name and is_number(factor.strip()):
        rest = _term(fields, name.strip())
        return rest and replace(rest, values=float(factor) * rest.values)
    return column


def _column(fields: Sequence[Field], name: str) -> Field | None:
    exact = [f for f in fields if f.label == name]
    # A leading sign is no part of a name, unless a header begins with it.
    if exact or name.startswith("-"):
        return exact[0] if exact else None
    alike = [f for f in fields if f.stem and f.stem == heading(name).stem]
    return alike[0] if len(alike) == 1 else None
