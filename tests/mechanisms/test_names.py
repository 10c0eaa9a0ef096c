"""Names say nothing: a machine with all names replaced by random ones is the same machine."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

import loopcal as lc
from loopcal.mechanisms.chain import Step
from loopcal.mechanisms.exponentials import ScrewJoint, exponentials
from loopcal.mechanisms.instruments.point import point
from loopcal.mechanisms.instruments.spherical import spherical
from loopcal.mechanisms.machine import Machine, assemble
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parallel.registry import PARALLEL
from loopcal.mechanisms.parameters import Gauge
from loopcal.mechanisms.planar import planar_machine
from loopcal.mechanisms.redundancy import redundant
from loopcal.mechanisms.serial import Joint, serial_machine
from loopcal.mechanisms.structure.structured import driven_joints, structured

AXES = [((0.0, 0.0, 1.0), (0.0, 0.0, 0.3)), ((0.0, 1.0, 0.0), (0.1, 0.0, 0.5))]
MACHINES = {
    **{kind: make() for kind, make in PARALLEL.items()},
    "planar": planar_machine(),
    "serial": serial_machine(
        [Joint("q1"), Joint("q2"), Joint("q3", kind="prismatic"), Joint("q4", "hayati")]
    ),
    "exponentials": exponentials([ScrewJoint(f"s{i}", *axis) for i, axis in enumerate(AXES)]),
}


class Words:
    """A new word for each old name; the same word for the same name."""

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self.new: dict[str, str] = {}

    def __call__(self, name: str) -> str:
        if name not in self.new:
            letters = self._random.choices("abcdefghijklmnopqrstuvwxyz", k=9)
            self.new[name] = "".join(letters)
        return self.new[name]


class Back(Mapping[str, Any]):
    """Values by their old names."""

    def __init__(self, values: Any, words: Words) -> None:
        self._values, self._words = values, words

    def __getitem__(self, name: str) -> Any:
        return self._values[self._words.new[name]]

    def __iter__(self) -> Iterator[str]:
        return iter(self._words.new)

    def __len__(self) -> int:
        return len(self._words.new)


def renamed(machine: Machine, words: Words) -> Machine:
    """The machine with other names of its readings and parameters."""

    def all_of(gauge: Gauge) -> Gauge:
        def changed(names: Any) -> Any:
            if isinstance(names, tuple):
                return tuple(map(changed, names))
            return words(names) if isinstance(names, str) else names

        return replace(gauge, **{f.name: changed(getattr(gauge, f.name)) for f in fields(gauge)})

    def step(s: Step) -> Step:
        return replace(
            s, parameter=s.parameter and words(s.parameter), joint=s.joint and words(s.joint)
        )

    parameters = {
        words(n): replace(p, name=words(n), owner=p.owner and words(p.owner))
        for n, p in machine.parameters.items()
    }
    return replace(
        machine,
        quantities={words(q): unit for q, unit in machine.quantities.items()},
        parameters=parameters,
        frame=lambda x, p: machine.frame(Back(x, words), Back(p, words)),
        equations=lambda x, p: machine.equations(Back(x, words), Back(p, words)),
        home={words(q): v for q, v in machine.home.items()},
        pose_constants={words(c): unit for c, unit in machine.pose_constants.items()},
        implied={words(q): v for q, v in machine.implied.items()},
        gauge=all_of(machine.gauge),
        tree=machine.tree
        and replace(
            machine.tree,
            links={
                name: replace(link, steps=tuple(map(step, link.steps)))
                for name, link in machine.tree.links.items()
            },
        ),
        lines=None,
        description={},
    )


def seen(machine: Machine, words: Words | None) -> Mechanism:
    """The machine before an instrument, with the model error that every machine may have."""
    name = words or str
    if machine.dimension == 2:
        look = point(
            readings=(name("x"), name("y")), station=name("tracker"), target=name("ball"),
            name=name("point"), dimension=2,
        )  # fmt: skip
    else:
        look = spherical(name("laser"), target=name("ball"), station=name("tracker"))
    return structured(assemble(machine, [look]), discrepancy=3)


def both(kind: str) -> tuple[Mechanism, Mechanism, Words]:
    plain = replace(MACHINES[kind], description={})
    words = Words(len(kind))
    return seen(plain, None), seen(renamed(plain, words), words), words


@pytest.mark.parametrize("kind", MACHINES)
def test_random_names_give_the_same_roles_terms_and_tables_by_owner(kind: str) -> None:
    plain, other, words = both(kind)
    for a, b in zip(plain.parameters, other.parameters, strict=True):
        assert (a.role, a.unit, a.nominal, a.prior_sd, a.fixed) == (
            b.role, b.unit, b.nominal, b.prior_sd, b.fixed,
        )  # fmt: skip
        assert words.new.get(a.owner, a.owner) == b.owner
    at = {name: i for i, name in enumerate(plain.parameters.names)}
    there = {name: i for i, name in enumerate(other.parameters.names)}
    assert [(t.name, t.sd, [at[n] for n in t.parameters]) for t in plain.terms] == [
        (t.name, t.sd, [there[n] for n in t.parameters]) for t in other.terms
    ]
    assert [words.new[q] for q in driven_joints(plain)] == driven_joints(other)
    assert plain.effects.keys() == other.effects.keys()


@pytest.mark.parametrize("kind", ["serial", "planar", "exponentials"])
def test_random_names_give_the_same_numbers(kind: str) -> None:
    plain, other, words = both(kind)
    results = []
    for mechanism, name in ((plain, str), (other, words)):
        joints = driven_joints(plain)
        q = {name(j): np.random.default_rng(1).uniform(-1.2, 1.2, 40) for j in joints}
        drawn = np.random.default_rng(2).uniform(0.1, 0.4, len(plain.parameters))
        values = {
            p.name: float(v)
            for p, v in zip(mechanism.parameters, drawn, strict=True)
            if p.nominal == 0.0 and p.role in ("placement", "mounting")
        }
        mechanism = mechanism.with_nominal(values)
        truth = {
            p.name: p.nominal + 1e-3 * float(drawn[i])
            for i, p in enumerate(mechanism.parameters)
            if p.role in ("length", "twist", "zero") and not p.fixed
        }
        noise = lc.Noise(dict.fromkeys(mechanism.quantities, 1e-5))
        made = lc.simulate(mechanism, q, noise=noise, seed=3, truth=truth)
        results.append(lc.calibrate(mechanism, made.dataset, noise=noise, method="implicit-loop"))
    a, b = results
    assert list(a.value.values()) == list(b.value.values())
    np.testing.assert_array_equal(a.covariance, b.covariance)
    assert [(t.name, t.scale) for t in a.document.terms] == [
        (t.name, t.scale) for t in b.document.terms
    ]
    assert [(p.role, words.new.get(p.owner, p.owner)) for p in a.document.parameters] == [
        (p.role, p.owner) for p in b.document.parameters
    ]


@pytest.mark.parametrize("kind", ["serial", "exponentials"])
def test_random_names_leave_the_same_parameters_redundant(kind: str) -> None:
    plain, other, _ = both(kind)
    new = dict(zip(plain.parameters.names, other.parameters.names, strict=True))
    flat = [
        replace(
            one,
            terms=(),
            parameters=one.parameters.with_prior(dict.fromkeys(one.parameters.names, np.inf)),
        )
        for one in (plain, other)
    ]
    found, there = map(redundant, flat)
    assert found
    assert [new[one.parameter] for one in found] == [one.parameter for one in there]


def test_a_name_that_suggests_another_role_changes_nothing() -> None:
    machine = replace(PARALLEL["stewart-gough"](), description={})
    words = Words(0)
    words.new |= {name: name for name in (*machine.quantities, *machine.parameters)}
    words.new |= {f"leg_{i}_offset": f"zero_leg_{i}" for i in range(1, 7)}
    plain, other = seen(machine, None), seen(renamed(machine, words), None)
    assert [(t.name, len(t.parameters)) for t in plain.terms] == [
        (t.name, len(t.parameters)) for t in other.terms
    ]
    assert "scales" in {t.name for t in other.terms}
