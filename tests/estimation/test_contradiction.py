"""Readings stated as exact that contradict each other are named, with their misfit."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import loopcal as lc
from tests.reference.simulated import planar_arm

ARM = planar_arm(30)
QUANTITIES, OUTPUTS = tuple(ARM.exact), ARM.truth.outputs
DATA = ARM.read(dict.fromkeys(QUANTITIES, 1e-3), 1)
SUBSETS = [s for n in range(1, 5) for s in combinations(QUANTITIES, n)]


def closes(exact: tuple[str, ...]) -> bool:
    """Whether two loops have two readings left that move them independently."""
    return len(QUANTITIES) - len(exact) >= 2


def sds(exact: tuple[str, ...]) -> dict[str, float]:
    return {q: 0.0 if q in exact else 1e-3 for q in QUANTITIES}


@pytest.fixture(scope="module")
def misfit() -> str:
    """Of least squares, as messages write it."""
    accuracy = lc.calibrate(ARM.truth, DATA, method="least-squares").accuracy_after
    assert accuracy is not None
    return f"{1e3 * accuracy.rms:.2f} mm rms"


@pytest.mark.parametrize("method", ["implicit-loop", "reweighted"])
@pytest.mark.parametrize("exact", SUBSETS, ids="-".join)
def test_a_contradiction_is_named_with_quantities_and_size(
    exact: tuple[str, ...], method: str, misfit: str
) -> None:
    if closes(exact):
        if method == "implicit-loop":
            result = lc.calibrate(ARM.truth, DATA, noise=sds(exact), method=method)
            assert result.status.converged
        return
    with pytest.raises(lc.InputError) as caught:
        lc.calibrate(ARM.truth, DATA, noise=sds(exact), method=method)
    assert caught.value.code == "exact-readings"
    assert all(repr(q) in caught.value.message for q in exact)
    assert misfit in caught.value.message


@pytest.mark.parametrize("exact", [QUANTITIES, QUANTITIES[1:], OUTPUTS], ids="-".join)
def test_the_verdict_of_a_choice_names_it_and_claims_no_ratio(
    exact: tuple[str, ...], misfit: str
) -> None:
    result = lc.calibrate(ARM.truth, DATA, noise=sds(exact))
    sound = lc.verdict(result).sound
    assert "times too" not in str(result)
    if closes(exact):
        assert sound.code != "sds-overruled"
        return
    assert (sound.passed, sound.code, sound.number) == (None, "sds-overruled", None)
    assert all(repr(q) in sound.words for q in exact)
    assert misfit in sound.words


def test_sds_of_zero_in_some_poses_are_named_too() -> None:
    some = {q: np.where(np.arange(30) < 4, 0.0, 1e-3) for q in QUANTITIES}
    with pytest.raises(lc.InputError, match="the loops of 4 poses"):
        lc.calibrate(ARM.truth, DATA, noise=some, method="reweighted")


def test_a_check_expects_no_sds_of_exact_readings() -> None:
    with pytest.raises(lc.InputError) as caught:
        lc.check(ARM.truth, DATA, noise=sds(QUANTITIES))
    assert caught.value.code == "exact-readings"


def test_loops_without_outputs_are_named_by_their_values() -> None:
    bare = lc.Mechanism.from_function(
        lambda x, p: (x.a * p.k - x.b,), {"a": "1", "b": "1"}, {"k": (1.0, "1")}
    )
    data = {"a": [1.0, 2.0, 3.0, 4.0, 5.0], "b": [1.1, 1.9, 3.1, 3.9, 5.1]}
    with pytest.raises(lc.InputError, match=r"'a', 'b' are stated as exact.*loop values of 0\.0"):
        lc.calibrate(bare, data, noise={"a": 0.0, "b": 0.0}, method="implicit-loop")
