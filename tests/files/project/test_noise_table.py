"""Noise of a project: sds and covariances in SI, and which line wins."""

from __future__ import annotations

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.files.project.project_file import read_project
from loopcal.measurements.noise import Noise
from tests.refusals import refused

HEAD = 'schema = 1\n[mechanism]\ntype = "serial"\njoint = [{ name = "q_1" }, { name = "q_2" }]\n'


def spec(text: str):
    return read_project("-", text=f"{HEAD}[noise]\n{text}").noise


def refusal(text: str) -> InputError:
    with pytest.raises(InputError) as caught:
        spec(text)
    assert caught.value.remedy
    return caught.value


@pytest.mark.parametrize(
    ("key", "names"),
    [
        ("q_1", ["q_1"]),
        ('"q_*"', ["q_1", "q_2"]),
        ("xyz", ["x", "y", "z"]),
        ('"x, z"', ["x", "z"]),
        ('"q_*,x"', ["q_1", "q_2", "x"]),
    ],
)
def test_a_key_is_a_quantity_a_glob_all_outputs_or_a_list(key, names):
    assert spec(f"{key} = 0.5").noise() == Noise(dict.fromkeys(names, 0.5))


def test_sds_come_in_any_unit_that_fits():
    text = 'q_1 = { sd = 1, unit = "mrad" }\nxyz = { sd = 20, unit = "um" }\nq_2 = inf'
    expected = {"q_1": 1e-3, "x": 2e-5, "y": 2e-5, "z": 2e-5, "q_2": np.inf}
    found = {key: float(value) for key, value in spec(text).noise().entries.items()}
    assert found == pytest.approx(expected)


def test_later_lines_win_and_stand_later():
    found = spec('x = 1\n"*" = 2\nx = 3\n'.replace("x = 3\n", '"[x]" = 3\n')).noise()
    assert float(found.entries["x"]) == 3.0
    assert list(found.entries)[-1] == "x"


def test_a_covariance_is_in_the_square_of_its_unit():
    matrix = [[4.0, 1.0, 0.0], [1.0, 9.0, 0.0], [0.0, 0.0, 1.0]]
    found = spec(f'xyz = {{ covariance = {matrix}, unit = "mm" }}').noise()
    np.testing.assert_allclose(found.entries[("x", "y", "z")], np.array(matrix) * 1e-6)


def test_a_covariance_across_dimensions_is_si():
    found = spec('"q_1,x" = { covariance = [[1, 0.5], [0.5, 2]] }').noise()
    assert found.entries[("q_1", "x")].tolist() == [[1.0, 0.5], [0.5, 2.0]]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("xyz = { covariance = [[1, 0], [0, 1]] }", "not 3 by 3"),
        ("xyz = { covariance = [[1, 0, 0], [0, 1, 0], [0, 0]] }", "not 3 by 3"),
        ("xyz = { covariance = [[1, 2, 0], [2, 1, 0], [0, 0, 1]] }", "negative eigenvalue"),
        ("xyz = { covariance = [[1, 2, 0], [0, 9, 0], [0, 0, 1]] }", "not symmetric"),
        ("xyz = { covariance = [[nan, 0, 0], [0, 1, 0], [0, 0, 1]] }", "nan"),
        ("xyz = { sd = 1, covariance = [[1]] }", "sd and covariance is stated"),
        ('xyz = { covariance_columns = ["a", "b"] }', "2 columns"),
        ('"q_1,x" = { covariance = [[1, 0], [0, 1]], unit = "mm" }', "cannot be in mm"),
        ('"x,w" = 1', "'w'"),
        ('"" = 1', "''"),
    ],
)
def test_what_is_no_noise_is_refused(text, words):
    assert words in str(refusal(text))


def test_a_covariance_from_columns_is_none_to_simulate():
    columns = spec('xyz = { covariance_columns = ["a", "b", "c", "d", "e", "f"] }')
    assert [block.quantities for block in columns.columns] == [("x", "y", "z")]
    with refused("unsupported", "noise.xyz"):
        columns.noise()


def test_six_columns_are_the_upper_triangle_and_nine_the_rows():
    six, nine = (
        spec(f"xyz = {{ covariance_columns = {list(range(1, n + 1))}, unit = 'mm' }}").columns[0]
        for n in (6, 9)
    )
    expected = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 5.0], [3.0, 5.0, 6.0]])
    upper = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]]).T
    np.testing.assert_allclose(six.matrices(upper), expected[None] * 1e-6)
    np.testing.assert_allclose(nine.matrices(expected.reshape(9, 1)), expected[None] * 1e-6)
