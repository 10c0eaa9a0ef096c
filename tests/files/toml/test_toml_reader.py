"""TOML files: whatever is no such file is refused with its place, fast and within bounds."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from loopcal.errors import InputError
from loopcal.files.toml.place import Place
from loopcal.files.toml.reader import MOST_BYTES, checked_schema, read_toml, toml_data
from tests.refusals import refused


def written(folder: Path, content: bytes) -> Path:
    path = folder / "project.toml"
    path.write_bytes(content)
    return path


def test_a_file_is_read_whole(tmp_path):
    assert read_toml(written(tmp_path, b"schema = 1\n[prior]\nx = inf\n")) == {
        "schema": 1,
        "prior": {"x": float("inf")},
    }


def test_a_byte_order_mark_and_windows_line_ends_do_not_matter(tmp_path):
    assert read_toml(written(tmp_path, b"\xef\xbb\xbfschema = 1\r\na = 2\r\n")) == {
        "schema": 1,
        "a": 2,
    }


def test_standard_input_is_read(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(b"schema = 1")))
    assert read_toml("-") == {"schema": 1}


@pytest.mark.parametrize(
    ("content", "place", "words"),
    [
        (b"a = 1\nb = = 2\n", "line 2, column 5", "not valid TOML"),
        (b"a = 1\na = 2\n", "line 2", "not valid TOML"),
        (b"a = [1, 2", "end of the file", "not valid TOML"),
        (b"a = 1\n\nb = \0", "line 3", "NUL byte"),
        (b'a = 1\nb = "\xff"', "line 2", "not UTF-8"),
        (b"a = " + b"[" * 100_000, "project.toml", "nested too deeply"),
        (b"a = " + b"9" * 5_000, "project.toml", "not valid TOML"),
        (b"x" * (MOST_BYTES + 1), "project.toml", "larger than 2 MB"),
        (b"PK\x03\x04\x14\0\x06", "line 1", "NUL byte"),
    ],
)
def test_what_is_no_toml_is_refused_at_its_place(tmp_path, content, place, words):
    with pytest.raises(InputError) as caught:
        read_toml(written(tmp_path, content))
    assert "project.toml" in str(caught.value.place)
    assert place in str(caught.value.place)
    assert words in caught.value.message
    assert caught.value.remedy


def test_a_line_of_200_mb_is_not_even_read(tmp_path):
    path = tmp_path / "project.toml"
    with path.open("wb") as file:
        file.truncate(200_000_000)
    with refused("too-large", "2 MB"):
        read_toml(path)


def test_a_missing_file_names_the_nearest(tmp_path):
    (tmp_path / "project.toml").touch()
    with refused("missing-file", "did you mean 'project.toml'"):
        read_toml(tmp_path / "projet.toml")


@pytest.mark.parametrize("name", ["", "no/such/folder/p.toml", "nul\0name.toml"])
def test_what_cannot_be_opened_is_refused(tmp_path, name):
    with pytest.raises(InputError):
        read_toml(tmp_path / name)


@pytest.mark.parametrize(
    ("data", "code", "stated"),
    [
        ({}, "wrong-schema", ()),
        ({"schema": 2}, "wrong-schema", ("newer",)),
        ({"schema": 0}, "wrong-schema", ("1",)),
        ({"schema": "1"}, "wrong-schema", ("1", "'1'")),
        ({"schema": True}, "wrong-schema", ("1",)),
        ({"schema": 1.5}, "wrong-schema", ("1",)),
    ],
)
def test_another_schema_is_refused(data, code, stated):
    with refused(code, *stated):
        checked_schema(data, Place("project.toml"))


def test_messages_count_list_entries_from_one_and_quote_keys():
    place = Place("arm.toml").at("joint", 1, "before")
    assert str(place) == "arm.toml: joint[2].before"
    assert str(Place("p.toml").at("noise", "theta_*")) == 'p.toml: noise."theta_*"'


def test_text_is_read_like_a_file():
    assert toml_data("schema = 1", "standard input") == {"schema": 1}
