"""Tables as they are given, by their columns of numbers and the ids of their rows."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loopcal.errors import InputError, short, unknown_name
from loopcal.files.recognition.fields import (
    STATIONS,
    TIMES,
    TOOLS,
    Field,
    Source,
    column_key,
    counted,
    told_apart,
)
from loopcal.files.recognition.framed import framed_table, matrices_unfolded, turned_over
from loopcal.files.recognition.headers import (
    Heading,
    heading,
    own_words,
    readings_of,
    stem,
    words,
)
from loopcal.files.recognition.joins import in_numbers
from loopcal.files.recognition.records import FEWEST, are_records, records_table
from loopcal.files.recognition.shots import MOST_TARGETS, pooled, widened
from loopcal.files.tables import bag
from loopcal.files.tables.cells import is_missing, is_number
from loopcal.files.tables.raw import Text, read_text
from loopcal.files.tables.recording import Recording
from loopcal.files.tables.registry import TEXT, reader_of
from loopcal.files.tables.table import Table
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.days import seconds_of
from loopcal.measurements.poses import pose_id
from loopcal.measurements.tables import as_numbers, column, column_names

_IDS = frozenset(words("columns", "pose"))
_TARGETS = frozenset(words("columns", "target"))
_ANGLES = frozenset(words("columns", "azimuth") + words("columns", "elevation"))
_NUMBER_FIRST = re.compile(r"[-+]?\d")
_DIGITS = re.compile(r"\d+")
_SMALL = 100_000
"""Bytes of a file that may hold a single pose."""
_FEW = 10
"""Rows at most that a command to leave them out names."""
_NAMES = 2
"""Columns that a header between other rows names at least."""
_CLEARLY = 3
"""A sheet with so many times the numbers of any other holds the readings."""
_BEYOND = 1e6
"""A number so many times as large as all others of its column is a mark, not a reading."""
_NAMED = re.compile(r"(?P<before>(?:.*_)?)name_?(?P<number>\d{1,3})")
_NUMBER_LAST = re.compile(r"(?:.*_)?(?P<word>[a-z]+)_?(?P<number>\d{1,3})")
_WHOLE = re.compile(r"[+-]?\d+")


def sources_of(
    data: Any, number: int, sheet: str | None = None, without: Collection[str] = ()
) -> tuple[Source, ...]:
    """The tables of a file by its path, or of a Dataset, dict of arrays or DataFrame.

    number: of the first; several are sheets of a workbook that complement each other. sheet: of
    workbooks, or the variable of MATLAB files. without: ids of poses that take no part, or their
    numbers. Raises InputError for a table without a column of
    numbers, and for a workbook of which several sheets may hold the readings.
    """
    if isinstance(data, str | Path) and reader_of(data) is bag.READER:
        return (_of_recording(bag.read_bag(data, sheet), number, Path(data), sheet),)
    if isinstance(data, Recording):
        return (_of_recording(data, number),)
    if isinstance(data, str | Path):
        return _of_file(Path(data), number, sheet if reader_of(data).part else None, without)
    return (_without_poses(_in_memory(data, number), without),)


def sources_of_all(
    entries: Sequence[Any], sheet: str | None = None, without: Collection[str] = ()
) -> list[Source]:
    """The tables of several entries; files that hold one pose each are the rows of one table."""
    if texts := _alike(entries):
        content = b"\n".join(text.data for text in texts)
        made = records_table(Text(texts[0].file, content, texts[0].sha256))
        if made is not None and len(made[0].rows) == len(texts):
            one = _of_table(Path(entries[0]), *made, 0, None)
            ids = tuple(Path(entry).stem for entry in entries)
            remark = f"{ids[0]} to {ids[-1]}: {len(ids)} files with one pose each."
            return [_without_poses(replace(one, ids=ids, pose="pose", remark=remark), without)]
    sources: list[Source] = []
    for entry in entries:
        sources += sources_of(entry, len(sources), sheet, without)
    return sources


def _alike(entries: Sequence[Any]) -> list[Text]:
    """The texts of small files whose names differ by numbers alone, and that are no tables."""
    paths = [Path(entry) for entry in entries if isinstance(entry, str | Path)]
    patterns = {_DIGITS.sub("#", path.name) for path in paths}
    if len(paths) < max(len(entries), FEWEST) or len(patterns) > 1 or "#" not in patterns.pop():
        return []
    if any(reader_of(p) is not TEXT or not p.is_file() or p.stat().st_size > _SMALL for p in paths):
        return []
    texts = [read_text(path) for path in paths]
    return texts if all(are_records(t.data.decode().split("\n")) for t in texts) else []


def refuse_unknown(names: Collection[str], sources: Sequence[Source]) -> None:
    """Raise InputError for a pose to leave out that none of the tables had."""
    gone = {name for source in sources for name in source.left_out}
    left = [ids for source in sources for ids in _names(source.ids, len(source))]
    for name in names:
        if name not in gone:
            raise unknown_name(f"{name!r} is no pose", name, left, "--exclude")


def _names(ids: Sequence[str] | None, count: int) -> Sequence[str]:
    return ids or [str(i + 1) for i in range(count)]


def _without_poses(source: Source, names: Collection[str]) -> Source:
    every = _names(source.ids, len(source))
    rows = np.array([name not in names for name in every])
    if rows.all():
        return source
    fields = tuple(replace(f, values=f.values[rows]) for f in source.fields)
    kept = tuple(name for name in every if name not in names)
    gone = tuple(name for name in every if name in names)
    return replace(source, fields=fields, ids=source.ids and kept, left_out=gone)


def _in_memory(data: Any, number: int) -> Source:
    if isinstance(data, Dataset):
        fields = [
            Field(number, i, Heading(q, stem(q), data.units.get(q)), values)
            for i, (q, values) in enumerate(data.readings.items())
        ]
        for quantity, sds in data.sds.items():
            header = Heading(f"{quantity} sd", f"{stem(quantity)}_sd", data.units.get(quantity))
            fields.append(Field(number, len(fields), header, sds))
        return _checked(Source(None, None, tuple(fields), data.poses, "pose"))
    if isinstance(data, list | np.ndarray):
        return _checked(Source(None, None, tuple(_unnamed(data, number, 0)), None, None))
    fields, ids, pose, texts = list[Field](), None, None, dict[str, tuple[str, ...]]()
    for i, name in enumerate(column_names(data)):
        values = column(data, name)
        if np.ndim(values) > 1:  # several columns under one name
            fields += _unnamed(values, number, 100 * i)
            continue
        header = heading(name)
        if header.stem in _IDS:
            pose_ids = tuple(map(pose_id, np.asarray(values).tolist()))
            if ids is None or len(set(ids)) < len(set(pose_ids)):
                ids, pose = pose_ids, name
                continue
        try:
            fields.append(Field(number, i, header, as_numbers(values, name)))
        except InputError:  # text, dates: no readings
            labels = tuple(map(str, np.asarray(values).tolist()))
            if header.stem in STATIONS | TOOLS:
                fields.append(counted(Field(number, i, header, np.empty(0)), labels))
            else:
                texts[header.stem] = labels
    return _with_ids(Source(None, None, tuple(fields), ids, pose), texts)


def _unnamed(data: Any, number: int, first: int) -> list[Field]:
    """The columns of an array (N, k); of matrices (N, 3, 3) row by row."""
    rows = np.asarray(data)
    return [
        Field(number, first + i, None, as_numbers(column, f"column {i + 1}"))
        for i, column in enumerate(rows.reshape(len(rows), -1).T)
    ]


def _of_recording(
    recording: Recording, number: int, path: Path | None = None, topic: str | None = None
) -> Source:
    """The poses at rest of a bag, or of what `read_bag` made of it."""
    remark = " ".join(recording.words())
    label = "" if path is None else path.name
    return replace(
        _in_memory(recording, number),
        path=path,
        sheet=topic,
        names=recording.columns,
        label=label,
        remark=f"{label}: {remark}",
        recording=recording,
    )


def _of_file(
    path: Path, number: int, sheet: str | None, without: Collection[str] = ()
) -> tuple[Source, ...]:
    if sheet is not None or reader_of(path).part != "sheet":
        table, title = _framed(path, sheet)
        return (_of_table(path, table, title, number, sheet, without),)
    sheets = _sheets(path)
    which = ", ".join(f"{short(str(one.sheet))!r} ({len(one.rows)} rows)" for one, _ in sheets[:10])
    candidates = [_of_table(path, *one, number, None, without) for one in sheets]
    taken, left = [candidates[0]], list[int]()
    for i, one in enumerate(candidates[1:], 1):
        if _complements(one, taken):
            taken.append(_of_table(path, *sheets[i], number + len(taken), None, without))
        else:
            left.append(i)
    if left and _numbers(sheets[0][0]) < _CLEARLY * _numbers(sheets[left[0]][0]):
        raise InputError(
            f"several sheets may hold the readings: {which}",
            code="missing-key",
            place=path.name,
            remedy=f"name one: --sheet {sheets[0][0].sheet!r}",
        ).offering("--sheet", str(sheets[0][0].sheet))
    if len(sheets) > 1:
        read = "the first is read" if len(taken) == 1 else f"{len(taken)} are joined"
        remark = f"{path.name} has several sheets: {which}; {read}. {taken[0].remark}".strip()
        taken[0] = replace(taken[0], remark=remark)
    return tuple(taken)


def _framed(path: Path, part: str | int | None) -> tuple[Table, str]:
    """The table of a file with a row per pose, and what to say of the rows around it."""
    table, title = framed_table(path, part, _NAMES)
    table, unfolded = matrices_unfolded(table)
    table, turned = (table, unfolded) if unfolded else turned_over(table)
    return table, f"{title} {turned}".strip()


def _complements(sheet: Source, taken: Sequence[Source]) -> bool:
    """Whether a sheet has other columns of the same poses: the same ids, or as many rows."""
    stems = {f.stem for f in sheet.fields}
    if "" in stems or any(f.stem in stems | {""} for one in taken for f in one.fields):
        return False
    first = taken[0]
    if first.ids is not None and sheet.ids is not None:
        # More than half: a sheet of another run may share some numbers of poses.
        shared = 2 * len({*first.ids} & {*sheet.ids}) > min(len(first), len(sheet))
        return shared or in_numbers([first, sheet]) is not None
    return len(first) == len(sheet)


def _of_table(
    path: Path,
    table: Table,
    remark: str,
    number: int,
    sheet: str | None,
    without: Collection[str] = (),
) -> Source:
    titled = bool(remark)
    numeric, ids_of = table.numeric(), cache(table.ids)
    names = [table.names[i] if i < len(table.names) else "" for i in range(_width(table))]
    spoken = own_words(path.parent)
    headings = [heading(name, spoken) if name else None for name in names]
    lists = {
        i: columns
        for i in table.columns
        if i not in numeric and (columns := listed_columns(headings[i], ids_of(i)))
    }
    pose = _pose_column(table, ids_of, headings, [*numeric, *lists])
    texts = [i for i in table.columns if i not in (*numeric, *lists, pose)]
    cells = {i: ids_of(i) for i in (pose, *texts) if i is not None}
    beginning = [ids_of(i) for i in sorted(table.columns)[:1]]
    count = len(table.rows)
    every = readings_of([*cells.values(), *beginning], count)
    if len(every) < count:
        rows = count - len(every)
        last = "The last row" if rows == 1 else f"The last {rows} rows"
        summary = f"{last} of {table.name}: a summary of the others, left out."
        remark = f"{remark} {summary}".strip()
    row_names = _names(None if pose is None else cells[pose], count)
    left_out = tuple(row_names[k] for k in every if row_names[k] in without)
    if left_out:
        every = every[[row_names[k] not in without for k in every]]
        remark = f"{remark} Left out of {table.name}: {', '.join(left_out)}.".strip()
    labels = {i: tuple(column_cells[k] for k in every) for i, column_cells in cells.items()}
    try:
        values = {i: table.numbers(i, every) for i in numeric if i != pose}
    except InputError as error:
        bad = [row_names[k] for k in _no_numbers_in(table, numeric, every)]
        raise error.offering("--exclude", ",".join(bad)) if bad else error from None
    values, blanks = _without_blanks(values, names)
    remark = f"{remark} {blanks}".strip()
    values |= {i: np.empty(0) for i in texts if _stem(headings, i) in STATIONS | TOOLS}
    values |= {
        i: np.array(seconds)
        for i in texts
        if _stem(headings, i) in TIMES and (seconds := seconds_of(labels[i])) is not None
    }
    fields = tuple(
        Field(number, i, headings[i] if i < len(headings) else None, values[i])
        for i in sorted(values)
    )
    fields = tuple(
        counted(f, labels[f.position]) if f.position in texts and not f.is_time else f
        for f in fields
    )
    split = [one for columns in lists.values() for one in columns]
    fields += tuple(
        Field(number, k, header, numbers[every])
        for k, (header, numbers) in enumerate(split, _width(table))
    )
    fields = _distinct(_named_by_texts(fields, headings, {i: labels[i] for i in texts}))
    ids = None if pose is None else labels[pose]
    sheet = table.sheet or sheet
    named = None if pose is None else column_key(names, pose)
    # what is not one table below its header is written into a file of its own
    header = tuple(names)
    place = None if len(every) < count or titled or lists or blanks else path
    # By names that differ in all rows other tables may be joined.
    differing = [i for i in texts if len({*labels[i]} - {""}) == len(every)]
    used = {f.position for f in fields} | {*differing}
    idle = [names[i] for i in texts if i not in used and _stem(headings, i) not in _TARGETS]
    if idle := [name for name in idle if name and not _NAMED.fullmatch(stem(name))]:
        remark = (
            f"{remark} Columns of text in {table.name} take no part: {', '.join(idle)}.".strip()
        )
    for i in texts:
        cell = next(filter(None, labels[i]), "")
        if i not in used and _stem(headings, i) in _ANGLES and _NUMBER_FIRST.match(cell):
            raise InputError(
                f"{short(cell)!r} is not a number",
                code="invalid-number",
                place=table.place(labels[i].index(cell), i),
                remedy="write the angle as a decimal number with its unit in the header, or as "
                "12°30'45\"; if it is no reading, give the column another name",
            )
    source = Source(place, sheet, fields, ids, named, header, path.name, remark, left_out=left_out)
    source = replace(source, texts={names[i]: labels[i] for i in differing})
    return _with_ids(source, {_stem(headings, i): labels[i] for i in texts if i not in values})


def _no_numbers_in(
    table: Table, columns: Sequence[int], rows: Sequence[int] | NDArray[np.intp]
) -> list[int]:
    """Rows with a cell that is neither a number nor missing; none where there are many."""
    bad = [
        int(k)
        for k in rows
        if any(
            not is_number(c, table.decimal) and not is_missing(c)
            for i in columns
            for c in [table.columns[i][int(k)]]
        )
    ]
    return bad if len(bad) <= _FEW else []


def _without_blanks(
    columns: Mapping[int, NDArray[np.float64]], names: Sequence[str]
) -> tuple[dict[int, NDArray[np.float64]], str]:
    """Columns without the number that stands for "not measured", and what to say of it."""
    made, said = {**columns}, dict[float, list[str]]()
    for i, values in columns.items():
        size = np.abs(np.nan_to_num(values))
        others = size[size < size.max(initial=0.0)]
        if others.size and size.max() / _BEYOND > others.max() > 0.0:
            blank = size == size.max()
            made[i] = np.where(blank, np.nan, values)
            said.setdefault(float(values[blank][0]), []).append(names[i] or f"column {i + 1}")
    words = [
        f"{number:g} in {', '.join(where)} is no reading: it counts as not measured."
        for number, where in said.items()
    ]
    return made, " ".join(words)


def _distinct(fields: Sequence[Field]) -> tuple[Field, ...]:
    """With a letter behind the name of a column that an earlier one has too, as X beside x."""
    made, met = list[Field](), dict[str, int]()
    for f in fields:
        met[f.stem] = met.get(f.stem, 0) + 1
        if f.heading and f.stem and met[f.stem] > 1:
            text = f"{f.label} (column {f.position + 1})"
            f = replace(
                f, heading=replace(f.heading, text=text, stem=told_apart(f.stem, met[f.stem]))
            )
        made.append(f)
    return tuple(made)


def _named_by_texts(
    fields: tuple[Field, ...],
    headings: Sequence[Heading | None],
    texts: Mapping[int, tuple[str, ...]],
) -> tuple[Field, ...]:
    """Numbered columns with the names that columns of text give them: where `name0` says "elbow" in
    every row, `position0` is the position of the elbow."""
    names = {}
    for i, cells in texts.items():
        match = _NAMED.fullmatch(_stem(headings, i))
        if match and len(set(cells)) == 1 and cells[0]:
            names[match["before"], match["number"]] = stem(cells[0])
    renamed = []
    for f in fields:
        match = _NUMBER_LAST.fullmatch(f.stem)
        said = match and next(
            (n for (b, k), n in names.items() if k == match["number"] and f.stem.startswith(b)),
            None,
        )
        if f.heading and match and said:
            f = replace(f, heading=replace(f.heading, stem=f"{said}_{match['word']}"))
        renamed.append(f)
    return tuple(renamed)


def _sheets(path: Path) -> list[tuple[Table, str]]:
    """The sheets of a workbook that hold a table of numbers, that with the most numbers first.

    Beside each is what to say of titles above its header.
    """
    tables: list[tuple[Table, str]] = []
    first: InputError | None = None
    for number in count(1):
        try:
            table, title = _framed(path, number)
        except InputError as error:
            # there is no sheet of this number, or the fault is that of the file, not of a sheet
            if error.code == "unknown-name" or (first and str(error) == str(first)):
                break
            first = first or error
            continue
        if len(table.numeric()) > 1 and len(table.rows) > 1:
            tables.append((table, title))
    if not tables:
        raise first or _no_numbers(path.name)
    return sorted(tables, key=lambda entry: _numbers(entry[0]), reverse=True)


def _numbers(table: Table) -> int:
    return len(table.rows) * len(table.numeric())


def _with_ids(source: Source, texts: Mapping[str, tuple[str, ...]]) -> Source:
    """With ids that occur once: a row per target, or per station, becomes a row per pose, several
    shots of one become one; other repeated ids are no ids. texts: columns of text by name.

    Raises InputError for several targets without ids of poses.
    """
    checked = _checked(source)
    ids = checked.ids
    numbers = {
        f.stem: tuple(map(f.words, f.values))
        for f in checked.fields
        if f.stem in _TARGETS | STATIONS
    }
    labels = {**texts, **numbers}
    targets = [w for w in labels if w in _TARGETS and 1 < len({*labels[w]}) <= MOST_TARGETS]
    if ids is None and targets:
        raise InputError(
            f"the column {targets[0]!r} names several targets, and no column says which rows are "
            "of one pose",
            code="missing-column",
            place=checked.name,
            remedy='add a column "pose" with the same id in all rows of a pose',
        )
    if ids is None or len(set(ids)) == len(ids):
        return checked
    for word in sorted(labels, key=lambda w: (w not in _TARGETS, w in STATIONS)):
        rest = tuple(f for f in checked.fields if f.stem != word or word not in numbers)
        shots = pooled(rest, list(zip(ids, labels[word], strict=True)))
        wide = shots and widened(shots.fields, *zip(*shots.keys, strict=True))
        if shots and wide:
            return _rewritten(checked, wide, [pose for pose, _ in shots.keys], shots.remark)
    shots = pooled(checked.fields, ids)
    if shots:
        return _rewritten(checked, shots.fields, shots.keys, shots.remark)
    return replace(checked, ids=None, pose=None)


def _rewritten(
    source: Source, fields: tuple[Field, ...], ids: Sequence[str], remark: str
) -> Source:
    """A table with a row per pose, which is no longer that of its file."""
    remarks = f"{source.remark} {remark}".strip()
    poses = tuple(dict.fromkeys(ids))
    return Source(None, None, fields, poses, "pose", label=source.name, remark=remarks)


def _width(table: Table) -> int:
    return max(len(table.names), 1 + max(table.columns, default=-1))


def _pose_column(
    table: Table,
    ids_of: Callable[[int], tuple[str, ...]],
    headings: Sequence[Heading | None],
    numeric: Sequence[int],
) -> int | None:
    """The column of ids: by its name, a count that begins a table without a header, or the first
    column of texts that differ in all rows."""
    repeated: dict[int, int] = {}
    for i in table.columns:
        if _stem(headings, i) not in _IDS or not len(table.rows):
            continue
        ids = ids_of(i)
        kinds = len(set(ids))
        if i in numeric and not all(map(_WHOLE.fullmatch, ids)):
            continue
        if kinds == len(ids):
            return i
        if i not in numeric or kinds > 1:
            repeated[i] = kinds
    if repeated:  # of poses and reflectors in rows of their own, poses are the more
        return max(repeated, key=lambda i: repeated[i])
    for i in table.columns:
        if i in numeric or _stem(headings, i) in TIMES | STATIONS | TOOLS | _TARGETS:
            continue
        ids = ids_of(i)
        # Points ahead of their numbers without a header: a few may be measured twice.
        kinds = 2 * len(set(ids)) if i == 0 and not table.names else len(set(ids))
        if len(ids) > 2 and all(ids) and kinds >= len(ids) and seconds_of(ids) is None:
            return i
    if not table.names and numeric and numeric[0] == 0:
        first = table.numbers(0, np.arange(len(table.rows)))
        steps = np.diff(first)
        if first.size > 3 and (steps == 1.0).all() and (first == np.round(first)).all():
            return 0
    return None


def _stem(headings: Sequence[Heading | None], i: int) -> str:
    header = headings[i] if i < len(headings) else None
    return header.stem if header else ""


def _checked(source: Source) -> Source:
    if not source.fields:
        raise _no_numbers(source.name)
    return source


def _no_numbers(name: str) -> InputError:
    return InputError(
        "there is no column of numbers",
        code="missing-column",
        place=name,
        remedy="give a table with a row per pose and a column per reading",
    )


_BRACKETS = re.compile(r"[\[({].*[\])}]", re.DOTALL)
_ITEM = re.compile(
    r"(?:(?P<name>\b[A-Za-z_]\w{0,40})['\"]?[\s:=]{1,9})?"
    r"(?P<number>[-+]?(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})(?:[eE][-+]?\d{1,4})?)"
)

Column = tuple[Heading, NDArray[np.float64]]


def listed_columns(header: Heading | None, cells: Sequence[str]) -> list[Column]:
    """A column for each number of the cells; none where they are no lists of one length.

    They are lists of Python and NumPy, messages of ROS, structures of KRL: each cell in brackets,
    with as many numbers under the same names, such as `[0.1, 0.2]` or `{A1 10.0, A2 20.0}`.
    """
    if not cells or not all(_BRACKETS.fullmatch(cell.strip()) for cell in cells):
        return []
    rows = [[(m["name"] or "", m["number"]) for m in _ITEM.finditer(cell)] for cell in cells]
    names = [name for name, _ in rows[0]]
    if len(names) < 2 or any([name for name, _ in row] != names for row in rows):
        return []
    if not any(names):
        names = [*"xyz"] if len(names) == 3 else [str(k + 1) for k in range(len(names))]
    if len({*names}) < len(names):
        return []
    base = header or Heading("", "")
    values = np.array([[float(number) for _, number in row] for row in rows])
    headings = [
        replace(base, text=f"{base.text} {n}".strip(), stem=f"{base.stem}_{stem(n)}".strip("_"))
        for n in names
    ]
    return list(zip(headings, values.T, strict=True))
