"""The files behind a record, the seal of its page, and the check of both.

A page, or the XML of a certificate, names its inputs with their SHA-256 in a block of JSON. Its own
SHA-256 stands in it too: it is that of the page with 64 zeros in the place of the hash. Whoever
alters a page can seal it anew; a signature protects from that, the hash from mistakes.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from loopcal.document.result_document import ResultDocument
from loopcal.errors import InputError
from loopcal.files.outputs import expanded, relative
from loopcal.files.tables.raw import bytes_of, sha256_of
from loopcal.files.toml.place import Place

OPEN = "0" * 64
"""In the place of the hash of a page while that is computed."""
MOST_BYTES = 20_000_000
_SEAL = re.compile(
    r'(?:<meta name="loopcal-record" content|<record xmlns="urn:loopcal:record" sha256)'
    r'="([0-9a-f]{64})">'
)
_MANIFEST = re.compile(
    r'<(script) type="application/json" id="manifest">'
    r'|<(record) xmlns="urn:loopcal:record" sha256="[0-9a-f]{64}">'
)
_OF_RESULT = {
    "result.json": "result",
    "mechanism.toml": "calibrated machine",
    "residuals.csv": "residuals of every pose",
}


@dataclass(frozen=True)
class RecordFile:
    """A file behind a record. path: from the folder of the page, None where it was not found."""

    role: str
    name: str
    path: str | None
    sha256: str


@dataclass(frozen=True)
class RecordCheck:
    """Whether a record and the files behind it are as they were when it was written.

    page: whether the page is unaltered; files: name -> "unaltered", "altered", "not found", or
    "not recorded" for one that was not found when the record was written.
    """

    path: Path
    page: bool
    files: Mapping[str, str]

    @property
    def unaltered(self) -> bool:
        """Whether the page and all files are as they were."""
        return self.page and not {"altered", "not found"}.intersection(self.files.values())

    def document(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {"unaltered": self.unaltered, "page": self.page, "files": dict(self.files)}

    def __str__(self) -> str:
        states = {self.path.name: "unaltered" if self.page else "altered", **self.files}
        wide = max(map(len, states))
        return "\n".join(f"{name:<{wide}}  {state}" for name, state in states.items())


def record_files(
    result: Path, document: ResultDocument, page: Path, project: Path | None
) -> tuple[RecordFile, ...]:
    """The files behind a record of the result.json at a path, paths from the folder of the page.

    project: the project file, None if unknown; readings are sought beside it, else beside the
    folder of the result. Raises InputError for readings that changed since the calibration.
    """
    to = page.absolute().parent
    files = [
        RecordFile(role, name, relative(result.absolute().with_name(name), to), sha256_of(path))
        for name, role in _OF_RESULT.items()
        if (path := result.with_name(name)).is_file()
    ]
    near = [result.absolute().parent.parent, result.absolute().parent]
    if project is not None:
        near.insert(0, project.absolute().parent)
        files.append(
            RecordFile(
                "project", project.name, relative(project.absolute(), to), sha256_of(project)
            )
        )
    data = document.data
    for name, digest in ((data.file, data.sha256), *((j.file, j.sha256) for j in data.joined)):
        if name is None or digest is None:
            continue
        at = _readings(name, digest, document.inputs.get("data"), near)
        files.append(RecordFile("readings", name, None if at is None else relative(at, to), digest))
    return tuple(files)


def _readings(name: str, digest: str, stated: Any, near: Sequence[Path]) -> Path | None:
    """Where readings lie: by the paths that the project states, from some folders."""
    paths = [*(path for path in _texts(stated) if Path(path).name == name), name]
    others: list[Path] = []
    for folder in near:
        for path in paths:
            try:
                at = expanded(path, folder, Place(name))
            except InputError:  # a variable that is not set here
                continue
            if at.is_file():
                if sha256_of(at) == digest:
                    return at
                others.append(at)
    if others:
        raise InputError(
            "these readings are not those of the calibration: their SHA-256 differs",
            code="version-mismatch",
            place=str(others[0]),
            remedy="calibrate again, or restore the readings",
        )
    return None


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _texts(inner)


def manifest(files: Sequence[RecordFile]) -> str:
    """The files as JSON for a script element, which nothing in it can end."""
    text = json.dumps([vars(file) for file in files], ensure_ascii=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def sealed(page: str) -> str:
    """The page with its SHA-256 wherever `OPEN` stands."""
    return page.replace(OPEN, sha256(page.encode("utf-8")).hexdigest())


def check_record(path: str | Path) -> RecordCheck:
    """Check a page or XML that `loopcal record` wrote, and the files that it names.

    path: a file, or the folder of a result with its record.html. Raises InputError for a file that
    is no such page.
    """
    path = Path(path)
    path = path / "record.html" if path.is_dir() else path
    content = bytes_of(path, MOST_BYTES)
    text = content[: MOST_BYTES + 1].decode("utf-8", "replace")
    seal, files = _SEAL.search(text), _MANIFEST.search(text)
    try:
        end = -1 if files is None else text.find(f"</{files[1] or files[2]}>", files.end())
        entries = None
        if files is not None and end >= 0:
            entries = [RecordFile(**entry) for entry in json.loads(text[files.end() : end])]
    except (ValueError, TypeError, RecursionError):
        entries = None
    if seal is None or entries is None:
        raise InputError(
            "this is no record that loopcal wrote, or its list of files is damaged",
            code="wrong-file-type",
            place=str(path),
            remedy="name a record.html or record.xml of `loopcal record`",
        )
    opened = content.replace(seal[1].encode(), OPEN.encode())
    states = {_label(e, entries): _state(e, path.absolute().parent) for e in entries}
    return RecordCheck(path, sha256(opened).hexdigest() == seal[1], states)


def _label(entry: RecordFile, entries: Sequence[RecordFile]) -> str:
    twice = sum(e.name == entry.name for e in entries) > 1
    return str(entry.path or entry.name) if twice else str(entry.name)


def _state(entry: RecordFile, folder: Path) -> str:
    if entry.path is None:
        return "not recorded"
    path = folder / str(entry.path)
    if not path.is_file():
        return "not found"
    return "unaltered" if sha256_of(path) == entry.sha256 else "altered"
