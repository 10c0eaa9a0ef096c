"""MATLAB files: matrices, vectors, structs; format 7.3 and broken files are refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.io import savemat

from loopcal.errors import InputError
from loopcal.files.tables.readers import read_dataset
from tests.refusals import refused

MATRIX = np.random.default_rng(3).normal(size=(6, 3))


@pytest.fixture
def save(tmp_path):
    def saved(_name: str = "arm.mat", **variables: object):
        path = tmp_path / _name
        savemat(path, variables, do_compression=True)
        return path

    return saved


def test_a_matrix_by_the_number_of_its_columns(save):
    path = save(data=MATRIX)
    data = read_dataset(path, {"x": {"column": 2, "unit": "mm"}, "y": 3})
    np.testing.assert_array_equal(data["x"], MATRIX[:, 1] * 1e-3)
    np.testing.assert_array_equal(data["y"], MATRIX[:, 2])
    assert data.place(5, "y") == "arm.mat, variable 'data', row 6, column '3'"
    assert read_dataset(path).quantities == ("column_1", "column_2", "column_3")


def test_a_variable_by_name_among_others(save):
    path = save(a=MATRIX, b=2 * MATRIX)
    data = read_dataset(path, {"x": 1}, variable="b")
    np.testing.assert_array_equal(data["x"], 2 * MATRIX[:, 0])


def test_vectors_by_their_names_rows_or_columns(save):
    names = np.array(["p1", "p2", "p3"], dtype=object)
    path = save(q1=[1.0, 2.0, 3.0], q2=np.array([[4], [5], [6]]), dh=np.zeros(4), n=7.0, id=names)
    data = read_dataset(path, {"a": "q1", "b": "q2"}, pose="id")
    np.testing.assert_array_equal(data["a"], [1, 2, 3])
    np.testing.assert_array_equal(data["b"], [4, 5, 6])
    assert data.poses == ("p1", "p2", "p3")


def test_matrices_of_one_length_by_their_names(save):
    path = save(q=MATRIX, p=MATRIX.T, K=np.eye(4), t=np.arange(6.0))
    data = read_dataset(path, {"a": "q y", "b": "p z", "t": "t"})
    np.testing.assert_array_equal(data["a"], MATRIX[:, 1])
    np.testing.assert_array_equal(data["b"], MATRIX[:, 2])


def test_one_row_is_a_column_where_a_column_is_meant(save):
    np.testing.assert_array_equal(read_dataset(save(x=[1.0, 2.0]), {"x": 1})["x"], [1.0, 2.0])


def test_a_struct_of_vectors_and_an_array_of_structs(save):
    vectors = save(S={"x": [1.0, 2.0], "y": np.array([[3.0], [4.0]])})
    records = np.array([(1.0, 3.0), (2.0, 4.0)], dtype=[("x", object), ("y", object)])
    for path in (vectors, save(_name="b.mat", S=records)):
        data = read_dataset(path, {"x": "x", "y": "y"})
        np.testing.assert_array_equal(data["x"], [1.0, 2.0])
        np.testing.assert_array_equal(data["y"], [3.0, 4.0])


WRONG = {
    "vectors that differ": ({"x": [1.0, 2.0], "y": [1.0, 2.0, 3.0]}, {}, ["x has 2, y has 3"]),
    "an unknown vector": (
        {"x": [1.0, 2.0], "y": [1.0, 2.0]},
        {"columns": {"q": "z"}},
        ["'x', 'y'"],
    ),
    "an unknown variable": ({"data": MATRIX}, {"variable": "date"}, ["did you mean 'data'?"]),
    "no rows": ({"a": 1.0, "b": 2.0}, {}, ["variable = ...", "a (1×1), b (1×1)"]),
    "a cube": ({"a": np.zeros((2, 2, 2))}, {}, ["variable 'a'", "2×2×2"]),
    "complex numbers": ({"a": MATRIX + 1j}, {}, ["variable 'a'", "complex"]),
    "an infinite reading": (
        {"a": np.where(MATRIX[2, 1] == MATRIX, np.inf, MATRIX)},
        {},
        ["row 3, column '2'", "inf"],
    ),
    "text among vectors": (
        {"q": np.array(["a", "b"], dtype=object), "x": [1.0, 2.0]},
        {"columns": {"q": "q"}},
        ["row 1, column 'q'", "'a'"],
    ),
    "nothing": ({}, {}, ["no arrays"]),
}


@pytest.mark.parametrize(("variables", "options", "parts"), WRONG.values(), ids=WRONG)
def test_wrong_variables(save, variables, options, parts):
    with pytest.raises(InputError) as caught:
        read_dataset(save(**variables), **options)
    for part in ("arm.mat", *parts):
        assert part in str(caught.value)


def test_format_7_3_is_recognised_and_refused(tmp_path):
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n")
    with refused("wrong-file-type", "7.3") as caught:
        read_dataset(path)
    assert "'-v7'" in str(caught.value)


@pytest.mark.parametrize("keep", [0, 60, 150])
def test_broken_files(save, keep):
    path = save(data=MATRIX)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(InputError) as caught:
        read_dataset(path)
    assert "arm.mat" in str(caught.value)
    assert ("empty" if not keep else "MATLAB file") in str(caught.value)


def test_garbage_of_any_kind_is_refused(tmp_path):
    path = tmp_path / "arm.mat"
    random = np.random.default_rng(11)
    for size in (1, 10, 127, 128, 129, 200, 1000):
        path.write_bytes(random.bytes(size))
        with refused("wrong-file-type", "arm.mat"):
            read_dataset(path)
