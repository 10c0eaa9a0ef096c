"""Whatever is typed, named or run: a documented exit code, one message, nothing raw."""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from analyses.hostile_inputs import PYTHON, VALUES
from loopcal.cli import main
from loopcal.companions.life.history_files import history
from loopcal.companions.life.history_folder import append_entries, read_entries
from loopcal.companions.life.pages import history_html
from loopcal.errors import InputError
from loopcal.files.machines.mechanism_file import mechanism_from_data
from loopcal.files.machines.python_function import load_function
from loopcal.mechanisms.limits import joint_limits

LONG = "n" * 300


@pytest.mark.parametrize(
    "arguments",
    [
        ("noise", os.fsdecode(b"a\xff.csv")),
        ("init", "missing.csv"),
        ("init", "missing.csv", "--dh", "missing.csv"),
        ("noise", f"{LONG}.csv"),
        ("check", f"{LONG}.toml"),
        ("history", LONG, "--event", "x"),
        ("history", LONG),
        ("new", LONG, "--mechanism", "planar-two-link"),
        ("new", f"a/{LONG}/b", "--mechanism", "planar-two-link"),
        ("report", LONG),
        ("record", LONG),
        ("export", LONG, "--to", "urdf"),
        ("predict", LONG, LONG),
        ("performance", "x\ny" * 200),
        ("study", f"{LONG}.toml"),
        ("check", "p.toml", "--mechanism", f"{LONG}.py:x"),
        ("check", "p/" * 3_000),
        ("check", "/dev/zero"),
        ("check", "\x1b[2J.toml"),
    ],
)
def test_a_name_that_no_file_has_ends_in_one_message(
    arguments: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    code = main(arguments)
    said = capsys.readouterr()
    assert code in (2, 3)
    assert said.err.startswith("loopcal: ") or "Usage" in said.err
    assert "Traceback" not in said.err
    assert "\x1b" not in said.err
    assert len(said.err) < 4_000


@pytest.mark.parametrize("text", PYTHON)
def test_a_function_of_the_users_fails_as_an_input_does(text: str, tmp_path: Path) -> None:
    (tmp_path / "f.py").write_text(text, "utf-8")
    with contextlib.suppress(InputError):
        made = load_function(f"{tmp_path / 'f.py'}:loops")
        if callable(made):
            made(None, None)


def test_a_function_that_exits_says_so(tmp_path: Path) -> None:
    for place in ("", "def loops(x, p):\n    "):
        (tmp_path / "f.py").write_text(f"import sys\n{place}sys.exit(0)\n", "utf-8")
        with pytest.raises(InputError, match="SystemExit") as caught:
            load_function(f"{tmp_path / 'f.py'}:loops")(None, None)  # type: ignore[operator]
        assert caught.value.code == "failing-function"
        assert "line" in str(caught.value.place)


@pytest.fixture
def entries(tmp_path: Path) -> Path:
    folder = tmp_path / "machine.history"
    its = {"value": 1.0, "sd": 0.1, "unit": "m", "kind": "length"}
    content = {"words": "valid", "rms": 1e-4, "unit": "m", "parameters": {"a": its}}
    for _ in range(3):
        append_entries(folder, [("calibration", content)])
    return folder


PLACES = (
    ("sequence",),
    ("time",),
    ("kind",),
    ("content",),
    ("content", "words"),
    ("content", "rms"),
    ("content", "unit"),
    ("content", "parameters"),
    ("content", "parameters", "a"),
    ("content", "parameters", "a", "value"),
    ("content", "parameters", "a", "sd"),
    ("content", "parameters", "a", "unit"),
)


@pytest.mark.parametrize("place", PLACES, ids=".".join)
def test_an_entry_of_a_wrong_type_is_named_and_the_others_serve(
    place: tuple[str, ...], entries: Path
) -> None:
    path = sorted(entries.glob("*.json"))[1]
    valid = json.loads(path.read_text("utf-8"))
    drawn = 0
    for value in (*VALUES, 10**400, "\ud800", "2026-01-01T00:00:00"):
        body = json.loads(json.dumps(valid))
        body.pop("sha256")
        at: Any = body
        for key in place[:-1]:
            at = at[key]
        at[place[-1]] = value
        text = json.dumps(body, sort_keys=True, separators=(",", ":"))
        path.write_text(json.dumps({**body, "sha256": hashlib.sha256(text.encode()).hexdigest()}))
        found = history(entries)
        others = len(read_entries(entries).whole)
        assert others in (2, 3)
        assert (path.name in str(found)) == (others == 2)
        json.dumps(found.document())
        if others == 3 and not drawn:
            drawn = len(history_html(found))


@pytest.mark.parametrize("limits", ["-1e308 1e308", "-1e16 1e16", "-inf inf", "-1 1e300"])
def test_limits_that_limit_nothing_are_none(limits: str, tmp_path: Path) -> None:
    low, high = limits.split()
    (tmp_path / "r.urdf").write_text(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="revolute">'
        f'<parent link="a"/><child link="b"/><limit lower="{low}" upper="{high}"/></joint></robot>'
    )
    with contextlib.suppress(InputError):
        its = {"type": "urdf", "file": str(tmp_path / "r.urdf"), "base": "a", "tip": "b"}
        made = mechanism_from_data({**its, "fix_redundant": True}, "p.toml")
        assert not joint_limits(made)


def ended(command: str, folder: Path) -> tuple[int, str]:
    """Code and text of a shell line in which $L is loopcal."""
    program = f"{sys.executable} -m loopcal"
    done = subprocess.run(
        ["sh", "-c", command.replace("$L", program)],
        cwd=folder,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="there is no full device here")
@pytest.mark.parametrize(
    ("command", "code", "words"),
    [
        ("$L --help >/dev/full", 3, "No space left"),
        ("$L check none.toml 2>&-", 3, ""),
        ("$L schema project >&- 2>&- <&-", 0, ""),
        ("$L check none.toml 2>/dev/full", 3, ""),
        ("$L schema project >/dev/full", 5, "standard output"),
    ],
)
def test_a_closed_or_full_stream_ends_no_command_in_a_fault(
    command: str, code: int, words: str, tmp_path: Path
) -> None:
    found, said = ended(command, tmp_path)
    assert found == code
    assert words in said
    assert "Traceback" not in said
    assert "Exception ignored" not in said
    assert not [*tmp_path.iterdir()]


def test_text_for_people_has_lines_of_bounded_length(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from loopcal.cli.output import print_error, print_out

    out = io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", out)
    for write in (print_out, print_error):
        write("a\x1b[2J" + "x " * 20_000 + "\nnext")
    assert len(out.getvalue()) < 5_000
    assert "\x1b" not in out.getvalue()
    assert out.getvalue().count("next") == 2


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("line", ["l3 = 1e308", "l2 = -1e308"])
def test_a_nominal_of_any_size_ends_noise_in_no_fault(tmp_path: Path, line: str) -> None:
    """Beside it no direction is left in which the loops could tell sensors apart."""
    example = Path(__file__).parents[2] / "examples" / "planar"
    text = (example / "project.toml").read_text("utf-8")
    lines = [line if row.startswith(line[:2]) else row for row in text.splitlines()]
    (tmp_path / "project.toml").write_text("\n".join(lines), "utf-8")
    words = ("noise", example / "poses.csv", "--project", tmp_path / "project.toml")
    assert main([str(word) for word in words]) in (0, 3, 4)
