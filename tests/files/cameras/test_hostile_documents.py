"""YAML and JSON beyond a bound are refused before anything is made of them, and never crash."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from loopcal.errors import InputError
from loopcal.files.cameras import document
from loopcal.files.cameras.boards import read_boards
from loopcal.files.cameras.corners import read_corners
from loopcal.files.cameras.document import read_document
from loopcal.files.cameras.intrinsics import read_intrinsics
from loopcal.files.cameras.places import read_places, read_samples
from tests.files.cameras.test_intrinsics import CAMCHAIN, CAMERA_INFO, STORAGE
from tests.files.hostile.generated import damaged
from tests.refusals import refused

ALIASES = "a: &a [1, 1]\n" + "".join(f"b{i}: &b{i} [*a, *a]\n" for i in range(9))


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (ALIASES, "invalid-syntax"),
        ("a: &a\n  <<: *a\n", "invalid-syntax"),
        ("[" * 3_000, "too-large"),
        ('{"a": ' * 60 + "1" + "}" * 60, "too-large"),
        ("- " * 100 + "1", "too-large"),
        ("- 1\n" * 6_000, "too-large"),
        ("a: !!python/object/apply:os.system ['true']\n? [1]\n: 2\n", "invalid-syntax"),
        ("a: 1\na: 2\n", "invalid-syntax"),
        ("a: \x01", "invalid-syntax"),
        ("a: 'b", "invalid-syntax"),
    ],
)
def test_documents_that_are_refused(
    text: str, code: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(document, "MOST_VALUES", 5_000)
    (tmp_path / "camera.yaml").write_text(text, "utf-8")
    with refused(code, "camera.yaml") as caught:
        read_document(tmp_path / "camera.yaml")
    assert len(str(caught.value)) < 1_000


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    path.write_bytes(b"fx: \xff\xfe")
    with refused("invalid-syntax", "UTF-8"):
        read_document(path)
    path.write_bytes(b"a: 1\n" * 250_000)
    with refused("too-large", "1 MB"):
        read_document(path)
    with refused("missing-file", "none.yaml"):
        read_intrinsics(tmp_path / "none.yaml")


def test_long_numbers_are_numbers_or_refused(tmp_path: Path) -> None:
    (tmp_path / "b.yaml").write_text(
        f"type: checkerboard\ncolumns: {'9' * 10_000}\nrows: 6\nsquare: 0.03\n", "utf-8"
    )
    with refused("invalid-value", "columns"):
        read_boards(tmp_path / "b.yaml")


@pytest.mark.parametrize("content", [CAMERA_INFO, CAMCHAIN, STORAGE])
def test_damaged_files_are_read_or_refused(content: str, tmp_path: Path) -> None:
    readers = (read_intrinsics, read_boards, read_corners, read_places, read_samples)
    for i, data in enumerate(damaged(content.encode(), 12, seed=3)):
        path = tmp_path / ("c.yaml" if i % 2 else "c.json")
        path.write_bytes(data)
        for read in readers:
            if read is read_corners and path.suffix == ".yaml":
                continue
            with suppress(InputError):
                read(path)
