"""Loop families: instruments that each read some of the poses, all in one problem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loopcal import Dataset, Noise, calibrate
from loopcal.errors import InputError
from loopcal.estimation.problem.problem import build_problem
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.four_bar import four_bar
from loopcal.mechanisms.serial import Joint, serial_machine
from loopcal.simulation.poses import random_poses
from loopcal.simulation.simulate import Simulation, simulate

NOISE = {"q*": 2e-5, "*_east": 3e-5, "*_west": 5e-5}
STATIONS = {
    "east_x": 2.0,
    "east_y": -0.5,
    "east_rz": 1.1,
    "east_rx": 0.02,
    "west_x": -1.5,
    "west_z": 0.4,
    "west_rz": -2.0,
    "west_ry": 0.03,
}


def arm() -> Mechanism:
    """Three joints seen by two stations, each of which looks at a reflector of its own."""
    joints = [Joint("q1"), Joint("q2"), Joint("q3")]
    looking = [
        point(
            where,
            readings=[f"{axis}_{where}" for axis in "xyz"],
            station=where,
            target=f"ball_{where}",
        )
        for where in ("east", "west")
    ]
    nominal = {"a_1": 0.3, "alpha_1": 1.5, "a_2": 0.5, "alpha_2": -0.4, "d_2": 0.1}
    made = assemble(serial_machine(joints), looking, nominal | {"ball_east_x": 0.4})
    redundant = ["d_1", "offset_1", "[ad]_3", "alpha_3", "offset_3"]
    return made.with_parameters(made.parameters.with_fixed(redundant))


def simulated(machine: Mechanism, seed: int) -> Simulation:
    ranges = {"q1": (-2.0, 2.0), "q2": (-1.5, 1.5), "q3": (-2.0, 2.0)}
    truth = STATIONS | {"a_1": 0.301, "a_2": 0.4995, "alpha_1": 1.502, "ball_west_y": 0.2}
    poses = random_poses(ranges, 60, seed=seed)
    return simulate(machine, poses, noise=Noise(NOISE), seed=seed, truth=truth)


def seen_in_part(data: Dataset) -> Dataset:
    """The east alone sees the first poses, the west the last, both those between."""
    number = np.arange(len(data))
    return data.with_readings(
        {f"{axis}_east": np.where(number < 40, data[f"{axis}_east"], np.nan) for axis in "xyz"}
        | {f"{axis}_west": np.where(number >= 25, data[f"{axis}_west"], np.nan) for axis in "xyz"}
    )


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares", "reweighted"])
def test_a_family_left_out_is_one_whose_readings_are_eliminated(method: str) -> None:
    machine = arm()
    data = seen_in_part(simulated(machine, 3).dataset)
    whole = replace(machine, families=())
    placed = machine.with_nominal(STATIONS)
    found = calibrate(placed, data, noise=Noise(NOISE), method=method, start="nominal")
    other = calibrate(
        whole.with_nominal(STATIONS), data, noise=Noise(NOISE), method=method, start="nominal"
    )
    assert found.status.converged
    assert found.problem.equations == other.problem.equations == 3 * (40 + 35)
    for name in found.estimated:
        assert found.value[name] == pytest.approx(other.value[name], abs=1e-9)
        assert found.sd[name] == pytest.approx(other.sd[name], rel=1e-5)
    q = found.corrections["q2"], other.corrections["q2"]
    assert q[0] == pytest.approx(q[1], abs=1e-10)


def test_a_coordinate_left_out_is_one_that_is_eliminated_and_no_fault_of_the_file() -> None:
    """As where a probe touches the faces of a cube."""
    machine = arm()
    data = simulated(machine, 3).dataset
    number = np.arange(len(data))
    blank = {
        f"{axis}_west": np.where(number % 3 == i, data[f"{axis}_west"], np.nan)
        for i, axis in enumerate("xyz")
    }
    data = data.with_readings(blank)
    fit = {"noise": Noise(NOISE), "method": "implicit-loop", "start": "nominal"}
    read, eliminated = (
        calibrate(one.with_nominal(STATIONS), data, **fit)
        for one in (machine, replace(machine, families=()))
    )
    assert read.faults == ()
    assert not any(pattern.unmeasured for pattern in read.problem.patterns)
    assert any(pattern.unmeasured for pattern in eliminated.problem.patterns)
    assert read.problem.equations == eliminated.problem.equations == 60 * 4
    for name in read.estimated:
        sd = eliminated.sd[name]
        assert sd
        assert read.value[name] == pytest.approx(eliminated.value[name], abs=1e-6 * sd)
        assert read.sd[name] == pytest.approx(sd, rel=1e-6)


def test_loops_are_there_only_where_their_instrument_read() -> None:
    machine = arm().with_nominal(STATIONS)
    data = seen_in_part(simulated(machine, 4).dataset)
    problem = build_problem(machine, data, Noise(NOISE))
    kinds = {p.loops: len(np.arange(60)[p.poses]) for p in problem.patterns}
    assert kinds == {(0, 1, 2): 25, (3, 4, 5): 20, (0, 1, 2, 3, 4, 5): 15}
    assert not any(p.unmeasured for p in problem.patterns)
    result = calibrate(machine, data, noise=Noise(NOISE), method="implicit-loop")
    assert np.isnan(result.residuals_after["x_west"][:25]).all()
    assert np.isfinite(result.residuals_after["x_west"][25:]).all()
    assert result.accuracy_after is not None
    assert result.accuracy_after.poses == 40 + 35


def test_a_pose_that_no_instrument_read_says_nothing_and_disturbs_nothing() -> None:
    machine = arm().with_nominal(STATIONS)
    data = simulated(machine, 5).dataset
    blank = {q: np.where(np.arange(60) < 50, data[q], np.nan) for q in machine.outputs}
    with_blanks = calibrate(
        machine, data.with_readings(blank), noise=Noise(NOISE), method="implicit-loop"
    )
    without = calibrate(
        machine, data.take(np.arange(50)), noise=Noise(NOISE), method="implicit-loop"
    )
    for name in without.estimated:
        assert with_blanks.value[name] == pytest.approx(without.value[name], abs=1e-10)
    assert np.all(with_blanks.corrections["q1"][50:] == 0.0)


def test_every_station_is_placed_where_it_sees_the_machine() -> None:
    machine = arm()  # both nominally stand at the base
    made = simulated(machine, 6)
    result = calibrate(
        machine, seen_in_part(made.dataset), noise=Noise(NOISE), method="implicit-loop"
    )
    assert result.status.converged
    for name in ("east_x", "west_rz", "a_2", "ball_west_y"):
        sd = result.sd[name]
        assert sd is not None
        assert abs(result.value[name] - made.parameters[name]) < 4.5 * sd
    chi = result.chi_squared
    assert chi is not None
    assert chi.p_value is not None
    assert chi.p_value > 1e-3


@pytest.mark.parametrize("method", ["implicit-loop", "least-squares", "reweighted"])
def test_an_instrument_without_readings_stays_at_its_nominal_place(method: str) -> None:
    machine = arm().with_nominal({"west_x": -1.5})
    data = simulated(machine, 6).dataset
    east = {q: v for q, v in data.readings.items() if not q.endswith("_west")}
    noise = Noise(NOISE | {"*_west": np.inf})
    result = calibrate(machine, Dataset.from_arrays(east), noise=noise, method=method)
    assert result.status.converged
    assert result.value["west_x"] == pytest.approx(-1.5, abs=1e-12)
    assert result.sd["west_x"] == np.inf
    assert result.sd["east_x"] is not None
    assert result.sd["east_x"] < 1e-3


def test_least_squares_without_a_joint_is_not_told_to_give_sds() -> None:
    machine = arm()
    data = simulated(machine, 6).dataset
    rest = {q: v for q, v in data.readings.items() if q != "q3"}
    with pytest.raises(InputError) as refused:
        calibrate(machine, Dataset.from_arrays(rest), method="least-squares")
    assert "'q3'" in refused.value.message
    assert refused.value.remedy is not None
    assert "another method" in refused.value.remedy


def test_native_readings_of_a_tracker_have_an_accuracy_in_metres() -> None:
    joints = [Joint("q1"), Joint("q2"), Joint("q3")]
    machine = assemble(
        serial_machine(joints),
        [spherical("tracker")],
        {"a_1": 0.3, "alpha_1": 1.5, "a_2": 0.5, "alpha_2": -0.4, "tool_x": 0.4},
    )
    machine = machine.with_parameters(
        machine.parameters.with_fixed(["d_1", "offset_1", "[ad]_3", "alpha_3", "offset_3"])
    )
    ranges = {"q1": (-2.0, 2.0), "q2": (-1.5, 1.5), "q3": (-2.0, 2.0)}
    noise = Noise({"q*": 1e-6, "*": 1e-5})
    made = simulate(
        machine,
        random_poses(ranges, 50, seed=1),
        noise=noise,
        seed=1,
        truth={"tracker_x": 3.0, "tracker_rz": 3.0},
    )
    result = calibrate(machine, made.dataset, noise=noise, method="implicit-loop")
    assert result.status.converged
    assert result.accuracy_after is not None
    assert result.accuracy_after.unit == "m"
    # 1e-5 rad at 3 m twice, 1e-5 m once
    assert result.accuracy_after.rms == pytest.approx(4.4e-5, rel=0.15)


def test_range_and_azimuth_in_a_plane_place_the_machine_and_have_an_accuracy_in_metres() -> None:
    machine = assemble(four_bar(), [spherical("tracker", dimension=2)])
    noise = Noise({"tracker_*": 1e-5, "theta_1": 1e-5, "platform_rz": np.inf})
    truth = {"tracker_x": 1.5, "tracker_y": -0.4, "tracker_rz": 2.0}
    poses = random_poses({"theta_1": (0.2, 2.5)}, 15, seed=1)
    made = simulate(machine, poses, noise=noise, seed=1, truth=truth)
    result = calibrate(machine, made.dataset, noise=noise, method="implicit-loop", max_iterations=1)
    assert result.accuracy_before is not None
    assert result.accuracy_before.unit == "m"
    assert result.accuracy_before.rms < 1e-3  # placed: the station is 1.5 m and two radians off
