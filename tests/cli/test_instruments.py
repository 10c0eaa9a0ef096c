"""Instruments from the command line: templates simulated and calibrated, mistakes told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Run

ARM = """\
schema = 1
fit = { method = "implicit-loop" }
[mechanism]
type = "serial"
joint = [{ name = "q1", a = 0.5 }, { name = "q2", a = 0.25, alpha = 1.5 }]
%s
[data]
file = "poses.csv"
pose = "pose"
[noise]
"*" = { sd = 1e-4 }
[prior]
"*" = { sd = 0.1 }
"d_*" = { sd = 0.01 }
"""
POSE = """\
pose,q1,q2,x,y,z,qw,qx,qy,qz
1,0.1,0.2,0.7,0.1,0.0,1,0,0,0
2,0.3,0.1,0.7,0.2,0.0,0,0,0,0
3,0.5,0.3,0.6,0.4,0.0,0.9,0,0,0.4
"""
WIRE = "pose,q1,q2,wire\n1,0.4,0.2,0.5\n2,0,0,0.6\n3,0.2,0.3,0.4\n"


def instrument(text: str) -> str:
    return f"[[mechanism.instrument]]\n{text}\n"


@pytest.mark.parametrize("kind", ["serial-trackers", "serial-draw-wire", "serial-socket"])
def test_a_set_up_is_simulated_and_calibrated(run: Run, folder: Path, kind: str) -> None:
    assert run("new", "arm", "--mechanism", kind).code == 0
    made = run("simulate", "arm/project.toml", "--out", "arm/poses.csv", "--seed", "4")
    assert made.code == 0, made.err
    done = run(
        *("calibrate", "arm/project.toml", "--truth", "arm/poses.truth.json", "--json"),
        *("--method", "implicit-loop"),
    )
    assert done.code == 0, done.err
    assert (folder / "arm" / "project-result" / "report.html").is_file()
    result = json.loads(done.out)
    assert result["chi_squared"]["p_value"] > 1e-3
    free = [p for p in result["parameters"] if not p["fixed"]]
    assert all(abs(p["error"]) < 5 * p["sd"] for p in free)
    again = run("update", "arm/project-result", "arm/poses.csv", "--out", "arm/updated")
    assert again.code == 0, again.err


@pytest.mark.parametrize(
    ("mechanism", "data", "words"),
    [
        (
            instrument('type = "pose"'),
            POSE,
            ["poses.csv, row 3", "qw", "orientation", "leave its numbers blank"],
        ),
        (
            instrument('type = "draw-wire"') + "[mechanism.parameters]\nwire_x = 0.75",
            WIRE,
            ["'wire' at pose '2'", "the target is at the point wire_x, wire_y, wire_z itself"],
        ),
        (
            instrument('type = "spherical"\nname = "T"')
            + instrument('type="draw-wire"\nanchor="T"'),
            POSE,
            ["'T_x'", "rename"],
        ),
        (instrument('type = "socket"\nname = "q1"\ngaps = ["q1"]'), POSE, ["1 gaps", "name 3"]),
        (
            instrument('type = "pose"\norientation = "zyx"'),
            POSE,
            ["mechanism.instrument[1]", "'zyx'"],
        ),
        (
            instrument('type = "relative-distance"\nreading = "x"'),
            POSE,
            ["'q1_b'"],
        ),
    ],
)
def test_a_mistake_is_told_with_its_place_and_remedy(
    run: Run, folder: Path, mechanism: str, data: str, words: list[str]
) -> None:
    (folder / "poses.csv").write_text(data)
    (folder / "project.toml").write_text(ARM % mechanism)
    done = run("calibrate", "project.toml", "--no-report")
    assert done.code == 3, done.err
    assert "What to do" in done.err
    for word in words:
        assert word in done.err, done.err
