"""Parameters and priors go by name: globs, nearest names, values that cannot be."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from loopcal.errors import Code
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import Parameter, Parameters, declared, matching
from loopcal.mechanisms.prior import Prior
from loopcal.mechanisms.terms import Term
from tests.refusals import refused

LENGTHS = Parameters(
    (
        Parameter("l1", 0.5, "m"),
        Parameter("l2", 0.6, "m", prior_sd=1e-3),
        Parameter("phi1", 0.1, "rad", fixed=True),
    )
)


def machine() -> Mechanism:
    made = Mechanism.from_function(
        lambda x, p: p.l1 * x.q + p.l2 - x.y + p.phi1 * 0.0,
        {"q": "1", "y": "m"},
        {p.name: p for p in LENGTHS},
    )
    assert made.parameters == LENGTHS
    return made


def test_they_keep_their_order_and_tell_who_is_free() -> None:
    assert LENGTHS.names == ("l1", "l2", "phi1")
    assert LENGTHS.free == ("l1", "l2")
    assert [p.name for p in LENGTHS] == ["l1", "l2", "phi1"]
    assert len(LENGTHS) == 3
    assert LENGTHS["l2"].nominal == 0.6


@pytest.mark.parametrize(
    ("pattern", "names"),
    [
        ("l1", ("l1",)),
        ("l*", ("l1", "l2")),
        ("l?", ("l1", "l2")),
        ("*1", ("l1", "phi1")),
        ("l[13]", ("l1",)),
        ("*", ("l1", "l2", "phi1")),
    ],
)
def test_globs_stand_for_names_in_their_order(pattern: str, names: tuple[str, ...]) -> None:
    assert LENGTHS.matching(pattern) == names


def test_a_glob_minds_upper_and_lower_case() -> None:
    with refused("unknown-name", "'L*'"):
        LENGTHS.matching("L*")


def test_a_name_that_looks_like_a_glob_is_found_as_it_stands() -> None:
    assert matching("a[1]", ["a[1]", "a1"], "thing") == ("a[1]",)


def test_unknown_names_name_the_nearest() -> None:
    with refused("unknown-name", "'phi'", "did you mean 'phi1'"):
        LENGTHS["phi"]
    with refused("unknown-name", "'l3'", "'l1'"):
        LENGTHS.with_nominal({"l3": 0.1})
    with refused("unknown-name", "'q*'"):
        LENGTHS.with_prior({"q*": 0.1})
    with refused("unknown-name", "'q'"):
        LENGTHS.with_fixed(["q"])


def test_changes_make_new_parameters_and_later_entries_win() -> None:
    changed = LENGTHS.with_nominal({"l1": 0.7}).with_prior({"*": 0.01, "l2": 0.02})
    assert changed["l1"].nominal == 0.7
    assert [p.prior_sd for p in changed] == [0.01, 0.02, 0.01]
    assert LENGTHS["l1"].nominal == 0.5
    assert LENGTHS["l1"].prior_sd == math.inf


def test_what_does_not_change_is_the_same_object() -> None:
    changed = LENGTHS.with_prior({"l1": LENGTHS["l1"].prior_sd, "l2": 0.02})
    assert changed["l1"] is LENGTHS["l1"]
    assert changed["l2"] is not LENGTHS["l2"]


def test_fixing_and_setting_free() -> None:
    assert LENGTHS.with_fixed(["l*"]).free == ()
    assert LENGTHS.with_fixed(["*"], fixed=False).free == ("l1", "l2", "phi1")


def test_a_prior_sd_of_zero_fixes() -> None:
    fixed = LENGTHS.with_prior({"l1": 0.0})
    assert fixed["l1"].fixed
    assert fixed.free == ("l2",)


@pytest.mark.parametrize(
    ("make", "code", "stated"),
    [
        (lambda: Parameter("l", math.nan, "m"), "invalid-value", ("'l'",)),
        (lambda: Parameter("l", math.inf, "m"), "invalid-value", ("'l'",)),
        (lambda: Parameter("l", 1.0, "m", prior_sd=-1.0), "invalid-value", ("'l'", "-1.0")),
        (lambda: Parameter("l", 1.0, "m", prior_sd=math.nan), "invalid-value", ("'l'",)),
        (lambda: Parameters((Parameter("l", 1.0, "m"),) * 2), "duplicate-name", ("'l'",)),
        (lambda: LENGTHS.with_nominal({"l1": math.nan}), "invalid-value", ("'l1'",)),
        (lambda: declared({"l": ("long", "m")}), "invalid-value", ("'l'", "'long'", "'m'")),
        (lambda: declared({"l": None}), "invalid-value", ("'l'",)),
        (lambda: declared({"l": (1.0, "metre")}), "unknown-unit", ("metre",)),
        (lambda: declared({"l": (1.0, "m", "x")}), "invalid-value", ("'l'",)),
    ],
)
def test_what_cannot_be_a_parameter_is_named(
    make: Any, code: Code, stated: tuple[str, ...]
) -> None:
    with refused(code, *stated):
        make()


def test_declared_values_become_si() -> None:
    made = declared({"l": (800.0, "mm"), "a": (90.0, "deg"), "k": 2, "p": Parameter("?", 1.0, "m")})
    assert [p.name for p in made] == ["l", "a", "k", "p"]
    assert made["l"].nominal == pytest.approx(0.8)
    assert (made["l"].unit, made["a"].unit, made["k"].unit) == ("m", "rad", "1")
    assert made["a"].nominal == pytest.approx(math.pi / 2)


def test_a_prior_takes_units_and_globs_and_applies_to_parameters() -> None:
    prior = Prior({"*": math.inf, "l?": (2.0, "mm"), "phi1": (1.0, "deg")})
    applied = prior.apply(machine()).parameters
    assert applied["l1"].prior_sd == pytest.approx(2e-3)
    assert applied["phi1"].prior_sd == pytest.approx(math.radians(1.0))
    assert prior == Prior({"*": math.inf, "l?": 0.002, "phi1": math.radians(1.0)})
    assert prior != Prior({"l?": 0.002, "*": math.inf, "phi1": math.radians(1.0)})


@pytest.mark.parametrize("sd", [-1.0, math.nan, "wide", None, (-1.0, "mm")])
def test_a_prior_that_is_no_sd_is_refused(sd: Any) -> None:
    with refused("invalid-value", "'l1'"):
        Prior({"l1": sd})


def test_a_term_gives_its_parameters_its_sd() -> None:
    term = Term("lengths", ("l1", "l2"), 2e-3, words="lengths off by {scale}")
    made = machine().with_terms(term)
    assert made.terms == (term,)
    assert [p.prior_sd for p in made.parameters][:2] == [2e-3, 2e-3]


def test_a_fixed_member_of_a_term_may_have_any_prior() -> None:
    made = machine().with_terms(Term("lengths", ("l1", "l2"), 2e-3))
    one = made.with_parameters(made.parameters.with_fixed(["l2"]).with_prior({"l2": 0.0}))
    assert one.learnt_terms == made.terms
    none = one.with_parameters(one.parameters.with_fixed(["l1"]))
    assert (none.terms, none.learnt_terms) == (made.terms, ())


def test_a_group_of_a_prior_is_a_term_and_what_is_stated_later_leaves_it() -> None:
    prior = Prior({"*": math.inf, "l*": (2.0, "mm")}, estimate={"l*": "group"})
    assert prior.apply(machine()).terms == (Term("l*", ("l1", "l2"), 2e-3),)
    assert prior != Prior(prior.sds)
    later = Prior(prior.sds | {"l2": 1e-4}, estimate=prior.estimate).apply(machine())
    assert later.terms == (Term("l*", ("l1",), 2e-3),)
    assert later.parameters["l2"].prior_sd == 1e-4
    assert Prior({"l?": 1e-4}).apply(later).terms == ()


def test_terms_that_cannot_be_learnt_are_refused() -> None:
    made = machine().with_terms(Term("lengths", ("l1", "l2"), 2e-3))
    cases: list[tuple[Code, str, Callable[[], object]]] = [
        ("unknown-name", "'l3'", lambda: machine().with_terms(Term("a", ("l3",), 1.0))),
        ("wrong-unit", "'all'", lambda: machine().with_terms(Term("all", ("l1", "phi1"), 1.0))),
        (
            "duplicate-name",
            "'l1'",
            lambda: machine().with_terms(Term("a", ("l1",), 1.0), Term("b", ("l1",), 1.0)),
        ),
        (
            "duplicate-name",
            "'a'",
            lambda: machine().with_terms(Term("a", ("l1",), 1.0), Term("a", ("l2",), 1.0)),
        ),
        ("duplicate-name", "'a'", lambda: Term("a", ("l1", "l1"), 1.0)),
        ("no-free-parameter", "'a'", lambda: Term("a", (), 1.0)),
        ("invalid-value", "sd", lambda: Term("a", ("l1",), math.inf)),
        (
            "conflicting-keys",
            "'l2'",
            lambda: made.with_parameters(made.parameters.with_prior({"l2": 1e-4})),
        ),
        (
            "conflicting-keys",
            "'l1'",
            lambda: made.with_parameters(made.parameters.with_prior({"l1": math.inf})),
        ),
        ("invalid-value", "spread", lambda: Term("a", ("l1",), 1.0, 0.0)),
        ("missing-sd", "'l1'", lambda: Prior({"l1": math.inf}, estimate={"l1": "group"})),
        ("missing-sd", "'l2'", lambda: Prior({"l1": 1.0}, estimate={"l2": "group"})),
        ("unknown-name", "'each'", lambda: Prior({"l1": 1.0}, estimate={"l1": "each"})),
    ]
    for refusal, names, make in cases:
        with refused(refusal, names):
            make()
