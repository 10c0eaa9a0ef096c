"""A robot's table in the other convention of Denavit and Hartenberg than it states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.errors import InputError
from tests.reference.frames import dh, modified_dh

# a and d [mm], alpha [deg], of an arm with parallel axes and a wrist, in each convention.
ROWS = {
    "dh": [(150, 450, -90), (600, 0, 0), (120, 0, -90), (0, 640, 90), (0, 0, -90), (0, 100, 0)],
    "mdh": [(0, 400, 0), (150, 0, -90), (600, 0, 0), (120, 640, -90), (0, 0, 90), (0, 100, -90)],
}
FORMS = {"dh": dh, "mdh": modified_dh}


def readings(form: str) -> dict[str, np.ndarray]:
    """Joints [deg] and a point [mm] of the arm in 60 poses."""
    rng = np.random.default_rng(61200)
    q = rng.uniform(-1.2, 1.2, (60, 6))
    ends = []
    for row in q:
        T = np.eye(4)
        for (a, d, alpha), theta in zip(ROWS[form], row, strict=True):
            T = T @ FORMS[form](a, d, np.radians(alpha), theta)
        ends.append((T @ [30.0, -20.0, 120.0, 1.0])[:3])
    seen = np.array(ends) + [900.0, -400.0, 300.0] + 0.5 * rng.standard_normal((60, 3))
    joints = {f"J{i + 1} [deg]": np.degrees(q[:, i]) for i in range(6)}
    return {**joints, **dict(zip(["x [mm]", "y [mm]", "z [mm]"], seen.T, strict=True))}


def table(path: Path, form: str, header: str) -> Path:
    lines = [f"{i + 1},{a},{d},{alpha}" for i, (a, d, alpha) in enumerate(ROWS[form])]
    path.write_text("\n".join([header, *lines]) + "\n")
    return path


def mechanism(path: Path, form: str, stated: str) -> Path:
    rows = [
        f'[[joint]]\nname = "J{i + 1}"\nform = "{stated}"\na = {a}\nd = {d}\nalpha = {alpha}\n'
        for i, (a, d, alpha) in enumerate(ROWS[form])
    ]
    head = 'type = "serial"\nunits = { length = "mm", angle = "deg" }\nfix_redundant = true\n'
    path.write_text(f"schema = 1\n{head}tool = {{ z = 100 }}\n{chr(10).join(rows)}")
    return path


def test_a_classical_table_that_states_the_modified_convention_is_refused(tmp_path: Path) -> None:
    header = "joint,a_i-1 [mm],d [mm],alpha_i-1 [deg]"
    path = table(tmp_path / "dh.csv", "dh", header)
    with pytest.raises(InputError, match=r"modified convention.* but is of the classical one"):
        lc.init(readings("dh"), dh=path)
    right = table(tmp_path / "mdh.csv", "mdh", header)
    assert lc.init(readings("mdh"), dh=right).rms < 2e-3


@pytest.mark.parametrize(("form", "stated"), [("mdh", "dh"), ("dh", "mdh")])
def test_a_mechanism_file_of_the_other_convention_is_refused(
    tmp_path: Path, form: str, stated: str
) -> None:
    words = {"dh": "classical", "mdh": "modified"}
    path = mechanism(tmp_path / "arm.toml", form, stated)
    with pytest.raises(InputError, match=f"{words[stated]} convention.* of the {words[form]} one"):
        lc.init(readings(form), machine=str(path))
