"""Parallel axes in parameters that have no solution are refused before the fit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from tests.command_line import run_here as run
from tests.refusals import refused

LENGTHS = {"d_1": 0.16, "a_2": -0.43, "a_3": -0.39, "d_4": 0.13, "d_5": 0.1, "d_6": 0.1}
ANGLES = {"alpha_1": math.pi / 2, "alpha_4": math.pi / 2, "alpha_5": -math.pi / 2}
NOISE = lc.Noise({"q?": 1e-5, "[xyz]": 2e-5})


def arm(forms: dict[str, str] | None = None, twist: float = 0.0) -> lc.Mechanism:
    """Six axes, of which the second, third and fourth are parallel but for the twist."""
    joints = [lc.Joint(f"q{i}", form=(forms or {}).get(f"q{i}", "dh")) for i in range(1, 7)]
    nominal = LENGTHS | ANGLES | {"tool_x": 0.05, "alpha_2": twist, "alpha_3": twist}
    known = set(lc.serial_arm(joints, {}).parameters.names)
    return lc.serial_arm(joints, {k: v for k, v in nominal.items() if k in known})


def readings(machine: lc.Mechanism, seed: int = 1) -> lc.Dataset:
    rng = np.random.default_rng(seed)
    poses = {f"q{i}": rng.uniform(-2.0, 2.0, 60) for i in range(1, 7)}
    truth = {
        p.name: p.nominal + (0.0 if p.fixed else rng.normal(0.0, 1e-3)) for p in machine.parameters
    }
    return lc.simulate(machine, poses, noise=NOISE, seed=seed, truth=truth).dataset


@pytest.mark.parametrize("twist", [0.0, 5e-4, math.pi])
def test_free_parallel_axes_are_refused_with_their_remedy(twist: float) -> None:
    with refused("not-identifiable", "q2", "q3", "d_2", "d_3", "hayati"):
        lc.calibrate(
            arm(twist=twist), readings(arm(twist=twist)), noise=NOISE, method="implicit-loop"
        )


def test_hayatis_form_converges() -> None:
    machine = arm({"q2": "hayati", "q3": "hayati"})
    machine = lc.fix_redundant(machine)
    result = lc.calibrate(machine, readings(machine), noise=NOISE, method="implicit-loop")
    assert result.status.converged
    assert result.status.note == ""


def test_axes_that_are_not_parallel_or_held_by_a_prior_are_accepted() -> None:
    for machine, prior in [
        (arm(twist=0.1), {}),
        (arm(), {"d_*": 0.002}),
        (arm(), {"d_2": 0.0, "d_3": 0.0}),
        (arm(), {"alpha_2": 0.0, "alpha_3": 0.0}),
    ]:
        lc.calibrate(
            machine,
            readings(machine),
            noise=NOISE,
            prior=prior,
            max_iterations=0,
            method="implicit-loop",
        )


def test_modified_parameters_are_refused_likewise() -> None:
    machine = arm(dict.fromkeys((f"q{i}" for i in range(1, 7)), "mdh"), twist=0.0)
    with refused("not-identifiable", "hayati"):
        lc.calibrate(machine, readings(machine), noise=NOISE, method="implicit-loop")


PROJECT = """schema = 1
fit = { method = "implicit-loop" }
[mechanism]
type = "serial"
[[mechanism.joint]]
name = "q1"
a = 0.4
d = 0.1
[[mechanism.joint]]
name = "q2"
a = 0.3
[data]
file = "poses.csv"
[data.columns]
q1 = { column = "q1", unit = "rad" }
q2 = { column = "q2", unit = "rad" }
x = { column = "x", unit = "m" }
y = { column = "y", unit = "m" }
z = { column = "z", unit = "m" }
[noise]
"q?" = 1e-5
"[xyz]" = 2e-5
"""


def test_the_command_refuses_before_the_fit(tmp_path: Path) -> None:
    (tmp_path / "project.toml").write_text(PROJECT, "utf-8")
    angles = np.random.default_rng(0).uniform(-2.0, 2.0, (30, 2))
    x = 0.4 * np.cos(angles[:, 0]) + 0.3 * np.cos(angles.sum(axis=1))
    y = 0.4 * np.sin(angles[:, 0]) + 0.3 * np.sin(angles.sum(axis=1))
    rows = [f"{a},{b},{u},{v},0.1" for (a, b), u, v in zip(angles, x, y, strict=True)]
    (tmp_path / "poses.csv").write_text("\n".join(["q1,q2,x,y,z", *rows]), "utf-8")
    done = run("calibrate", "project.toml", cwd=tmp_path)
    assert done.returncode == 3
    for text in ("'q1' and 'q2'", "parallel", "d_1", "d_2", "hayati"):
        assert text in done.stderr
    assert "Traceback" not in done.stderr
