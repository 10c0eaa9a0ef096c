"""YAML, JSON and OpenCV's XML of others' programs as plain data, bounded, every complaint placed.

Of YAML only what calibration files use is read: mappings, lists and scalars of one document. Tags
are passed over, nothing is constructed from them, and aliases are refused: with them a file of a
kilobyte unfolds to gigabytes (docs/decisions/0137).
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, listed, short
from loopcal.files.cameras.storage_xml import is_storage, read_storage
from loopcal.files.json_files import json_bytes, whole_number
from loopcal.files.recognition.headers import heading
from loopcal.units import unit

DOCUMENTS = frozenset((".yaml", ".yml", ".json", ".xml"))
"""Endings of the files that are read here."""
MOST_BYTES, MOST_VALUES, DEEPEST = 1_000_000, 100_000, 40
"""Of YAML: bytes, values, and values within values. JSON is bounded as that of loopcal."""
_REMEDY = "name the file with the camera, board, corners or poses alone"
_TRUE, _FALSE = frozenset(("true", "1", "yes", "on")), frozenset(("false", "0", "no", "off"))
# OpenCV writes %YAML:1.0, which is no directive of YAML.
_DIRECTIVE = re.compile(r"\A\s*%YAML[: ][^\n]*")


@dataclass(frozen=True)
class Part:
    """A value in a document; place: file and keys, for messages. Scalars of YAML are texts."""

    data: Any
    place: str

    def __contains__(self, name: str) -> bool:
        return self._key(name) is not None

    def get(self, *names: str) -> Part | None:
        """The value of the first key of these that is there; `squaresX` is `squares_x` too."""
        name = next((key for n in names if (key := self._key(n)) is not None), None)
        return None if name is None else Part(self.data[name], f"{self.place}: {name}")

    def _key(self, name: str) -> str | None:
        """The key that is meant by a name: of words, however joined, of letters as they stand."""
        if not isinstance(self.data, dict):
            return None
        if name in self.data or len(name) < _WORD:
            return name if name in self.data else None
        return next((key for key in self.data if _joined(key) == _joined(name)), None)

    def part(self, *names: str) -> Part:
        """As `get`. Raises InputError where none of the keys is there."""
        part = self.get(*names)
        if part is None:
            keys = [str(key) for key in self.data] if isinstance(self.data, dict) else []
            raise InputError(
                f"{names[0]} is missing",
                code="missing-key",
                place=self.place,
                remedy=f"state it; the keys are {listed(keys, 20)}" if keys else "state it",
            )
        return part

    def items(self) -> Iterator[tuple[str, Part]]:
        """Keys and values of a mapping; of other values none."""
        for name, value in self.data.items() if isinstance(self.data, dict) else ():
            yield str(name), Part(value, f"{self.place}: {name}")

    def parts(self) -> list[Part]:
        """The values of a list. Raises InputError for anything else."""
        if not isinstance(self.data, list):
            raise self.wrong("a list")
        return [Part(value, f"{self.place}[{i}]") for i, value in enumerate(self.data)]

    @property
    def text(self) -> str:
        """A scalar as text. Raises InputError for a list or mapping."""
        if isinstance(self.data, dict | list):
            raise self.wrong("a text")
        return "" if self.data is None else str(self.data).strip()

    @property
    def number(self) -> float:
        """A finite number. Raises InputError for anything else."""
        try:
            value = math.nan if isinstance(self.data, bool) else float(self.data)
        except (TypeError, ValueError, OverflowError):
            value = math.nan
        if not math.isfinite(value):
            raise self.wrong("a finite number")
        return value

    @property
    def length(self) -> float:
        """A positive number. Raises InputError for anything else."""
        if not self.number > 0.0:
            raise self.wrong("a positive number")
        return self.number

    @property
    def count(self) -> int:
        """A whole number from 1 to a million. Raises InputError for anything else."""
        if not (1.0 <= self.number <= 1e6 and self.number == int(self.number)):
            raise self.wrong("a whole number from 1 on")
        return int(self.number)

    @property
    def flag(self) -> bool:
        """Whether it is true. Raises InputError for what is neither true nor false."""
        word = self.text.lower()
        if word not in _TRUE | _FALSE:
            raise self.wrong("true or false")
        return word in _TRUE

    def numbers(self, *counts: int) -> tuple[float, ...]:
        """Numbers of a list, of nested lists row by row, or of the `data` of a matrix.

        counts: how many there may be. Raises InputError for another number of them.
        """
        values = tuple(self._numbers())
        if counts and len(values) not in counts:
            wanted = " or ".join(map(str, counts))
            raise InputError(
                f"{len(values)} numbers are stated, where {wanted} are expected",
                code="wrong-shape",
                place=self.place,
                remedy="correct the list",
            )
        return values

    def _numbers(self) -> Iterator[float]:
        if "data" in self:
            yield from self.part("data")._numbers()
            return
        for part in self.parts():
            if isinstance(part.data, list):
                yield from part._numbers()
            else:
                yield part.number

    def wrong(self, wanted: str) -> InputError:
        """The error for a value that is not what is wanted."""
        return InputError(
            f"{short(repr(self.data))} is not {wanted}",
            code="invalid-value",
            place=self.place,
            remedy=f"state {wanted}",
        )


_WORD = 3
"""Letters of a word at least: R and r differ."""


def _joined(name: Any) -> str:
    return str(name).lower().replace("_", "").replace("-", "").replace(" ", "")


def read_document(path: str | Path, *, every: bool = False) -> Part:
    """The first document of a YAML file, or that of a JSON or XML file, by its content.

    every: whether several documents of YAML are a list, as a program that prints messages has them.

    Raises InputError for what is neither, for YAML larger than 1 MB or with more than 100,000
    values, an alias or one key twice, for JSON beyond the bounds of `json_bytes`, and for values
    deeper than 40 levels.
    """
    name = Path(path).name
    content = json_bytes(path, _REMEDY)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise _syntax(name, f"it is no text in UTF-8 at byte {error.start}") from None
    if text.lstrip()[:1] in ("{", "["):
        try:
            data = json.loads(text, parse_int=whole_number)
        except (ValueError, RecursionError):
            pass  # a flow mapping of YAML begins alike
        else:
            _check_depth(data, name)
            return Part(data, name)
    if len(content) > MOST_BYTES:
        raise _too_large(name, f"is larger than {MOST_BYTES // 1_000_000} MB")
    if is_storage(text):
        try:
            return Part(read_storage(text, MOST_VALUES, DEEPEST), name)
        except ValueError as error:
            raise _syntax(name, str(error)) from None
    documents = [one for one in _yaml(text, name, every=every) if one not in (None, "")]
    return Part(documents if len(documents) > 1 else next(iter(documents), None), name)


def _check_depth(data: Any, name: str, depth: int = 0) -> None:
    if depth > DEEPEST:
        raise _too_large(name, f"is deeper than {DEEPEST} levels")
    if isinstance(data, dict | list):
        for value in data.values() if isinstance(data, dict) else data:
            _check_depth(value, name, depth + 1)


def _yaml(text: str, name: str, *, every: bool) -> list[Any]:
    """The first document, or every one, made of the events of its parser as they come."""
    import yaml

    # What is open: lists, and mappings with the key whose value comes next.
    opened: list[list[Any] | dict[str, Any]] = [[]]
    keys: list[str | None] = [None]
    count = 0
    try:
        # Lines keep their numbers.
        for event in yaml.parse(_DIRECTIVE.sub("", text), yaml.BaseLoader):
            count += 1
            if count > MOST_VALUES or len(opened) > DEEPEST:
                raise _too_large(
                    name, f"holds more than {MOST_VALUES:,} values or {DEEPEST} levels"
                )
            place = f"{name}, line {event.start_mark.line + 1}"
            if isinstance(event, yaml.AliasEvent):
                raise _syntax(place, "an alias stands there, which is not read")
            if isinstance(event, yaml.DocumentEndEvent) and not every:
                break
            if isinstance(event, yaml.CollectionEndEvent):
                opened.pop()
                keys.pop()
            if not isinstance(event, yaml.NodeEvent):
                continue
            value: Any = getattr(event, "value", None)
            if isinstance(event, yaml.CollectionStartEvent):
                value = {} if isinstance(event, yaml.MappingStartEvent) else []
            inside, key = opened[-1], keys[-1]
            if isinstance(inside, list):
                inside.append(value)
            elif key is None:
                if not isinstance(value, str) or not value or value in inside:
                    raise _syntax(place, f"{short(repr(value))} is no key, or stands there twice")
                keys[-1] = value
            else:
                inside[key], keys[-1] = value, None
            if isinstance(event, yaml.CollectionStartEvent):
                opened.append(value)
                keys.append(None)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{name}, line {mark.line + 1}, column {mark.column + 1}" if mark else name
        why = str(getattr(error, "problem", None) or "a character that YAML does not allow")
        raise _syntax(place, why) from None
    made: list[Any] = opened[0]  # type: ignore[assignment]
    return made


def _syntax(place: str, why: str) -> InputError:
    return InputError(
        f"this is no YAML or JSON that can be read: {why}",
        code="invalid-syntax",
        place=place,
        remedy="correct the file, or name another one",
    )


def _too_large(name: str, how: str) -> InputError:
    return InputError(
        f"the file {how}",
        code="too-large",
        place=name,
        remedy=_REMEDY,
    )


# Places in files: x, y, z with a quaternion, or a matrix of 4 x 4.


def transform(part: Part) -> NDArray[np.float64]:
    """T (4, 4) [m] of a mapping with x, y, z and qx, qy, qz, qw, with translation and rotation as
    ROS or OpenCV have them, of a matrix, or of x, y, z and a rotation vector in a column, as ViSP
    has them.

    Raises InputError for a quaternion of no length and for a matrix that is no rigid motion.
    """
    from scipy.spatial.transform import Rotation

    if _is_vector(part):
        six = part.numbers(6)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_rotvec(six[3:]).as_matrix(), six[:3]
        return T
    if isinstance(part.data, list) or "data" in part:
        T = np.array(part.numbers(12, 16)).reshape(-1, 4)
        whole = np.vstack([T[:3], [0.0, 0.0, 0.0, 1.0]])
        R = whole[:3, :3]
        if np.abs(T - whole[: len(T)]).max() > 1e-6 or (
            np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0
        ):
            raise part.wrong("a matrix of rotation and translation, its last row 0, 0, 0, 1")
        # The nearest rotation: decimals of a file leave it off by their rounding.
        whole[:3, :3] = Rotation.from_matrix(R).as_matrix()
        return whole
    (moved, length), (turned, order) = _stated(part, _MOVED), _stated(part, _TURNED)
    T = np.eye(4)
    T[:3, :3] = _rotation(turned, order, bare=turned is part)
    if moved is part or {*"xyz"} <= {name for name, _ in moved.items()}:
        T[:3, 3] = [moved.part(c).number for c in "xyz"]
    else:
        T[:3, 3] = moved.numbers(3)
    T[:3, 3] *= unit(length or "m").factor
    return T


def _stated(part: Part, names: Sequence[str]) -> tuple[Part, str]:
    """The value of a key with one of these names and what the key says besides, such as `t_mm` and
    `q_wxyz`: the unit, or the order; the part and "" where there is none."""
    if (plain := part.get(*names)) is not None:
        return plain, ""
    for key, one in part.items():
        head = heading(key)
        name, _, order = head.stem.rpartition("_")
        if head.unit and head.stem in names and unit(head.unit).dimension == "length":
            return one, head.unit
        if sorted(order) == sorted("wxyz") and name in names:
            return one, order
    return part, ""


def _rotation(part: Part, order: str, *, bare: bool) -> NDArray[np.float64]:
    """R (3, 3) of a quaternion by names or in an order, x, y, z, w where none is stated, a rotation
    vector or a matrix.

    bare: whether x, y, z of the part are those of its translation.
    """
    from scipy.spatial.transform import Rotation

    if isinstance(part.data, list) or "data" in part:
        values = part.numbers(3, 4, 9)
        if len(values) == 3:
            return np.asarray(Rotation.from_rotvec(values).as_matrix())
        if len(values) == 9:
            matrix = np.vstack([np.c_[np.reshape(values, (3, 3)), np.zeros(3)], np.eye(4)[3]])
            return transform(Part([*matrix.ravel().tolist()], part.place))[:3, :3]
        q: Sequence[float] = [values[(order or "xyzw").index(c)] for c in "xyzw"]
    else:
        q = [part.part(f"q{c}", *([] if bare else [c])).number for c in "xyzw"]
    if not 1e-9 < float(np.linalg.norm(q)) < 1e9:
        raise part.wrong("a quaternion of length 1")
    return np.asarray(Rotation.from_quat(q).as_matrix())


_MOVED = ("translation", "position", "t", "tvec", "trans", "xyz")
_TURNED = ("rotation", "orientation", "quaternion", "R", "rvec", "rot", "quat", "q")


def is_transform(part: Part) -> bool:
    """Whether a part holds a place: x, y, z or a translation with a quaternion, a rotation vector
    or a matrix, a column of six, or a matrix of a rigid motion."""
    if _is_matrix(part):
        try:
            transform(part)
        except InputError:
            return False
        return True
    return (
        _is_vector(part)
        or ({"x", "y", "z"} <= {n for n, _ in part.items()} and "qw" in part)
        or all(_stated(part, names)[0] is not part for names in (_MOVED, _TURNED))
    )


def _is_matrix(part: Part) -> bool:
    """Whether it has the shape of a matrix of 3 or 4 rows of 4 numbers."""
    if "data" in part:
        size = [str(one.data) for one in map(part.get, ("rows", "cols")) if one is not None]
        return size in (["3", "4"], ["4", "4"])
    rows = part.data if isinstance(part.data, list) else []
    flat = len(rows) in (12, 16) and not any(isinstance(row, dict | list) for row in rows)
    return flat or (
        len(rows) in (3, 4)
        and all(isinstance(row, list) and len(row) == 4 for row in rows)
        and not any(isinstance(cell, dict | list) for row in rows for cell in row)
    )


def _is_vector(part: Part) -> bool:
    size = [str(one.data) for one in map(part.get, ("rows", "cols")) if one is not None]
    return "data" in part and size == ["6", "1"]
