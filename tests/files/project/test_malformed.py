"""Thirty and more wrong files and requests: each says what is wrong, where, and what to do."""

from __future__ import annotations

import errno
import io
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.files.tables import raw
from loopcal.files.tables.raw import read_text
from loopcal.files.tables.readers import read_dataset

GOOD = "pose,S,x\n1,0.5,1.5\n2,0.6,1.6\n3,0.7,1.7\n"


def message_of(path, columns=None, **options) -> str:
    with pytest.raises(InputError) as caught:
        read_dataset(path, columns, **options)
    assert caught.value.exit_code == 3
    assert caught.value.place
    assert caught.value.remedy
    return str(caught.value)


WRONG_TEXTS = {
    "text in a number": (
        "pose,S,x\n1,0.5,1.5\n\n2,0.6,1.6 mm\n",
        ["row 4, column 'x'", "'1.6 mm' is not a number", "leave the cell blank"],
    ),
    "text in a number of a headerless file": (
        "1,0.5\n2,oops\n3,1\n",
        ["row 2, column '2'", "'oops' is not a number"],
    ),
    "a decimal comma among points": (
        "x;y\n1.5;1.5\n1.5;1.5\n1,5;1.5\n",
        ["row 4", "'1,5'", "decimal = ','"],
    ),
    "header or data": ("1,x\n2,3\n", ["row 1, column 2", "'x'", "header = true"]),
    "a header alone": ("pose,S,x\n", ["row 1", "a header, but no row of data"]),
    "comments alone": ("# nothing\n\n%\n", ["empty"]),
    "a short row": ("x,y,z\n1,2,3\n4,5\n", ["row 3", "2 cells, where 3 are expected", "','"]),
    "a long row": ("x,y\n1,2\n3,4,5\n", ["row 3", "3 cells, where 2 are expected"]),
    "a preamble": (
        "Exported 2024\nx,y\n1.5,2\n3,4\n5,6\n",
        ["row 1", "names 1 columns ('Exported 2024')", "rows below it have 2", "with #"],
    ),
    "a name twice": ("x,y,x\n1,2,3\n2,3,4\n", ["'x' more than once (columns 1 and 3)", "number"]),
    "an open quote": (
        'x,y\n1,2\n"3,4\n',
        ["row 3", "quoted cell does not end", "close the quotes"],
    ),
    "no numbers": ("name;town\nann;york\nbob;bath\n", ["no column of numbers"]),
    "an infinite reading": ("x,y\n1,2\n3,inf\n", ["row 3, column 'y'", "inf", "finite"]),
    "a number beyond all bounds": ("x,y\n1,2\n3,-1e999\n", ["row 3, column 'y'", "-inf"]),
    "what no sensor reads": ("x,y\n1,2\n3,-1e31\n", ["row 3, column 'y'", "-1e+31", "-1e+31"]),
    "minus as typeset": ("x,y\n1,2\n−3,4\n4,4\n", ["row 3, column 'x'", "'−3'"]),
}


@pytest.mark.parametrize(("text", "parts"), WRONG_TEXTS.values(), ids=WRONG_TEXTS)
def test_wrong_texts(tmp_path, text, parts):
    path = tmp_path / "arm.csv"
    path.write_text(text, encoding="utf-8")
    message = message_of(path)
    for part in ("arm.csv", *parts):
        assert part in message


WRONG_BYTES = {
    "an empty file": (b"", {}, ["empty"]),
    "a NUL byte": (b"x,y\n1,2\n3,\x004\n", {}, ["row 3", "NUL byte", "utf-16"]),
    "binary garbage": (bytes(range(1, 256)) * 9, {}, ["0x01", "control character"]),
    "a workbook named csv": (b"PK\x03\x04\x14\x00", {}, ["ZIP", "XLSX"]),
    "a Parquet file named csv": (b"PAR1\x15\x00", {}, ["Parquet"]),
    "not the encoding stated": ("x\n1\n# µ\n".encode("cp1252"), {"encoding": "utf-8"}, ["utf-8"]),
    "an unknown encoding": (b"x\n1\n", {"encoding": "utf-7b"}, ["'utf-7b'", "utf-8"]),
    "no encoding we know": (b"x\n1\n# \x81\n", {}, ["UTF-8, GB 18030, Shift-JIS or cp1252"]),
    "half a UTF-16 character": ("x\n1\n".encode("utf-16") + b"1", {}, ["utf-16"]),
    "the wrong delimiter": (GOOD.encode(), {"delimiter": ";"}, ["row 1", "';'", "state ','"]),
    "no delimiter": (GOOD.encode(), {"delimiter": "ab"}, ["'ab'"]),
    "no decimal mark": (GOOD.encode(), {"decimal": "!"}, ["'!'"]),
    "an unknown id": (GOOD.encode(), {"pose": "pose", "exclude": [4]}, ["no pose '4'", "1, 2, 3"]),
    "no pose left": (GOOD.encode(), {"pose": "pose", "exclude": [1, 2, 3]}, ["no pose is left"]),
    "a sheet of a text": (GOOD.encode(), {"sheet": 1}, ["sheet", "text files", "remove sheet"]),
    "a variable of a text": (GOOD.encode(), {"variable": "q"}, ["variable", "remove variable"]),
    "an unknown id column": (GOOD.encode(), {"pose": "Pose"}, ["'Pose'", "did you mean 'pose'?"]),
}


@pytest.mark.parametrize(("data", "options", "parts"), WRONG_BYTES.values(), ids=WRONG_BYTES)
def test_wrong_bytes_and_options(tmp_path, data, options, parts):
    path = tmp_path / "arm.csv"
    path.write_bytes(data)
    message = message_of(path, **options)
    for part in ("arm.csv", *parts):
        assert part in message


WRONG_COLUMNS = {
    "an unknown column": ({"q": "s"}, ["no column 's'", "'pose', 'S', 'x'"]),
    "nearly a column": ({"q": "poses"}, ["did you mean 'pose'?"]),
    "a number too high": ({"q": 4}, ["no column 4", "1 to 3"]),
    "number below zero": ({"q": -1}, ["no column -1"]),
    "one column twice": ({"q": "S", "r": 2}, ["twice", "'q' and 'r'"]),
    "a reading as sd": ({"q": "S", "r": {"column": "x", "sd_column": "S"}}, ["'S'", "'q'", "'r'"]),
    "an unknown sd column": ({"q": {"column": "x", "sd_column": "u"}}, ["no column 'u'"]),
}


@pytest.mark.parametrize(("columns", "parts"), WRONG_COLUMNS.values(), ids=WRONG_COLUMNS)
def test_wrong_columns(tmp_path, columns, parts):
    path = tmp_path / "arm.csv"
    path.write_text(GOOD)
    message = message_of(path, columns)
    for part in ("arm.csv", *parts):
        assert part in message


WRONG_REQUESTS = {
    "nothing asked for": ({}, {}, ["no column is requested"]),
    "an unknown unit": ({"q": {"column": "S", "unit": "degre"}}, {}, ["'degre'", "'deg"]),
    "an unknown sd unit": ({"q": {"column": "S", "sd_unit": "mn"}}, {}, ["'mn'"]),
    "an unknown key": ({"q": {"column": "S", "units": "m"}}, {}, ["'units'", "'unit'"]),
    "no column": ({"q": {"unit": "m"}}, {}, ["'column' is missing"]),
    "a truth value": ({"q": True}, {}, ["column: True"]),
    "a broken number": ({"q": 1.5}, {}, ["column: 1.5"]),
    "a word for a truth value": (
        {"q": {"column": "S", "check": "no"}},
        {},
        ["check: 'no'", "false"],
    ),
    "two units": ({"q": {"column": "S", "unit": "deg"}}, {"q": "rad"}, ["two units", "deg", "rad"]),
    "a unit too many": ({"q": "S"}, {"p": "rad"}, ["'p'", "'q'"]),
    "sd of another kind": (
        {"q": {"column": "S", "unit": "deg", "sd_column": "x", "sd_unit": "mm"}},
        {},
        ["sd is in mm, the readings in deg", "angle"],
    ),
}


@pytest.mark.parametrize(("columns", "units", "parts"), WRONG_REQUESTS.values(), ids=WRONG_REQUESTS)
def test_wrong_requests(tmp_path, columns, units, parts):
    path = tmp_path / "arm.csv"
    path.write_text(GOOD)
    with pytest.raises(InputError) as caught:
        read_dataset(path, columns, units=units)
    for part in parts:
        assert part in str(caught.value)


def test_a_negative_sd_names_its_row_and_column(tmp_path):
    path = tmp_path / "arm.csv"
    path.write_text("x,u\n1,0.1\n2,-0.1\n")
    message = message_of(path, {"x": {"column": "x", "sd_column": "u"}})
    assert "arm.csv, row 3, column 'u'" in message
    assert "-0.1, below zero" in message


def test_a_blank_sd_beside_a_reading_is_not_passed_over(tmp_path):
    path = tmp_path / "arm.csv"
    path.write_text("x,u\n1,0.1\n2,\n")
    assert "row 3, column 'u'" in message_of(path, {"x": {"column": "x", "sd_column": "u"}})


def test_a_missing_file_names_its_neighbour(tmp_path):
    (tmp_path / "left_arm.csv").write_text(GOOD)
    message = message_of(tmp_path / "left_arms.csv")
    assert "left_arms.csv: there is no such file" in message
    assert "did you mean 'left_arm.csv'?" in message
    assert "existing file" in message_of(tmp_path / "nowhere" / "a.csv")
    assert "no such file" in message_of(tmp_path / "a.xlsx")
    assert "no such file" in message_of(tmp_path / "a.parquet")
    assert "no such file" in message_of(tmp_path / "a.mat")


def test_a_folder_is_no_file(tmp_path):
    assert "folder" in message_of(tmp_path)
    folder = tmp_path / "a.xlsx"
    folder.mkdir()
    assert "folder" in message_of(folder)


@pytest.mark.parametrize("name", ["a.csv", "a.xlsx", "a.parquet", "a.mat"])
def test_a_file_one_may_not_read(tmp_path, monkeypatch, name):
    path = tmp_path / name
    path.write_text(GOOD)

    def refused(*_args: object, **_options: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "open", refused)
    message = message_of(path)
    assert "no permission to read this file" in message
    assert name in message


def test_other_workbooks_are_refused(tmp_path):
    assert "save it as XLSX or CSV" in message_of(tmp_path / "old.xls")


class Endless(io.RawIOBase):
    """A stream of one line without an end, which counts what is taken from it."""

    def __init__(self, head: bytes) -> None:
        self.head = head
        self.taken = 0

    def read(self, size: int = -1) -> bytes:
        assert size > 0, "the whole of it is asked for at once"
        self.taken += size
        block, self.head = self.head + b"7" * (size - len(self.head)), b""
        return block


def test_a_line_of_200_MB_is_refused_after_a_few():
    stream = Endless(b"x,y\n1,2\n")
    with pytest.raises(InputError) as caught:
        read_text(cast(BinaryIO, stream))
    assert "row 3" in str(caught.value)
    assert "longer than 1 MB" in str(caught.value)
    assert stream.taken <= 3 * raw.BLOCK


def test_a_wrong_cell_of_any_length_makes_a_short_message(tmp_path):
    path = tmp_path / "arm.csv"
    path.write_text("x,y\n1,2\n2," + "z" * 900_000 + "\n3,4\n")
    assert len(message_of(path, {"y": "y"})) < 400


def test_nothing_is_silently_read_wrong_when_a_header_is_denied(tmp_path):
    path = tmp_path / "arm.csv"
    path.write_text(GOOD)
    assert "row 1, column '3': 'x' is not a number" in message_of(path, {"q": 3}, header=False)
    assert "has no header" in message_of(path, {"q": "x"}, header=False)
    np.testing.assert_array_equal(read_dataset(path, {"q": 3})["q"], [1.5, 1.6, 1.7])
