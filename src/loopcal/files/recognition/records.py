"""Texts that are no table but repeat one form: robot programs, YAML, JSON, XML.

    DECL E6AXIS XP1={A1 10.5,A2 -90.0, ...}        CONST jointtarget p10:=[[10.5,-90.0, ...], ...];
    P[1]{ GP1: UF : 0, UT : 1, J1= 10.5 deg, ...   {"q": [0.18, -1.57, ...], "p": [1.2, 0.4, 0.9]}

Nothing is known of any language. A number, or a list of numbers, belongs to the word right before
it. What occurs equally often, once between two others of its kind, is the column of a table with a
row each time.
"""

from __future__ import annotations

import re
from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from loopcal.arrays import Array
from loopcal.files.tables.arrays import by_columns
from loopcal.files.tables.raw import Text
from loopcal.files.tables.table import Table

FEWEST = 3
"""Times that a form repeats at least."""
_MOST = 50
"""Groups that are tried as those that the others have to keep step with."""
_TOKEN = re.compile(
    r"(?P<number>(?<![\w.])(?:[-+]?(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})(?:[eE][-+]?\d{1,4})?"
    r"|nan|NaN|null)(?!\w))|(?P<word>[A-Za-z_]\w{0,80})|(?P<line>\n)|(?P<rest>[^\w\s])"
)
_NUMBERS = re.compile(r"(?<![\w.])[-+]?\.?\d")
_BELONGS = frozenset(":=[({\"'")
"""Marks that may stand between a word and its numbers; a list also has commas between these."""
_OPENING = frozenset("[({")
_BOUNDS = frozenset("[]()")
"""Marks at which a list of numbers ends or begins."""
MARKS = frozenset("={[<")
"""Marks that no table has between its numbers."""
_IN_LISTS = frozenset(",;[](){}")
_WORD = r"\s{0,9}['\"]?[A-Za-z_]\w{0,80}['\"]?\s{0,9}"
_COUNTED = re.compile(r"(?<!\w)([A-Za-z_]\w{0,60}?)(\d{1,9})(?!\w)")
"""A word that ends in a number."""
_INDEX = re.compile(r"\w\[(\d{1,9})[\]:]")
"""What follows the name of a list, as in P[1]."""
_NAMES = re.compile(rf"\[({_WORD}(?:,{_WORD}){{1,60}})\]")
"""A list of words, such as the names of joints in a message of ROS."""
_BLOCK = re.compile(r":[ \t]{0,9}((?:\n[ \t]{0,20}-[ \t][^\n:]{1,80}(?=\n|\Z))+)")
"""A list of YAML with an item per line."""
_LABEL = re.compile(
    r"(?<!\w)['\"]?(?:image|img|image_name|image_file|image_path|file|filename|file_path|frame|pose"
    r"|name|id)['\"]?[ \t]{0,9}:[ \t]{0,9}['\"]?(?P<label>[\w./\\-]{1,200})['\"]?(?=[,\n}]|\Z)"
)
"""What an item of JSON or YAML is called: a word, or the name of an image."""
_TAG = re.compile(
    r"<(?P<element>[A-Za-z]\w{0,40})(?P<rest>(?:\s{1,9}[A-Za-z][\w:]{0,40}=\"[^\"<>]{0,200}\"){2,60})"
)
"""An element of XML with its attributes: several elements may have attributes of one name."""
_ATTRIBUTE = re.compile(r"(?<=\s)([A-Za-z][\w:]{0,40})(?==)")
_PAIR = re.compile(r"['\"]([A-Za-z_]\w{0,80})['\"],\s{0,9}(?=[-+.\d])")
"""A name in quotes ahead of its number, as MATLAB states them: 'alpha', 1.57."""
_MATRIX = frozenset({(3, 3, 3), (4, 4, 4), (4, 4, 4, 4), (3, 3, 3, 3)})


@dataclass
class _Run:
    """Numbers behind one word: its name, where they begin, in brackets or not, lists of them."""

    name: str
    at: int
    enclosed: bool
    lists: list[list[float]] = field(default_factory=lambda: [[]])

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the lists."""
        return tuple(map(len, self.lists))


def are_records(lines: Iterable[str]) -> bool:
    """Whether most lines with numbers have marks that no table has."""
    numbered = [line for line in lines if len(_NUMBERS.findall(line)) > 1]
    marked = sum(any(mark in line for mark in MARKS) for line in numbered)
    return 2 * marked > len(numbered)


def has_numbers(text: Text) -> bool:
    """Whether some line has several numbers, or some lines have one each."""
    counts = [len(_NUMBERS.findall(line)) for line in text.data.decode("utf-8").split("\n")]
    return max(counts) > 1 or sum(counts) >= FEWEST


def records_table(text: Text) -> tuple[Table, str] | None:
    """A row each time that the form repeats, and what to say of it; None without such a form."""
    content = _BLOCK.sub(_in_brackets, text.data.decode("utf-8"))
    content = _told_apart(_PAIR.sub(r"\1=", content))
    labels = [match["label"].strip() for match in _LABEL.finditer(content)]
    content = _LABEL.sub(
        lambda match: " " * len(match[0]), content
    )  # digits in them are no numbers
    runs, indices = _apart_from_indices(_runs(content), content)
    groups = _groups(runs)
    if not groups:
        return None
    count = len(next(iter(groups.values())))
    words = [re.findall(r"\w+", match[1]) for match in _NAMES.finditer(content)]
    named = words[0] if len(words) == count == words.count(words[0]) else []
    arrays = {key: a for name, runs in groups.items() for key, a in _arrays(name, runs).items()}
    table = by_columns(arrays, text.file, text.sha256, count, tuple(named))
    stated = [some for some in (labels, indices) if len(some) == len({*some}) == count]
    ids = stated[0] if stated else _ids(content, groups)
    if ids and "pose" not in table.names:
        cells = {**table.columns, len(table.names): ids}
        table = replace(table, names=(*table.names, "pose"), columns=cells)
    return table, (
        f"{text.name} is no table, but repeats one form {count} times: its numbers "
        f"{', '.join(name or 'without a name' for name in groups)} are the columns."
    )


def _apart_from_indices(runs: Sequence[_Run], content: str) -> tuple[list[_Run], list[str]]:
    """The runs without the number of each item, as in P[1], where the word in front of it has
    readings as well; and these numbers."""
    at = {run.at: m[1] for run in runs if run.enclosed and (m := _INDEX.match(content, run.at - 2))}
    both = {run.name for run in runs if run.at in at} & {r.name for r in runs if r.at not in at}
    aside = {run.at: at[run.at] for run in runs if run.at in at and run.name in both}
    return [run for run in runs if run.at not in aside], [*aside.values()]


def _ids(content: str, groups: Mapping[str, Sequence[_Run]]) -> list[str]:
    """What each time is called: XP1, XP2, ..., or P[1], P[2], ...; empty where nothing counts."""
    starts = [min(run.at for run in runs) for runs in zip(*groups.values(), strict=True)]
    ahead = [content[a:b] for a, b in pairwise([0, *starts])]
    named = [dict(_COUNTED.findall(words)) for words in ahead]
    counted = [[f"{stem}{one.get(stem, '')}" for one in named] for stem in named[0]]
    for runs in groups.values():
        indices = [_INDEX.match(content, run.at - 2) for run in runs]
        counted.append([index[1] if index else "" for index in indices])
    return next((ids for ids in counted if len({*ids}) == len(ids)), [])


def _arrays(name: str, runs: Sequence[_Run]) -> dict[str, Array]:
    """(N, k) of each list, or (N, k, k) of the rows of a matrix."""
    if runs[0].shape in _MATRIX:
        return {name: np.array([run.lists for run in runs])}
    # Of several lists all but the first have a letter: numbers would be those of columns.
    names = [name, *(f"{name}_{letter}" for letter in "bcdefgh")]
    every = zip(names, range(len(runs[0].lists)), strict=False)
    return {key: np.array([run.lists[k] for run in runs]) for key, k in every}


def _runs(content: str) -> list[_Run]:
    runs: list[_Run] = []
    word, current, marks, depth = "", None, "", 0
    for match in _TOKEN.finditer(content):
        kind, token = match.lastgroup, match[0]
        if kind == "number":
            value = np.nan if token in ("nan", "NaN", "null") else float(token)
            if current is None:
                current = _Run(word, match.start(), bool(_OPENING & {*marks}))
                depth = sum(mark in _OPENING for mark in marks)
                runs.append(current)
            elif _BOUNDS & {*marks}:
                current.lists.append([])
            current.lists[-1].append(value)
            word, marks = "", ""
        elif kind == "word":
            word, current, marks = token, None, ""
        elif kind == "line":  # only what is in brackets goes on
            if current is not None and not (current.enclosed and depth > 0):
                current = None
            elif current is None and not _OPENING & {*marks}:
                word = ""
        else:
            marks += token
            depth += (token in _OPENING) - (token in "])}")
            if current is not None and token not in _IN_LISTS:
                current = None
            if current is None and token not in _BELONGS:
                word, marks = "", ""
    return runs


def _in_brackets(match: re.Match[str]) -> str:
    """A list of YAML with an item per line as one in brackets."""
    items = [item.strip() for item in re.split(r"\n[ \t]*-[ \t]", match[1])[1:]]
    return f": [{', '.join(items)}]"


def _told_apart(content: str) -> str:
    """XML in which several elements have attributes of one name: with theirs ahead of it."""
    tags = [*_TAG.finditer(content)]
    pairs = {(m["element"], name) for m in tags for name in _ATTRIBUTE.findall(m["rest"])}
    if len({name for _, name in pairs}) == len(pairs):
        return content

    def named(m: re.Match[str]) -> str:
        prefixed = _ATTRIBUTE.sub(lambda name: f"{m['element']}_{name[1]}", m["rest"])
        return f"<{m['element']}{prefixed}"

    return _TAG.sub(named, content)


def _groups(runs: Sequence[_Run]) -> dict[str, list[_Run]]:
    """By name the runs of a form that repeats: those of one number of rows, in step."""
    exact = Counter(run.name for run in runs)
    groups: dict[str, list[_Run]] = {}
    for run in runs:
        often = exact[run.name] >= FEWEST
        groups.setdefault(run.name if often else re.sub(r"\d+", "", run.name), []).append(run)
    whole = _lists_of_rows(groups)
    if whole:
        return whole
    alike = {
        name: some
        for name, some in groups.items()
        if len(some) >= FEWEST and len({run.shape for run in some}) == 1
    }
    sizes: Counter[int] = Counter()
    for some in alike.values():
        sizes[len(some)] += len(some) * sum(some[0].shape)
    if not sizes:
        return {}
    count = max(sizes, key=lambda n: (sizes[n], n))
    as_often = {name: some for name, some in alike.items() if len(some) == count}
    every = (
        {name: some for name, some in as_often.items() if _in_step(some, leading)}
        for leading in [*as_often.values()][:_MOST]
    )
    return max(every, key=lambda made: sum(sum(some[0].shape) for some in made.values()))


def _lists_of_rows(groups: Mapping[str, Sequence[_Run]]) -> dict[str, list[_Run]]:
    """Where each name stands once with a list of all its rows: a run for each row."""
    once = {name: some[0] for name, some in groups.items() if len(some) == 1 and some[0].enclosed}
    made: dict[str, list[_Run]] = {}
    for name, run in once.items():
        rows = run.lists if len(run.lists) > 1 else [[value] for value in run.lists[0]]
        if len({*map(len, rows)}) == 1 and len(rows) >= FEWEST:
            made[name] = [_Run(name, run.at, True, [row]) for row in rows]
    sizes = Counter(len(rows) for rows in made.values())
    if len(made) < len(groups) - len(made) or not sizes:
        return {}
    count = max(sizes, key=lambda n: (sizes[n], n))
    return {name: rows for name, rows in made.items() if len(rows) == count}


def _in_step(runs: Sequence[_Run], leading: Sequence[_Run]) -> bool:
    """Whether each stands between the same two of the leading ones."""
    at = [run.at for run in leading]
    behind = {bisect_left(at, run.at) - i for i, run in enumerate(runs)}
    return len(behind) == 1 and behind <= {0, 1}
