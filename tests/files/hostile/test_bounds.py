"""Every reader checks a bound first, or runs where its time and memory are limited."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from analyses.hostile_inputs import doubling_schema
from loopcal.companions.record.xml_schema import check_against
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.registry import read_program
from loopcal.errors import InputError, LoopcalError
from loopcal.files import guarded as module
from loopcal.files.guarded import Stopped, guarded
from loopcal.files.json_files import read_json
from loopcal.files.machines import safe_xml, urdf
from loopcal.files.machines.python_function import load_function
from loopcal.files.machines.urdf import branches
from loopcal.files.recognition.framed import framed_table
from loopcal.files.tables import raw
from loopcal.files.tables.readers import read_dataset
from loopcal.files.toml import reader
from loopcal.files.toml.reader import read_toml
from tests.refusals import refused

READING = "tests.files.hostile.reading"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes here")
@pytest.mark.parametrize("name", ["a.xlsx", "a.parquet", "a.mat", "a.py", "stream/b.pq", "a.csv"])
def test_a_pipe_in_place_of_a_file_holds_no_reader_up(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(raw, "PATIENCE", 0.05)
    (tmp_path / name).parent.mkdir(exist_ok=True)
    os.mkfifo(tmp_path / name)
    path = tmp_path / "stream" if name.startswith("stream") else tmp_path / name
    with pytest.raises(InputError, match="pipe"):
        load_function(f"{path}:loops") if name.endswith(".py") else read_dataset(path)


@pytest.mark.parametrize("node", ["missing.csv", "/dev/zero", "a folder", "a loop"])
def test_titles_are_sought_in_files_alone(node: str, tmp_path: Path) -> None:
    path = tmp_path / node
    if node == "a folder":
        path.mkdir()
    if node == "a loop":
        path.symlink_to(path)
    with pytest.raises(InputError):
        framed_table(path, None, 4)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("a" + ".a" * 30_000 + " = 1", "too-large"),
        ("[x" + '."b c"' * 500 + "]", "too-large"),
        ("x = { a" + " . 'a'" * 200 + " = 1 }", "too-large"),
        ("schema = 0x" + "f" * 5_000, "too-large"),
        ("x = [1, [2, {y = -9223372036854775809}]]", "too-large"),
        ("x = [" + "{}," * 6_000 + "]", "too-large"),
        (f"{'k' * 300} = 1", "too-large"),
        (f'x = "{"t" * 20_000}"', "too-large"),
        ("x = " + "9" * 5_000, "invalid-syntax"),
    ],
)
def test_toml_beyond_a_bound_is_refused_before_anything_is_made_of_it(
    text: str, code: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader, "MOST_VALUES", 5_000)
    (tmp_path / "p.toml").write_text(text, "utf-8")
    with refused(code, "p.toml") as caught:
        read_toml(tmp_path / "p.toml")
    assert len(str(caught.value)) < 3_000


def test_toml_within_the_bounds_is_read_as_it_stands(tmp_path: Path) -> None:
    text = 'a.b.c.d = [1.5, {e = "1.2.3.4.5.6.7.8.9.10.11.12.13"}]\nf = 9223372036854775807'
    (tmp_path / "p.toml").write_text(text, "utf-8")
    found = read_toml(tmp_path / "p.toml")
    assert found["a"]["b"]["c"]["d"][0] == 1.5
    assert found["f"] == 2**63 - 1


@pytest.mark.parametrize(
    "content", ['{"schema": 1, "x": [' + "[]," * 600_000 + "[]]}", '{"a":' * 600_000]
)
def test_json_of_more_lists_than_any_result_has_is_refused(content: str, tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text(content, "utf-8")
    with refused("too-large", "r.json"):
        read_json(tmp_path / "r.json", "result.json", 1)


def test_xml_of_more_elements_than_a_robot_has_is_refused_in_any_encoding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(safe_xml, "MOST_ELEMENTS", 3_000)
    text = '<?xml version="1.0" encoding="ENC"?><robot>' + "<a/>" * 3_000 + "</robot>"
    for encoding in ("utf-8", "utf-16"):
        path = tmp_path / f"{encoding}.urdf"
        path.write_bytes(text.replace("ENC", encoding).encode(encoding))
        with refused("too-large", "3,000 elements"):
            branches(path)


def links_looked_up(count: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """How often the link of a joint is looked up to list the chains of so many links."""
    links = "".join(f'<link name="l{i}"/><link name="alone{i}"/>' for i in range(count))
    joints = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="l{i // 2}"/><child link="l{i}"/></joint>'
        for i in range(1, count)
    )
    (tmp_path / "r.urdf").write_text(f"<robot>{links}{joints}</robot>", "utf-8")
    seen: list[str] = []
    own = urdf.UrdfRobot.link

    def counted(robot: Any, element: Any, tag: str) -> str:
        seen.append(tag)
        return own(robot, element, tag)

    with monkeypatch.context() as patch:
        patch.setattr(urdf.UrdfRobot, "link", counted)
        branches(tmp_path / "r.urdf")
    return len(seen)


def test_the_chains_of_a_robot_are_listed_in_proportion_to_its_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    few, many = (links_looked_up(count, tmp_path, monkeypatch) for count in (40, 80))
    assert many < 2.6 * few


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (lambda: {"pose": pl.repeat("x" * 30_000, 3_000, eager=True)}, "unfolds"),
        (lambda: {f"c{i}": pl.zeros(3_000_000, eager=True) for i in range(8)}, "than it can hold"),
        (lambda: {"pose": ["x" * 600] * 20}, "characters"),
        (lambda: {"x" * 600: [1.0] * 20, "pose": ["a"] * 20}, "characters"),
    ],
)
def test_parquet_unfolds_no_further_than_its_bytes_allow(
    frame: Callable[[], dict[str, Any]], words: str, tmp_path: Path
) -> None:
    columns = frame()
    count = len(next(iter(columns.values())))
    own = {"q": pl.zeros(count, eager=True), **columns}
    pl.DataFrame(own).write_parquet(tmp_path / "a.parquet")
    with pytest.raises(InputError, match=words) as caught:
        read_dataset(tmp_path / "a.parquet", pose="pose" if "pose" in own else None)
    assert len(str(caught.value)) < 2_000


def test_parquet_of_equal_readings_is_read(tmp_path: Path) -> None:
    own = {"pose": [f"p{i}" for i in range(50_000)], "q": pl.zeros(50_000, eager=True)}
    pl.DataFrame(own).write_parquet(tmp_path / "a.parquet")
    assert len(read_dataset(tmp_path / "a.parquet", {"q": "q"}, pose="pose")) == 50_000


@pytest.mark.skipif(sys.platform != "linux", reason="memory is limited on Linux")
def test_a_schema_that_unfolds_without_measure_is_no_schema(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MEMORY", 60_000_000)
    monkeypatch.setattr(module, "SECONDS", 0.1)
    (tmp_path / "s.xsd").write_text(doubling_schema("a"), "utf-8")
    with refused("wrong-file-type", "s.xsd"):
        check_against("<a/>", tmp_path / "s.xsd")


@pytest.mark.skipif(not hasattr(os, "wait4"), reason="computing time is limited on such systems")
def test_a_reader_is_stopped_by_what_it_computes_not_by_what_others_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module._CHILDREN.end()  # a child imports nothing from the working directory
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "SECONDS", 0.1)
    monkeypatch.setattr(module, "PATIENCE", 6_000)
    with pytest.raises(Stopped, match=r"longer than 0\.1 s"):
        guarded(f"{READING}:endless", {}, 0)
    assert guarded(f"{READING}:echoed", {}, 0) == b"[]"


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.ls", "/PROG x\n/POS\nP[1]{\nGP1:\nJ1=1 deg,J2=1 deg,J3=1 deg,J4=1 deg,J5=1 deg,"
         "J6=1 deg,CONFIG:'N U T, 0, " + "9" * 5_000 + ", 0'\n};\n"),
        ("a.src", "PTP {X 1,Y 1,Z 1,A 1,B 1,C 1,S " + "9" * 400 + ",T 2}\n"),
    ],
)  # fmt: skip
def test_a_state_of_a_program_with_too_many_digits_is_refused(
    name: str, text: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text, "latin-1")
    with pytest.raises(LoopcalError, match="digits"):
        read_program(tmp_path / name, JointAxes({f"j{i}": "rad" for i in range(6)}))
