"""What the verdict finds in the readings: their sds, digits and copies, and the size they show."""

from __future__ import annotations

from loopcal.document.judgement import Fact, Where, fact
from loopcal.document.result_document import ResultDocument
from loopcal.document.terms import DECISIVE
from loopcal.mechanisms.structure.structured import DISCREPANCY
from loopcal.presentation.rounding import significant

# Record 0054.
RARE = 1e-3
"""p-value of a single test from which a result is not sound: several tests are made."""
# Half as large in sd, a quarter in the square.
LOOSE = 0.25
"""Chi-squared per degree of freedom of sds twice as large as the readings show."""
# Chosen, not derived: 3 mm of a metre, more than the noise of any instrument here.
SIZE = 3e-3
"""Relative sd of a size that only priors determine from which on its bias counts."""


def suspects(document: ResultDocument) -> str:
    """The sensors whose corrections are largest beside their redundancy, where some stand out."""
    tested = [e for e in document.noise if e.variance_factor]
    largest = max((e.variance_factor or 0.0 for e in tested), default=0.0)
    named = [e for e in tested if (e.variance_factor or 0.0) > 0.5 * largest]
    if len(named) == len(tested):
        return ""
    names = ", ".join(q for e in named for q in e.quantities)
    return (
        f"Beside their redundancy the corrections of {names} are the largest (factor "
        f"{significant(largest, 2)})."
    )


def size_unsure(document: ResultDocument) -> Fact | None:
    """Where only priors say how large the machine is, and say it roughly."""
    weak = document.identifiability.weak_directions or ()
    lengths = [p for p in document.parameters if p.unit == "m" and p.sd and p.value]
    if not lengths or all(direction.size is None for direction in weak):
        return None
    long = max(abs(p.value) for p in lengths) / 3.0  # short ones may be known otherwise
    sure = min((p.sd or 0.0) / abs(p.value) for p in lengths if abs(p.value) >= long)
    if sure < SIZE:
        return None
    share = f"{significant(100.0 * sure, 2)} %"
    return fact("size-unsure", numbers={"relative_sd": sure}, share=share)


def coarse(document: ResultDocument) -> Fact | None:
    """Readings recorded in steps that are not small against their sds."""
    steps = document.data.coarse
    if not steps:
        return None
    numbers = {"sd": max(one.sd for one in steps)}
    return fact("readings-coarse", numbers=numbers, quantities="; ".join(map(str, steps)))


def undetected(document: ResultDocument) -> Fact | None:
    """Sensors whose learnt sd is 0."""
    zero = [e for e in document.noise if e.source == "estimated" and not e.sd]
    names = tuple(q for e in zero if e.role == "reading" for q in e.quantities)
    return fact("sd-not-detectable", Where(readings=names)) if names else None


def rows_copied(document: ResultDocument) -> Fact | None:
    """Rows that copy others."""
    data = document.data
    if not data.copied:
        return None
    return fact("rows-copied", numbers={"rows": len(data.copied)}, copied=data.warnings()[0])


def errors_beyond_sds(document: ResultDocument) -> Fact | None:
    """What a learnt error makes good: readings that err by more than the stated sds allow."""
    over = () if document.chosen is None else document.chosen.over
    most = max((one.excess or 0.0 for one in over), default=0.0)
    # LOOSE^(-1/2) = 2: the factor of the sds that LOOSE means for their squares.
    return fact("sds-made-good", numbers={"times": most}) if most >= LOOSE**-0.5 else None


def order_or_model(document: ResultDocument) -> Fact | None:
    """A smooth model error that a drift along a path would look like.

    Where a term that no drift imitates is needed, such as sag, it explains the order of the plain
    residuals. What is left beside learnt terms and changes from a pose on may be either.
    """
    chosen, depends, changes = document.chosen, document.dependence, document.change_points
    if document.terms and changes is not None and changes.unsure and not changes.found:
        edge = min(changes.unsure, key=lambda point: point.p_value)
        return fact("change-or-model", Where(poses=(edge.pose,)), {"evidence": edge.p_value})
    if chosen is None or depends is None or depends.serial:
        return None
    alike = next((one.serial for one in chosen.over if one.serial), None)
    effect_terms = [t for t in document.terms if t.effects and not t.name.startswith(DISCREPANCY)]
    if alike is None or any((t.gain or 0.0) >= DECISIVE for t in effect_terms):
        return None
    return fact("drift-or-model", numbers={"evidence": alike.correlation})


def sds_overruled(document: ResultDocument) -> Fact | None:
    """Stated sds that are wrong by far, where the choice took a candidate that does without.

    Zeros are wrong by no ratio: the readings stated as exact are named, with what they miss.
    By chi-squared of every candidate that used them: a structured model error takes up what the
    machine lacks, and where even plain candidates scatter too little, sds are too large.
    """
    if document.chosen is not None and document.chosen.contradicted:
        return fact("sds-contradicted", contradicted=document.chosen.contradicted)
    over = () if document.chosen is None else document.chosen.over
    tested = [c.chi_squared for c in over if c.chi_squared and c.chi_squared.p_value is not None]
    if not tested or over[0].chi_squared in tested:
        return None
    factors = [chi.variance_factor or 1.0 for chi in tested]
    least, most = min(factors), max(factors)
    if most >= LOOSE and least <= 1.0 / LOOSE:
        return None
    return fact(
        "sds-overruled",
        numbers={"variance_factor": least},
        times=significant(max(least, 1.0 / least) ** 0.5, 2),
        size="large" if most < LOOSE else "small",
    )
