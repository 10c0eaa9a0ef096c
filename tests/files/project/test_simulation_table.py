"""What a project says of its simulation: poses, the true machine, the true noise."""

from __future__ import annotations

import math

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.files.project.project_file import read_project
from loopcal.files.project.simulation_table import SimulationSettings
from loopcal.workflow.checking import simulated
from tests.refusals import refused

HEAD = 'schema = 1\n[mechanism]\ntype = "planar-two-link"\n[noise]\n"*" = 1e-3\n[simulation]\n'
BOTH = "ranges = { phi2 = { from = 0, to = 1 }, phi3 = { from = 0, to = 1 } }\n"


def spec(text: str) -> SimulationSettings:
    made = read_project("-", text=HEAD + text).simulation
    assert made is not None
    return made


def test_random_poses_within_ranges():
    made = spec(
        "poses = 100\n[simulation.ranges]\nphi2 = { from = -90, to = 90, unit = 'deg' }\n"
        "phi3 = { from = 0, to = 1 }\n"
    )
    assert (made.poses, made.grid) == (100, False)
    assert made.ranges["phi2"].start == pytest.approx(-math.pi / 2)
    assert made.ranges["phi3"].stop == 1.0


def test_steps_make_a_grid_of_all_combinations_with_both_ends():
    made = spec(
        "[simulation.ranges]\nphi2 = { from = -90, to = 90, step = 10, unit = 'deg' }\n"
        "phi3 = { from = 0, to = 1, step = 0.1 }\n"
    )
    assert (made.poses, made.grid) == (19 * 11, True)
    np.testing.assert_allclose(np.degrees(made.ranges["phi2"].values), np.arange(-90, 91, 10))
    np.testing.assert_allclose(made.ranges["phi3"].values, np.linspace(0, 1, 11), atol=1e-15)


def test_one_value_may_stand_in_a_grid():
    made = spec("ranges = { phi2 = { from = 2, to = 2 }, phi3 = { from = 0, to = 4, step = 3 } }")
    assert made.poses == 2
    assert made.ranges["phi2"].values.tolist() == [2.0]
    assert made.ranges["phi3"].values.tolist() == [0.0, 3.0]


def test_the_true_machine_by_name_or_glob():
    made = spec(
        f"poses = 1\n{BOTH}[simulation.truth]\n'l?' = 0.5\nl3 = {{ value = 601, unit = 'mm' }}\n"
        "[simulation.perturb]\n'phi*' = { sd = 2, unit = 'mrad' }\n"
    )
    assert made.truth == {"l2": 0.5, "l3": pytest.approx(0.601)}
    assert made.perturb == {"phi20": 2e-3, "phi30": 2e-3}


def test_a_fixed_parameter_does_not_deviate():
    fixed = HEAD.replace("[simulation]", "[parameters]\nl3 = { fixed = true }\n[simulation]")
    text = f"{fixed}poses = 1\n{BOTH}[simulation.perturb]\n"
    made = read_project("-", text=f"{text}'l*' = 1e-3").simulation
    assert made is not None
    assert made.perturb == {"l2": 1e-3}
    with refused("conflicting-keys", "fixed"):
        read_project("-", text=f"{text}l3 = 1e-3")


def test_the_true_noise_is_the_told_one_unless_stated():
    made = spec(f"poses = 1\n{BOTH}[simulation.noise]\nphi3 = 5e-3\n")
    assert made.noise.sd_of("phi3") == 5e-3
    assert made.noise.sd_of("phi2") == 1e-3


def test_a_covariance_of_the_data_may_be_replaced_for_the_simulation():
    columns = "xPyP = { covariance_columns = [1, 2, 3] }\n[simulation]"
    head = HEAD.replace("[simulation]", columns)
    made = read_project("-", text=f"{head}poses = 1\n{BOTH}noise = {{ xPyP = 1e-4 }}").simulation
    assert made is not None
    assert made.noise.columns == ()


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("poses = 3", "simulation", "'ranges' is missing"),
        ("poses = 3\nranges = {}", "simulation.ranges", "too few"),
        (f"poses = 0\n{BOTH}", "simulation.poses", "too small"),
        (BOTH, "simulation", "number of poses"),
        (f"poses = {10**12}\n{BOTH}", "simulation.poses", "more than"),
        ("poses = 1\nranges = { phi2 = { from = 0, to = 1 } }", "simulation.ranges", "'phi3'"),
        ("ranges = { phi4 = { from = 0, to = 1 } }", "simulation.ranges.phi4", "no quantity"),
        ("ranges = { xP = { from = 0, to = 1 } }", "simulation.ranges.xP", "follows"),
        ("ranges = { phi2 = { from = 1, to = 0 } }", "simulation.ranges.phi2", "from 1 to 0"),
        ("ranges = { phi2 = { to = 0 } }", "simulation.ranges.phi2", "'from' is missing"),
        ("ranges = { phi2 = { from = 0, to = inf } }", "simulation.ranges.phi2.to", "inf"),
        ("ranges = { phi2 = { from = 0, to = 1, step = 0 } }", "ranges.phi2.step", "more than 0"),
        ("ranges = { phi2 = { from = 0, to = 1, unit = 'mm' } }", "ranges.phi2.unit", "length"),
        ("ranges = { phi2 = { start = 0 } }", "ranges.phi2.start", "unknown key"),
        (
            "ranges = { phi2 = { from = 0, to = 1, step = 1 }, phi3 = { from = 0, to = 1 } }",
            "simulation.ranges.phi3",
            "none",
        ),
        (
            "ranges = { phi2 = { from = 0, to = 1e9, step = 1e-9 }, phi3 = { from = 0, to = 0 } }",
            "simulation.ranges",
            "more than",
        ),
        (
            "poses = 9\n"
            "ranges = { phi2 = { from = 0, to = 1, step = 1 }, phi3 = { from = 0, to = 0 } }",
            "simulation.poses",
            "has 2",
        ),
        (f"poses = 1\n{BOTH}truth = {{ l9 = 1 }}", "simulation.truth.l9", "'l9'"),
        (f"poses = 1\n{BOTH}truth = {{ l2 = nan }}", "simulation.truth.l2", "nan"),
        (f"poses = 1\n{BOTH}perturb = {{ l2 = inf }}", "simulation.perturb.l2", "infinite"),
        (f"poses = 1\n{BOTH}perturb = {{ l2 = -1 }}", "simulation.perturb.l2", "negative"),
        (f"poses = 1\n{BOTH}noise = {{ phi9 = 1 }}", "simulation.noise.phi9", "'phi9'"),
        (
            f"poses = 1\n{BOTH}noise = {{ xPyP = {{ covariance_columns = [1, 2, 3] }} }}",
            "simulation.noise.xPyP",
            "covariance from columns",
        ),
    ],
)
def test_what_does_not_fit_is_refused_at_its_place(text, place, words):
    with pytest.raises(InputError) as caught:
        spec(text).refuse_missing()
    assert place in str(caught.value.place)
    assert words in str(caught.value)
    assert caught.value.remedy


CAMERA = """schema = 1
[mechanism]
type = "serial"
joint = [{ name = "q1", d = 0.4, alpha = 1.57 }, { name = "q2", a = 0.5 }]
[[mechanism.instrument]]
type = "pose"
name = "camera"
[noise]
"*" = 1e-4
[simulation]
poses = 3
"""


@pytest.mark.parametrize("name", ["x", "camera_wx", "qw"])
def test_what_an_instrument_reads_is_not_driven_and_the_joints_are_named(name: str) -> None:
    text = f"[simulation.ranges]\nq1 = {{ from = 0, to = 1 }}\n{name} = {{ from = 0, to = 1 }}\n"
    with refused("unknown-name", name) as caught:
        read_project("-", text=CAMERA + text)
    assert caught.value.remedy == "give the ranges of q1, q2"


def test_a_missing_range_is_refused_at_one_place() -> None:
    text = "[simulation.ranges]\nq1 = { from = 0, to = 1 }\n"
    with refused("missing-key", "'q2'") as caught:
        simulated(read_project("-", text=CAMERA + text), 1)
    assert caught.value.place == "standard input: simulation.ranges"
