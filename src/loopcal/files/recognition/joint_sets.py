"""Every set of columns that may be the joints: by names of the machine, usual names or numbers."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from loopcal.errors import unknown_name
from loopcal.files.recognition.fields import Field, moving
from loopcal.files.recognition.headers import Heading, arms, heading, stem, words
from loopcal.files.tables.cells import is_number

_JOINT_WORDS = frozenset(words("columns", "joint"))
_ARMS = arms()
NUMBERED = re.compile(r"^(?P<word>.*?)_?(?P<number>\d{1,2})(?P<rest>(?:_?[^\W\d]+)*)$")
UNIT_NORM = 0.02
"""Columns of rotations are as long as they should be to this share; digits are often rounded."""
_FURTHER = 2
"""External axes that are sought beside numbered joints."""

Joints = tuple[tuple[Field, ...], str]
"""Columns in the order of the machine's joints, and by what they were recognised."""


def named_joints(fields: Sequence[Field], names: Iterable[str]) -> dict[str, Field]:
    """Joint name -> the column of that name, for all that have one."""
    by_stem = {f.stem: f for f in fields if f.stem}
    exact = {f.heading.text: f for f in fields if f.heading}
    joints = {}
    for name in names:
        field = exact.get(name) or by_stem.get(stem(name))
        if field is not None:
            joints[name] = field
    return joints


def affixed_joints(fields: Sequence[Field], names: Sequence[str]) -> Iterator[tuple[Field, ...]]:
    """Columns whose names are those of the joints with one beginning and one end for all of them.

    "shoulder.position" and "cmd_shoulder" are such; so are the names themselves.
    """
    by_stem = {f.stem: f for f in fields if f.stem}
    stems = [stem(name) for name in names]
    for field in fields if stems else ():
        before, _, after = field.stem.partition(stems[0])
        columns = [f"{before}{name}{after}" for name in stems]
        if columns[0] == field.stem and all(c in by_stem for c in columns):
            yield tuple(by_stem[c] for c in columns)


def usual_joints(fields: Sequence[Field]) -> tuple[Field, ...]:
    """Columns named as joints usually are (J1 ..., theta_1 ..., S L U R B T); empty if none.

    What stands still beside the others is an external axis that did not move.
    """
    for arm in _ARMS:
        for columns in affixed_joints(fields, arm):
            return moving(columns)
    named = [members for word, members in families_of(fields) if _is_joint_word(word)]
    return max(named, key=len, default=())


def names_joints(names: Sequence[str], *, every: bool = False) -> bool:
    """Whether some of these names, or all, are those of joints."""
    fields = [Field(0, i, heading(n), np.arange(2.0)) for i, n in enumerate(names) if n]
    count = len(usual_joints(fields))
    return count > 1 and (not every or count == len(names))


BY_MACHINE = "by the machine's joint names"


def joint_sets(fields: Sequence[Field], count: int, names: Sequence[str]) -> list[Joints]:
    """Every set of `count` columns that may be the joints, the likeliest first.

    names: of the machine's joints. Numbered columns that do not have joint words are tried where
    no others are there; columns beside numbered ones where an external axis is missing.
    """
    exact = named_joints(fields, names)
    sets: list[Joints] = []
    if names and len(exact) == len(names):
        sets.append((tuple(exact[n] for n in names), BY_MACHINE))
    sets += [(columns, BY_MACHINE) for columns in affixed_joints(fields, names)]
    how = "by their names"
    for arm in _ARMS:
        sets += [
            (some, how)
            for columns in affixed_joints(fields, arm)
            for some in (columns, moving(columns))
            if len(some) == count
        ]
    families = list(families_of(fields))
    for likely in (True, False):
        for word, members in families if likely or not sets else ():
            if _is_joint_word(word) == likely:
                sets += [(some, how) for some in (members, moving(members)) if len(some) == count]
    if not sets:
        named = [members for word, members in families if _is_joint_word(word)]
        sets += [(some, how) for members in named for some in _with_further(fields, members, count)]
    if not sets:  # shoulder_pan_joint, elbow_joint, ...
        ending = tuple(f for f in fields if f.stem.rpartition("_")[2] in _JOINT_WORDS)
        sets += [(some, how) for some in (ending, moving(ending)) if len(some) == count]
    unique = {tuple(map(id, columns)): (columns, words) for columns, words in reversed(sets)}
    return list(unique.values())[::-1]


def _with_further(
    fields: Sequence[Field], members: tuple[Field, ...], count: int
) -> Iterator[tuple[Field, ...]]:
    """Numbered joints with columns of other names ahead of them or behind, as many as miss."""
    lacking = count - len(members)
    if not 1 <= lacking <= _FURTHER or len(members) < 2:
        return
    family = {id(f) for f in members}
    others = [f for f in fields if id(f) not in family and f.span > 0.0 and not f.is_time]
    for i in range(len(others) - lacking + 1):
        some = tuple(others[i : i + lacking])
        yield (*some, *members)
        yield (*members, *some)


def families_of(fields: Sequence[Field]) -> Iterator[tuple[str, tuple[Field, ...]]]:
    """Columns that differ in one number, in its order, with the word ahead of it.

    Four columns of unit length are a quaternion, whatever they are called.
    """
    families: dict[tuple[str, str], list[tuple[int, Field]]] = {}
    rotations = {id(f) for quaternion in quaternions(fields) for f in quaternion}
    for field in fields:
        match = NUMBERED.match(field.stem)
        if match and id(field) not in rotations:
            key = (match["word"], match["rest"])
            families.setdefault(key, []).append((int(match["number"]), field))
    for (word, rest), members in families.items():
        if len(members) > 1:
            yield f"{word}{rest}", tuple(f for _, f in sorted(members, key=lambda m: m[0]))


def _is_joint_word(word: str) -> bool:
    return any(part in _JOINT_WORDS for part in (word, *word.split("_"), *_ideograms(word)))


def _ideograms(word: str) -> list[str]:
    """The joint words in a word of a language without blanks, such as the axis in its counter."""
    return [] if word.isascii() else [w for w in _JOINT_WORDS if not w.isascii() and w in word]


def quaternions(fields: Sequence[Field]) -> Iterator[tuple[Field, ...]]:
    """Four columns of length 1: named with w (or 0), x, y and z, or numbered."""
    by_stem = {f.stem: f for f in fields if f.stem}
    for field in fields:
        for i, letter in enumerate(field.stem):
            names = [f"{field.stem[:i]}{a}{field.stem[i + 1 :]}" for a in f"{letter}xyz"]
            if letter in "w0" and all(n in by_stem for n in names):
                quaternion = tuple(by_stem[n] for n in names)
                if unit_norm(quaternion):
                    yield quaternion
    numbered: dict[str, list[Field]] = {}
    for field in fields:
        match = NUMBERED.match(field.stem)
        if match:
            numbered.setdefault(match["word"], []).append(field)
    for members in numbered.values():
        if len(members) == 4 and unit_norm(members):
            yield tuple(members)


def unit_norm(fields: Sequence[Field]) -> bool:
    """Whether each row of these columns is a vector of length 1."""
    lengths = np.sqrt(sum(np.square(f.values) for f in fields))
    finite_lengths = lengths[np.isfinite(lengths)]
    return bool(finite_lengths.size and np.abs(finite_lengths - 1.0).max() < UNIT_NORM)


# Joint readings computed from columns: `-J4`, `J2 + 90`, `J3 + J2`, `J1 * 0.0012`.
#
# A joint may count the other way round, from another zero, together with another joint, or in
# counts of an encoder. Numbers are in the unit of the first column.


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
