"""Nominal values and sds in another unit are refused with the likely one, wherever they enter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.workflow.calibration import run_calibration
from loopcal.workflow.checking import run_check
from tests.refusals import refused

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NOISE = {"?P": 1e-4, "phi?": 1e-3}


@pytest.fixture(scope="module")
def data() -> lc.Dataset:
    return lc.load_dataset(EXAMPLES / "planar" / "project.toml").dataset


@pytest.mark.parametrize(
    ("nominal", "likely"),
    [({"l2": 800.0}, "mm"), ({"l2": 800.0, "l3": 600.0}, "mm"), ({"phi20": 90.0}, "deg")],
)
@pytest.mark.parametrize("method", ["auto", "implicit-loop", "least-squares"])
def test_a_nominal_value_in_another_unit(
    data: lc.Dataset, nominal: dict[str, float], likely: str, method: str
) -> None:
    arm = lc.planar_two_link(nominal)
    with refused("implausible-unit", next(iter(nominal)), f"it looks like {likely}"):
        lc.calibrate(arm, data, noise=NOISE, method=method)
    with refused("implausible-unit", likely):
        lc.check(arm, data, noise=NOISE)


@pytest.mark.parametrize(
    ("noise", "name", "likely"),
    [
        ({"*": 1.0}, "xP", "mm"),
        ({**NOISE, "phi?": 1.0}, "phi2", "mrad"),
        ({**NOISE, "yP": 0.5}, "yP", "mm"),
    ],
)
def test_an_sd_in_another_unit(
    data: lc.Dataset, noise: dict[str, float], name: str, likely: str
) -> None:
    with refused("implausible-unit", name, f"the sd looks like {likely}"):
        lc.calibrate(lc.planar_two_link(), data, noise=noise)


def test_what_is_coarse_but_possible_is_taken(data: lc.Dataset) -> None:
    for noise in (
        {**NOISE, "phi2": 0.2},  # a fifth of its readings
        {**NOISE, "phi2": np.inf},  # not measured
        lc.Noise({**NOISE, "phi?": 1.0}, estimate={"phi?": "group"}),  # where a search begins
    ):
        assert lc.check(lc.planar_two_link(), data, noise=noise).verdict
    rod = lc.Mechanism.from_function(
        lambda x, p: [p.a - x.length], {"length": "m"}, {"a": (1.0, "m")}
    )
    assert lc.check(rod, {"length": [1.0, 1.1]}, noise={"length": 0.1}).verdict  # of one length
    turns = {"phi2": [20.0, 20.5, 21.0, 22.0], "phi3": [1.0, 1.2, 1.4, 0.3]}
    arm = lc.planar_two_link({"phi20": 19.0})
    made = lc.simulate(arm, turns, noise={"*": 0.0}, seed=1, units={"phi2": "rad"})
    assert lc.check(arm, made.dataset, noise=NOISE).verdict


@pytest.mark.parametrize(
    ("old", "new", "name"),
    [
        ('l2 = { value = 800, unit = "mm" }', 'l2 = { value = 800, unit = "m" }', "l2"),
        ('phi3 = { sd = 1, unit = "mrad" }', 'phi3 = { sd = 1, unit = "rad" }', "phi3"),
    ],
)
def test_a_project_is_refused_alike(tmp_path: Path, old: str, new: str, name: str) -> None:
    folder = EXAMPLES / "planar"
    text = (folder / "project.toml").read_text("utf-8")
    assert old in text
    (tmp_path / "project.toml").write_text(text.replace(old, new), "utf-8")
    (tmp_path / "poses.csv").write_bytes((folder / "poses.csv").read_bytes())
    for run in (run_calibration, run_check):
        with refused("implausible-unit", name, "project.toml"):
            run(tmp_path / "project.toml")
