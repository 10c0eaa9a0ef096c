"""Chains, studies and results that are too long, too many or out of their type are refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from loopcal import Joint, Processes, Threads, serial_arm
from loopcal.companions.studies.run import parts_of
from loopcal.files.json_files import read_json
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.machines.urdf import urdf_machine
from loopcal.mechanisms.chain import MOST_JOINTS
from tests.refusals import refused

LIMITS = '<limit lower="-1" upper="1"/><axis xyz="0 0 1"/><origin xyz="0.1 0 0.2"/>'


def chain(joints: int, before: str = "") -> str:
    links = "".join(f'<link name="l{i}"/>' for i in range(joints + 1))
    between = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f"{LIMITS}</joint>\n"
        for i in range(joints)
    )
    return f'{before}<?xml version="1.0"?>\n<robot name="r">{links}{between}</robot>'


def test_a_urdf_chain_of_thousands_of_joints_is_refused_by_its_length(tmp_path: Path) -> None:
    (tmp_path / "r.urdf").write_text(chain(20_000), "utf-8")
    with refused("too-large", "20000 joints"):
        urdf_machine(tmp_path / "r.urdf", "l0", "l20000")
    assert len(urdf_machine(tmp_path / "r.urdf", "l0", f"l{MOST_JOINTS}").quantities) == MOST_JOINTS


@pytest.mark.parametrize(
    "entry",
    [
        '[[joint]]\nname = "j{i}"\nform = "dh"\n',
        '[[joint]]\nname = "j{i}"\naxis = [0, 0, 1]\npoint = [0, 0, 0]\n',
    ],
)
def test_a_file_of_thousands_of_joints_is_refused_by_their_number(
    entry: str, tmp_path: Path
) -> None:
    kind = "serial" if "form" in entry else "exponentials"
    head = f'schema = 1\ntype = "{kind}"\n'
    text = head + "".join(entry.replace("{i}", str(i)) for i in range(5_000))
    (tmp_path / "arm.toml").write_text(text, "utf-8")
    with refused("too-large", "5000 joints"):
        read_mechanism(tmp_path / "arm.toml")


def test_an_arm_of_thousands_of_joints_is_refused_in_python_too() -> None:
    with refused("too-large", "1000 joints"):
        serial_arm([Joint(f"j{i}", "dh") for i in range(1_000)], {})


@pytest.mark.parametrize("before", ["\n", "\ufeff\n\n", "  \r\n\t"])
def test_blank_lines_before_the_declaration_are_passed_over(before: str, tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    path.write_text(chain(2, before), "utf-8", newline="")
    assert list(urdf_machine(path, "l0", "l2").quantities) == ["j0", "j1"]
    path.write_text(chain(2, before).replace('"revolute"', '"odd"'), "utf-8", newline="")
    line = 2 + before.count("\n")
    with refused("invalid-syntax", f"line {line}", "'j0'"):
        urdf_machine(path, "l0", "l2")


def test_a_study_of_more_draws_than_can_be_listed_is_refused() -> None:
    with refused("too-large", "1000000000000 draws"):
        parts_of(1, 10**12)


@pytest.mark.parametrize("kind", [Threads, Processes])
@pytest.mark.parametrize("workers", [0, 1_000_000])
def test_a_number_of_workers_that_cannot_be_is_refused(kind: type, workers: int) -> None:
    with refused("invalid-usage", str(workers)):
        kind(workers)


def test_half_a_character_in_json_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text('{"schema": 1, "title": "a\\ud800"}', "utf-8")
    with refused("invalid-syntax", "ud800"):
        read_json(path, "result.json", 1)
    path.write_text('{"schema": 1, "title": "a\\ud83d\\ude00"}', "utf-8")
    assert read_json(path, "result.json", 1)["title"] == "a\U0001f600"


def test_a_number_without_end_in_json_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "x.truth.json"
    path.write_text(f'{{"schema": 1, "parameters": {{"l2": 1{"0" * 400}}}}}', "utf-8")
    with refused("invalid-syntax", "401 digits"):
        read_json(path, "truth.json", 1)
