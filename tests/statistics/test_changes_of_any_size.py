"""Whatever changed, and by how much: a check and an update end in an answer or in a refusal."""

from __future__ import annotations

import math
from contextlib import suppress
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import loopcal as lc
from analyses.instruments import setup
from loopcal.arrays import Array
from loopcal.errors import InputError, NoTrustworthyResult
from loopcal.statistics import another_day
from loopcal.statistics.innovation import Linearised
from loopcal.statistics.replacing import Replaced, _Search, replaced
from tests.reference.simulated import planar_arm
from tests.statistics.test_comparison import sds_of
from tests.statistics.test_rigid_motion import EXACT, TERMS, calibrated, machine, noise_of, seen

KINDS = [
    ("gantry", "gears"),
    ("transitions", "sag"),
    ("URDF", "compliance"),
    ("delta", "gears"),
    ("six-axis two trackers, two reflectors", "sag"),
    ("two-link pose", "discrepancy"),
]


@pytest.mark.parametrize("draw", range(4))
def test_a_change_of_any_size_ends_in_an_answer_or_a_refusal(draw: int) -> None:
    """One draw as it was read, and one of each fault besides; NumPy's warnings are errors here.

    An update verifies first.
    """
    arm, rng = planar_arm(20), np.random.default_rng([7, draw])
    noise = lc.Noise(sds_of(arm))
    first = lc.calibrate(arm.truth, arm.read(sds_of(arm), 1), noise=noise, method="implicit-loop")
    data = arm.read(sds_of(arm), 2)
    joints = {q: data.readings[q] for q in ("phi2", "phi3")}
    names = rng.choice([*arm.values], size=2, replace=False)
    off = {n: arm.values[n] + rng.normal() * 10.0 ** rng.uniform(-4, 6) for n in names}
    day = lc.simulate(arm.truth.with_nominal(off), joints, noise=noise, seed=draw)
    readings = dict(day.dataset.readings)
    if draw == 1:  # millimetres taken for metres, and half a turn
        readings |= {q: 1e3 * readings[q] for q in ("xP", "yP")}
        readings["phi2"] = readings["phi2"] + math.pi
    if draw == 2:
        readings |= {q: rng.permutation(readings[q]) for q in ("xP", "yP")}
    if draw == 3:
        readings |= {q: 0.0 * readings[q] for q in ("xP", "yP")}
    with suppress(InputError, NoTrustworthyResult):
        lc.update(first, lc.Dataset.from_arrays(readings))


@pytest.mark.parametrize(("name", "term"), KINDS)
def test_so_does_a_change_of_any_machine(name: str, term: str) -> None:
    """Of its dimensions, its placement and mounting, or of the zero of a reading."""
    given = machine(name)
    known = calibrated(TERMS[term](given.truth))
    made, rng = known.mechanism, np.random.default_rng([11, len(name), len(term)])
    rows = seen(made, given.driven)
    own = {p.name: p.nominal for p in made.parameters if not p.fixed}
    size = float(10.0 ** rng.uniform(-4, 6))
    changed = str(rng.choice([*own]))
    there = rows
    with suppress(InputError, NoTrustworthyResult):  # as far as such a machine can be built
        there = seen(made.with_nominal({changed: own[changed] + size}), given.driven)
    reading = str(rng.choice([*rows]))
    ends = [there, rows | {reading: rows[reading] + size}, rows | {reading: 0.0 * rows[reading]}]
    noise = noise_of(made, rows)
    for readings in ends:
        with suppress(InputError, NoTrustworthyResult):
            lc.verify(known, lc.Dataset.from_arrays(readings), noise=noise)
    with suppress(InputError, NoTrustworthyResult):
        lc.update(known, lc.Dataset.from_arrays(there).take(np.arange(8)), noise=noise)


@pytest.mark.parametrize("draw", range(2))
@pytest.mark.parametrize(
    "name", ["six-axis draw-wire", "six-axis socket", "six-axis ball-bar", "two-link line"]
)
def test_so_does_a_change_where_wires_and_contacts_close_loops(name: str, draw: int) -> None:
    given = setup(name)
    known = calibrated(given.truth)
    made, rng = known.mechanism, np.random.default_rng([13, len(name), draw])
    driven = {q: v[:12] for q, v in given.driven.items()}
    start = {q: v[:12] if np.ndim(v) else v for q, v in given.start.items()}

    def readings(mechanism: lc.Mechanism) -> dict[str, Any]:
        exact = lc.simulate(mechanism, driven, noise=EXACT, seed=0, start=start).dataset
        return {q: v for q, v in exact.readings.items() if q not in given.unread}

    rows = readings(made)
    own = {p.name: p.nominal for p in made.parameters if not p.fixed}
    size = float(10.0 ** rng.uniform(-4, 6))
    changed, reading = str(rng.choice([*own])), str(rng.choice([*rows]))
    there = rows | {reading: rows[reading] + size}
    if draw:
        with suppress(InputError, NoTrustworthyResult):  # as far as such a machine can be built
            there = readings(made.with_nominal({changed: own[changed] + size}))
    with suppress(InputError, NoTrustworthyResult):  # an update verifies first
        lc.update(known, lc.Dataset.from_arrays(there), noise=noise_of(made, rows))


@pytest.mark.parametrize("name", ["two links", "3-RRR", "six-axis spherical"])
def test_a_misfit_that_no_change_explains_is_stated_without_a_cause(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Readings in another order: each candidate is placed a few times and then left."""
    given = machine(name)
    known = calibrated(given.truth)
    rows = seen(known.mechanism, given.driven)
    noise = noise_of(known.mechanism, rows)
    output = next(q for q in known.mechanism.outputs if q in rows)
    order = np.random.default_rng(5).permutation(len(rows[output]))
    calls = []

    def counted(*args: Any, **how: Any) -> Replaced:
        calls.append(1)
        return replaced(*args, **how)

    monkeypatch.setattr(another_day, "replaced", counted)
    data = lc.Dataset.from_arrays(rows | {output: rows[output][order]})
    found = lc.verify(known, data, noise=noise)
    assert found.verdict["consistent"].passed is False
    assert found.calibrated is not None
    assert found.calibrated.max > 1e-2
    if found.faults:
        assert found.verdict["consistent"].code == "column-fault"
        return
    assert found.changes is not None
    assert found.changes.found == ()
    assert len(calls) < 4 * len(found.changes.candidates)


@pytest.mark.parametrize(
    ("size", "left", "tried"),
    [(1e4, 0.9995, 11), (1e4, 0.95, 101), (17.0, 0.9995, 101)],
    ids=["gross and slow", "gross and quick", "less gross and slow"],
)
def test_a_gross_misfit_that_hardly_falls_is_left(size: float, left: float, tried: int) -> None:
    """Equations of one parameter whose misclosure each step leaves but for a share."""
    asked = []

    def at(values: Array, near: object = None) -> SimpleNamespace:
        asked.append(values)
        e = size * left**values
        return SimpleNamespace(parameters=values, e=e, J=e[:, None], merit=float(e @ e))

    _Search.lowest(cast("_Search", SimpleNamespace(at=at, _free=[0])), np.zeros(1))
    assert len(asked) == tried


def test_what_the_machine_explains_of_a_column_leaves_a_positive_square() -> None:
    """Columns that the covariance S = 1 + A A^T explains but for a share of 1e-20."""
    rng = np.random.default_rng(0)
    A = 1e10 * rng.normal(size=(30, 4))
    none = np.zeros((30, 0))
    nowhere = cast("Replaced", None)  # squares are of the equations alone
    slopes = np.zeros((0, 4, 4))
    system = Linearised(nowhere, np.zeros(30), none, A, np.eye(4), none.T, 0, 1.0, slopes, np.inf)
    columns = A @ rng.normal(size=(4, 3))
    G = system.weighed(columns, columns)
    exact = np.linalg.lstsq(A, columns, rcond=None)[0]
    assert (np.linalg.eigvalsh(G) > 0.0).all()
    assert np.diag(G) == pytest.approx(np.square(exact).sum(axis=0), rel=1e-4)


def test_searches_of_a_day_begin_where_the_first_one_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    """No points say where a wire's anchor stands: a few random starts are for the day, not for
    every candidate."""
    given = setup("six-axis draw-wire")
    known = calibrated(given.truth)
    driven = {q: v[:12] for q, v in given.driven.items()}
    start = {q: v[:12] if np.ndim(v) else v for q, v in given.start.items()}
    exact = lc.simulate(known.mechanism, driven, noise=EXACT, seed=0, start=start).dataset
    rows = {q: v for q, v in exact.readings.items() if q not in given.unread}
    reading = next(q for q in rows if q not in driven)
    far = lc.Dataset.from_arrays(rows | {reading: rows[reading] + 100.0})
    searches: list[int] = []
    lowest = _Search.lowest

    def counted(self: _Search, *args: Any) -> Replaced:
        searches.append(1)
        return lowest(self, *args)

    monkeypatch.setattr(_Search, "lowest", counted)
    places: list[int] = []

    def placings(*args: Any, **how: Any) -> Replaced:
        places.append(1)
        return replaced(*args, **how)

    monkeypatch.setattr(another_day, "replaced", placings)
    found = lc.verify(known, far, noise=noise_of(known.mechanism, rows))
    assert found.verdict["consistent"].passed is False
    assert len(searches) <= 3 * len(places) + 10
