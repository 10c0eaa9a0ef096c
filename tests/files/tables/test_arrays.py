"""NumPy files: arrays by their names, whichever way they lie; objects and damage are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import loopcal as lc
from loopcal.files.tables.readers import read_table
from tests.refusals import refused

Q, P = np.arange(24.0).reshape(4, 6), np.arange(12.0).reshape(4, 3) / 7.0


def test_a_matrix_by_the_number_of_its_columns(tmp_path: Path) -> None:
    np.save(tmp_path / "q.npy", Q)
    data = lc.read_dataset(tmp_path / "q.npy", {"x": 2})
    assert np.array_equal(data["x"], Q[:, 1])


def test_arrays_of_one_length_by_their_names(tmp_path: Path) -> None:
    turns = np.tile(np.eye(3), (4, 1, 1))
    np.savez(tmp_path / "a.npz", q=Q, p=P.T, t=np.arange(4.0), R=turns, K=np.eye(2), n=4)
    table = read_table(tmp_path / "a.npz")
    turned = [f"R{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)]
    joints = [f"q {i}" for i in range(1, 7)]
    assert table.names == (*joints, "p x", "p y", "p z", "t", *turned)
    assert np.array_equal(table.numbers(7, np.arange(4)), P[:, 1])


@pytest.mark.parametrize("content", [b"\x93NUMPY\x01\x00", b"PK\x03\x04 cut off", b"text"])
def test_damaged_files_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / ("a.npz" if content.startswith(b"PK") else "a.npy")
    path.write_bytes(content)
    with refused("wrong-file-type", path.name):
        read_table(path)


def test_objects_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{"q": 1}]), allow_pickle=True)
    with refused("wrong-file-type", "a.npy"):
        read_table(tmp_path / "a.npy")
