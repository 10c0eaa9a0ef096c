"""What is said about the sensors becomes one sd for every reading, and says so when it cannot."""

from __future__ import annotations

import math
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from loopcal.errors import Code, InputError
from loopcal.measurements.dataset import Dataset
from loopcal.measurements.datasheet import DatasheetSd
from loopcal.measurements.noise import Noise, ReadingUncertainty, resolve_noise
from tests.refusals import refused

Array = NDArray[np.float64]
QUANTITIES = ("t1", "t2", "x", "y", "z")
POSES = 4


def expand(key: str) -> tuple[str, ...]:
    """As a mechanism does it: names, globs, and the joined names of the outputs."""
    if key == "xyz":
        return ("x", "y", "z")
    found = tuple(q for q in QUANTITIES if fnmatchcase(q, key))
    if not found:
        raise InputError(f"no quantity is called {key!r}")
    return found


def data(**changes: Any) -> Dataset:
    readings = {q: np.arange(POSES) + 0.5 for q in QUANTITIES} | changes.pop("readings", {})
    return Dataset.from_arrays(readings, **changes)


def resolved(entries: Any, dataset: Dataset | None = None) -> ReadingUncertainty:
    return resolve_noise(Noise(entries), dataset or data(), QUANTITIES, expand)


def rows(uncertainty: ReadingUncertainty) -> list[list[float]]:
    return np.broadcast_to(uncertainty.sd, (len(QUANTITIES), POSES)).tolist()


ALL: dict[Any, Any] = {"*": 1.0}


def test_names_globs_and_groups_say_one_sd() -> None:
    found = resolved({"t*": 1e-3, "xyz": 1e-5})
    assert found.sd.shape == (5, 1)
    assert found.sd.ravel().tolist() == [1e-3, 1e-3, 1e-5, 1e-5, 1e-5]
    assert found.blocks == ()
    assert found.sources == ("given",) * 5


def test_later_entries_win() -> None:
    assert resolved({**ALL, "t?": 2.0, "t2": 3.0}).sd.ravel().tolist() == [2, 3, 1, 1, 1]
    assert resolved({"t2": 3.0, "t?": 2.0, "*": 1.0}).sd.ravel().tolist() == [1] * 5


def test_a_further_learnt_sd_leaves_the_rest_as_it_was() -> None:
    noise = Noise({"*": DatasheetSd(1e-4)})
    more = noise.with_learnt("model", 1e-3)
    assert more.entries["model"] == 1e-3
    assert more.estimate == {"model": "group"}
    assert more.by_maker == frozenset({"*"})
    assert noise.estimate == {}


def test_roles_are_told_by_nought_and_infinity() -> None:
    found = resolved({**ALL, "t1": 0.0, "z": math.inf})
    assert found.sd.ravel().tolist() == [0.0, 1.0, 1.0, 1.0, math.inf]


def test_an_array_is_an_sd_per_reading() -> None:
    found = resolved({**ALL, "t1": [1.0, 2.0, 0.0, math.inf]})
    assert found.sd.shape == (5, POSES)
    assert rows(found)[0] == [1.0, 2.0, 0.0, math.inf]
    assert rows(found)[1] == [1.0] * 4


def test_a_missing_reading_is_unmeasured_in_its_pose() -> None:
    found = resolved(ALL, data(readings={"x": [1.0, math.nan, 3.0, math.nan]}))
    assert rows(found)[2] == [1.0, math.inf, 1.0, math.inf]
    assert rows(found)[3] == [1.0] * 4


def test_readings_keep_the_sds_they_came_with() -> None:
    found = resolved({**ALL, "x": 5.0}, data(sds={"x": [0.1, 0.2, 0.3, 0.4], "t1": [0.0] * 4}))
    assert rows(found)[2] == [0.1, 0.2, 0.3, 0.4]
    assert rows(found)[0] == [0.0] * 4
    assert found.sources == ("reading", "given", "reading", "given", "given")


def test_an_entry_serves_the_readings_without_an_sd_of_their_own() -> None:
    own = data(readings={"x": [1.0, math.nan, 3.0, 4.0]}, sds={"x": [0.1, math.nan, 0.3, 0.4]})
    assert rows(resolved({**ALL, "x": 5.0}, own))[2] == [0.1, math.inf, 0.3, 0.4]


def test_a_covariance_belongs_to_a_tuple_of_names() -> None:
    covariance = np.array([[4.0, 1.0], [1.0, 9.0]])
    found = resolved({**ALL, ("x", "z"): covariance})
    (block,) = found.blocks
    assert block.indices == (2, 4)
    assert block.factor @ block.factor.T == pytest.approx(covariance)
    assert found.sd.ravel().tolist() == [1.0, 1.0, 2.0, 1.0, 3.0]


def test_a_covariance_may_differ_from_pose_to_pose() -> None:
    covariances = np.array([[[v, 0.1], [0.1, 2 * v]] for v in (1.0, 4.0, 9.0, 16.0)])
    found = resolved({**ALL, ("x", "z"): covariances})
    (block,) = found.blocks
    assert block.factor.shape == (POSES, 2, 2)
    assert block.factor @ block.factor.transpose(0, 2, 1) == pytest.approx(covariances)
    assert rows(found)[2] == [1.0, 2.0, 3.0, 4.0]


def test_the_order_of_names_is_the_order_of_rows() -> None:
    (block,) = resolved({**ALL, ("z", "x"): np.diag([9.0, 4.0])}).blocks
    assert block.indices == (4, 2)


def test_a_covariance_may_be_singular_or_nought() -> None:
    singular = np.outer([1.0, 2.0], [1.0, 2.0])
    (block,) = resolved({**ALL, ("x", "y"): singular}).blocks
    assert block.factor @ block.factor.T == pytest.approx(singular)
    (block,) = resolved({**ALL, ("x", "y"): np.zeros((2, 2))}).blocks
    assert block.factor.tolist() == [[0.0, 0.0], [0.0, 0.0]]


def test_a_later_sd_dissolves_the_block_it_touches() -> None:
    found = resolved({**ALL, ("x", "y"): np.array([[4.0, 1.0], [1.0, 9.0]]), "y": 5.0})
    assert found.blocks == ()
    # the other keeps its own variance
    assert found.sd.ravel().tolist() == [1.0, 1.0, 2.0, 5.0, 1.0]


def test_a_later_block_takes_quantities_from_an_earlier_one() -> None:
    found = resolved({**ALL, ("x", "y"): np.diag([4.0, 9.0]), ("y", "z"): np.diag([1.0, 16.0])})
    assert [block.indices for block in found.blocks] == [(3, 4)]


def test_a_stated_covariance_stands_above_the_readings_own_sds() -> None:
    own = data(sds={"x": [0.1] * 4})
    found = resolved({**ALL, ("x", "y"): np.diag([4.0, 9.0])}, own)
    assert [block.indices for block in found.blocks] == [(2, 3)]
    assert found.sources[2] == "given"


def test_a_quantity_without_a_column_can_only_be_unmeasured() -> None:
    columns = {q: np.ones(POSES) for q in QUANTITIES if q != "z"}
    without = Dataset.from_arrays(columns)
    assert resolved({**ALL, "z": math.inf}, without).sd[4].tolist() == [math.inf]
    with refused("missing-reading", "'z'", "sd inf"):
        resolved(ALL, without)


@pytest.mark.parametrize(
    ("entries", "code", "stated"),
    [
        ({"t*": 1.0}, "missing-sd", ("'x'", "0")),
        ({**ALL, "w": 1.0}, "invalid-value", ("'w'",)),
        ({**ALL, ("x", "w"): np.eye(2)}, "invalid-value", ("'w'",)),
        ({**ALL, "x": [1.0, 2.0, 3.0]}, "wrong-shape", ("'x'", "3", "4")),
        ({**ALL, ("x", "y"): np.ones((3, 1, 1)) * np.eye(2)}, "wrong-shape", ("3", "4", "'x'")),
        ({**ALL, "x": [1.0, math.nan, 3.0, 1.0]}, "missing-sd", ("1", "'x'", "'2'")),
    ],
)
def test_what_cannot_be_resolved_is_named(
    entries: Any, code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        resolved(entries)


@pytest.mark.parametrize(
    ("entries", "code", "stated"),
    [
        ({"x": -1.0}, "invalid-value", ("'x'", "-1")),
        ({"x": [1.0, -2.0]}, "invalid-value", ("'x'", "-2")),
        ({"x": math.nan}, "invalid-value", ("'x'",)),
        ({"x": "small"}, "invalid-value", ("'x'", "'small'")),
        ({"x": None}, "invalid-value", ("'x'",)),
        ({"x": np.eye(2)}, "wrong-shape", ("'x'", "2")),
        ({("x", "y"): 1.0}, "invalid-covariance", ("'x'", "'y'")),
        ({("x", "y"): np.eye(3)}, "invalid-covariance", ("3", "2", "'x'")),
        ({("x", "y"): [[1.0, 0.5], [0.4, 1.0]]}, "invalid-covariance", ("'x'",)),
        ({("x", "y"): [[1.0, 2.0], [2.0, 1.0]]}, "invalid-covariance", ("-1", "'x'")),
        ({("x", "y"): [[1.0, 0.0], [0.0, math.inf]]}, "invalid-covariance", ("'x'",)),
        ({("x", "y"): [[1.0, math.nan], [math.nan, 1.0]]}, "invalid-covariance", ("'x'",)),
    ],
)
def test_what_is_no_sd_and_no_covariance_is_named(
    entries: Any, code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        Noise(entries)


@pytest.mark.parametrize("key", [3, None, ("x", 3)])
def test_what_is_no_name_is_refused_as_a_key(key: Any) -> None:
    with refused("invalid-value", repr(key)):
        Noise({key: 1.0})
    with refused("invalid-value", repr(key)):
        Noise({"*": 1.0}, estimate={key: "each"})


def test_noise_is_a_value() -> None:
    matrix = np.diag([1.0, 4.0])
    noise = Noise({"t*": 1e-3, ("x", "y"): matrix, "z": [1.0, 2.0]})
    matrix[0, 0] = 99.0  # a copy was taken
    assert noise == Noise({"t*": 1e-3, ("x", "y"): np.diag([1.0, 4.0]), "z": [1.0, 2.0]})
    assert noise != Noise({("x", "y"): np.diag([1.0, 4.0]), "t*": 1e-3, "z": [1.0, 2.0]})
    assert noise != Noise({"t*": 2e-3, ("x", "y"): np.diag([1.0, 4.0]), "z": [1.0, 2.0]})
    assert repr(noise) == "Noise({'t*': 0.001, ('x', 'y'): covariance (2, 2), 'z': sd (2,)})"
    with pytest.raises(ValueError, match="read-only"):
        noise.entries["z"][0] = 5.0
