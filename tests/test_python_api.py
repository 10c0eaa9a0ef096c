"""The Python interface as the contract shows it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import polars as pl
import pytest

import loopcal as lc
from loopcal.files.machines.mechanism_writer import mechanism_to_toml
from tests.refusals import refused


def two_link(x, p):
    a = x.phi2 + p.phi20
    b = a + x.phi3 + p.phi30
    return (
        p.xA + p.l2 * np.cos(a) + p.l3 * np.cos(b) - x.xP,
        p.yA + p.l2 * np.sin(a) + p.l3 * np.sin(b) - x.yP,
    )


def arm() -> lc.Mechanism:
    return lc.Mechanism.from_function(
        two_link,
        quantities={"xP": "m", "yP": "m", "phi2": "rad", "phi3": "rad"},
        parameters={
            **{"xA": (0.0, "m"), "yA": (0.0, "m"), "l2": (0.8, "m"), "l3": (0.6, "m")},
            **{"phi20": (0.0, "rad"), "phi30": (0.0, "rad")},
        },
        outputs=("xP", "yP"),
    )


NOISE = lc.Noise({"xP": 1e-4, "yP": 1e-4, "phi2": 1e-3, "phi3": 1e-3})


def readings() -> dict[str, np.ndarray]:
    angles = np.radians(np.arange(0, 360, 20))
    poses = lc.grid_poses({"phi2": angles, "phi3": angles})
    made = lc.simulate(arm(), poses, noise=NOISE, seed=1, truth={"l2": 0.803})
    return {name: made.dataset[name] for name in arm().quantities}


def test_the_example_of_the_contract_runs_as_written() -> None:
    data = lc.Dataset.from_arrays(readings())
    prior = lc.Prior({"*": np.inf})
    result = lc.calibrate(arm(), data, noise=NOISE, prior=prior, method="implicit-loop")
    basic = lc.calibrate(arm(), data, method="least-squares")
    sd = result.sd["l2"]
    assert sd is not None
    assert abs(result.value["l2"] - 0.803) < 4 * sd
    assert result.covariance.shape == (6, 6)
    assert result.chi_squared is not None
    assert 500 < result.chi_squared.value < 800
    assert result.corrections["phi3"].shape == (324,)
    assert result.status.converged
    assert basic.status.converged
    assert "l2" in str(result)
    assert "l2" in result._repr_html_()


KINDS: dict[str, Callable[[dict[str, np.ndarray]], Any]] = {
    "dict": dict,
    "pandas": pd.DataFrame,
    "polars": pl.DataFrame,
    "dataset": lc.Dataset.from_arrays,
}


@pytest.mark.parametrize("kind", KINDS)
def test_readings_may_come_as_any_table(kind: str) -> None:
    expected = lc.calibrate(
        arm(), lc.Dataset.from_arrays(readings()), noise=NOISE, method="implicit-loop"
    )
    result = lc.calibrate(arm(), KINDS[kind](readings()), noise=NOISE, method="implicit-loop")
    assert dict(result.value) == dict(expected.value)


def test_results_are_frozen() -> None:
    result = lc.calibrate(arm(), readings(), noise=NOISE, method="implicit-loop")
    with pytest.raises(AttributeError):
        result.method = "other"  # type: ignore[misc]
    with pytest.raises(TypeError):
        result.value["l2"] = 1.0  # type: ignore[index]
    with pytest.raises(ValueError, match="read-only"):
        result.corrections["phi2"][0] = 1.0


def test_every_public_name_is_typed_where_it_lives(tmp_path: Path) -> None:
    source = Path(lc.__file__).read_text("utf-8")
    typed = source[source.index("if TYPE_CHECKING") : source.index("_HOME")]
    for name in lc.__all__:
        assert name == "__version__" or name in typed


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = (
        "import sys, loopcal; loopcal.__all__, dir(loopcal)\n"
        "assert not {'numpy', 'pydantic', 'typer', 'polars'} & set(sys.modules)\n"
        "assert not {'loopcal.machines', 'loopcal.instruments'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_machines_are_loaded_without_what_reads_files() -> None:
    code = (
        "import sys, loopcal; loopcal.assemble(loopcal.machines.five_bar(passive=['phi_1']))\n"
        "assert not {'pydantic', 'typer', 'polars', 'lxml', 'plotly'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def mechanisms_made_here() -> dict[str, lc.Mechanism]:
    joints = [lc.Joint("q1"), lc.Joint("q2", form="hayati"), lc.Joint("q3")]
    axes = [lc.machines.ScrewJoint(f"q{i}", (0, 1, 0), (0, 0, 0.3 * i)) for i in (1, 2)]
    look = lc.instruments
    two = [look.spherical("T"), look.draw_wire("w", anchor="pin"), look.sphere(centre="pin")]
    made = {
        "serial": lc.assemble(lc.machines.serial(joints), two, {"a_1": 0.4, "pin_x": 1.0}),
        "exponentials": lc.assemble(lc.machines.exponentials(axes), [look.pose(), look.plane()]),
        "planar": lc.assemble(lc.machines.planar_two_link(), [look.point(dimension=2)]),
        "five-bar": lc.assemble(lc.machines.five_bar(passive=["phi_1", "phi_2"])),
        "four-bar": lc.assemble(lc.machines.four_bar(), [look.point(dimension=2)], {"crank": 0.13}),
        "hexapod": lc.assemble(lc.machines.stewart_gough(), [look.socket(), look.ball_bar()]),
        "delta": lc.assemble(lc.machines.rotary_delta(), [look.relative_distance()]),
    }
    return made | {"fixed": lc.fix_redundant(made["serial"])}


@pytest.mark.parametrize("name", mechanisms_made_here())
def test_what_is_assembled_here_is_what_a_file_says(name: str, tmp_path: Path) -> None:
    """Written as a mechanism file and read again, it is the same machine, bit for bit."""
    mechanism = mechanisms_made_here()[name]
    (tmp_path / "mechanism.toml").write_text(mechanism_to_toml(mechanism), "utf-8")
    again = lc.read_mechanism(tmp_path / "mechanism.toml")
    assert again.tape == mechanism.tape
    assert again.parameters == mechanism.parameters
    assert (again.quantities, again.outputs) == (mechanism.quantities, mechanism.outputs)
    assert (again.implied, again.home) == (mechanism.implied, mechanism.home)


def test_loop_values_are_those_of_the_equations() -> None:
    arm = lc.planar_two_link()
    angles = {"phi2": np.array([0.3, 1.0]), "phi3": np.array([0.2, -0.4])}
    readings = {**angles, "xP": np.full(2, 0.1), "yP": np.full(2, 0.2)}
    made = arm.loop_values(readings, {"l2": 0.9, "xA": 0.05})
    l3 = arm.parameters["l3"].nominal
    x = 0.05 + 0.9 * np.cos(readings["phi2"]) + l3 * np.cos(readings["phi2"] + readings["phi3"])
    assert made["xP"] == pytest.approx(x - 0.1)
    with refused("unknown-name", "l9"):
        arm.loop_values(readings, {"l9": 1.0})
    with refused("unknown-name", "phi3"):
        arm.loop_values({k: v for k, v in readings.items() if k != "phi3"})
