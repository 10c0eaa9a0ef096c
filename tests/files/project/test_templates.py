"""A project to start from works at once: simulate it, calibrate it, and find the truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from loopcal.estimation.calibrate import calibrate
from loopcal.files.machines.mechanism_file import read_mechanism
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import Project, read_project
from loopcal.files.project.templates import TEMPLATES, template_files
from loopcal.simulation.poses import grid_poses, random_poses
from loopcal.simulation.simulate import Simulation, simulate
from tests.refusals import refused


def function_of(files):
    if "loops.py" not in files:
        return None
    namespace: dict = {}
    exec(files["loops.py"], namespace)
    return namespace["loops"]


def started(kind: str, folder) -> Project:
    files = template_files(kind, str(folder))
    for name, text in files.items():
        (folder / name).write_text(text, "utf-8")
    return read_project(folder / "project.toml", mechanism=function_of(files))


def simulated(project: Project, seed: int) -> Simulation:
    spec = project.simulation
    assert spec is not None
    if spec.grid:
        poses = grid_poses({name: span.values for name, span in spec.ranges.items()})
    else:
        ranges = {name: (span.start, span.stop) for name, span in spec.ranges.items()}
        poses = random_poses(ranges, spec.poses, seed=seed)
    draw = np.random.default_rng(seed)
    truth = {p.name: p.nominal for p in project.mechanism.parameters} | dict(spec.truth)
    truth |= {name: truth[name] + sd * draw.normal() for name, sd in spec.perturb.items()}
    noise = spec.noise.noise()
    return simulate(project.mechanism, poses, noise=noise, seed=seed, truth=truth)


@pytest.mark.parametrize("kind", TEMPLATES)
@pytest.mark.parametrize("seed", [1, 2])
def test_its_parameters_are_identifiable_and_found(kind, seed, tmp_path):
    project = started(kind, tmp_path)
    made = simulated(project, seed)
    result = calibrate(project.mechanism, made.dataset, noise=project.noise.noise())
    assert result.status.converged
    assert result.identifiability.data_rank == len(project.mechanism.parameters.free)
    assert result.chi_squared is not None
    assert 0.001 < (result.chi_squared.p_value or 0.0) < 0.999
    for name in result.estimated:
        sd = result.sd[name]
        assert sd is not None
        assert math.isfinite(sd)
        assert abs(made.parameters[name] - result.value[name]) < 5 * sd, name


def test_a_serial_arm_would_not_be_without_its_fixed_parameters(tmp_path):
    project = started("serial", tmp_path)
    made = simulated(project, 1)
    freed = project.mechanism.with_parameters(project.mechanism.parameters.with_fixed(["*"], False))
    result = calibrate(freed, made.dataset, noise=project.noise.noise())
    assert len(freed.parameters.free) == 33
    assert result.identifiability.data_rank == 27


@pytest.mark.parametrize("kind", TEMPLATES)
def test_calibrating_before_simulating_says_what_to_do(kind, tmp_path):
    with refused("missing-file"):
        load_dataset(started(kind, tmp_path))


@pytest.mark.parametrize("kind", TEMPLATES)
def test_its_comments_show_commands_for_where_it_lies(kind):
    text = template_files(kind, "my arm")["project.toml"]
    assert "NAME/" not in text
    assert "loopcal simulate 'my arm'/project.toml" in text
    assert "loopcal calibrate 'my arm'/project.toml" in text


@pytest.mark.parametrize("kind", ["serial", "motoman-ma1400"])
def test_its_mechanism_file_stands_by_itself(kind, tmp_path):
    project = started(kind, tmp_path)
    assert read_mechanism(tmp_path / "mechanism.toml").tape == project.mechanism.tape


def test_no_folder_name_can_break_its_comments():
    text = template_files("serial", "a\nb = 'c'\r")["project.toml"]
    assert all(line.startswith("#") for line in text.split("schema = 1")[0].splitlines())


def test_another_type_names_the_nearest():
    with refused("unknown-name", "did you mean 'serial'"):
        template_files("seriel", "new")
