"""What the verdict finds in the readings: their sds, digits and copies, and the size they show."""

from __future__ import annotations

from loopcal.document.result_document import ResultDocument
from loopcal.document.terms import DECISIVE
from loopcal.mechanisms.structure.structured import DISCREPANCY
from loopcal.presentation.rounding import significant
from loopcal.presentation.shown import chance
from loopcal.statistics.rule import LOOSE, Said

SIZE = 3e-3
"""Relative sd of a size that only priors determine from which on its bias counts."""


def first_suspects(document: ResultDocument) -> str:
    """The sensors whose corrections are largest beside their redundancy, where some stand out."""
    tested = [e for e in document.noise if e.variance_factor]
    largest = max((e.variance_factor or 0.0 for e in tested), default=0.0)
    named = [e for e in tested if (e.variance_factor or 0.0) > 0.5 * largest]
    if len(named) == len(tested):
        return ""
    names = ", ".join(q for e in named for q in e.quantities)
    return (
        f" Beside their redundancy the corrections of {names} are the largest (factor "
        f"{significant(largest, 2)})."
    )


def size_unsure(document: ResultDocument) -> Said | None:
    """Where only priors say how large the machine is, and say it roughly."""
    weak = document.identifiability.weak_directions or ()
    lengths = [p for p in document.parameters if p.unit == "m" and p.sd and p.value]
    if not lengths or all(direction.size is None for direction in weak):
        return None
    long = max(abs(p.value) for p in lengths) / 3.0  # short ones may be known otherwise
    sure = min((p.sd or 0.0) / abs(p.value) for p in lengths if abs(p.value) >= long)
    if sure < SIZE:
        return None
    return Said(
        f"Priors alone say how large the machine is, to {significant(100.0 * sure, 2)} %: these "
        "readings hardly determine it, and noise makes such a fit too small.",
        sure,
    )


def coarse(document: ResultDocument) -> Said | None:
    """Readings recorded in steps that are not small against their sds."""
    coarse = document.data.coarse
    if not coarse:
        return None
    listed = "; ".join(map(str, coarse))
    return Said(f"Readings are recorded coarsely: {listed}.", max(one.sd for one in coarse))


def undetected(document: ResultDocument) -> Said | None:
    """Sensors whose learnt sd is 0."""
    zero = [e for e in document.noise if e.source == "estimated" and not e.sd]
    names = ", ".join(q for e in zero if e.role == "reading" for q in e.quantities)
    if not names:
        return None
    return Said(f"The noise of {names} is not detectable: its learnt sd is 0.")


def rows_copied(document: ResultDocument) -> Said | None:
    """Rows that copy others."""
    said = document.data.warnings()
    return Said(said[0], float(len(document.data.copied))) if document.data.copied else None


def beyond_sds(document: ResultDocument) -> str:
    """What a learnt error makes good: readings that err by more than the stated sds allow."""
    over = () if document.chosen is None else document.chosen.over
    most = max((one.excess or 0.0 for one in over), default=0.0)
    if most < LOOSE**-0.5:
        return ""
    return (
        f"The readings err {significant(most, 2)} times as much as the stated sds allow, which a "
        "learnt error makes good: these sds are too small, or something changes from pose to pose."
    )


def order_or_model(document: ResultDocument) -> Said | None:
    """A smooth model error that a drift along a path would look like.

    Where a term that no drift imitates is needed, such as sag, it explains the order of the plain
    residuals. What is left beside learnt terms and changes from a pose on may be either.
    """
    chosen, depends, changes = document.chosen, document.dependence, document.change_points
    if document.terms and changes is not None and changes.unsure and not changes.found:
        edge = min(changes.unsure, key=lambda point: point.p_value)
        return Said(
            f"Something may have changed along the run near pose {edge.pose} (p = "
            f"{chance(edge.p_value)}). A slow drift or a smooth model error explains it as well.",
            edge.p_value,
        )
    if chosen is None or depends is None or depends.serial:
        return None
    alike = next((one.serial for one in chosen.over if one.serial), None)
    own = [t for t in document.terms if t.effects and not t.name.startswith(DISCREPANCY)]
    if alike is None or any((t.gain or 0.0) >= DECISIVE for t in own):
        return None
    return Said(
        "The instrument may drift: without a smooth model error residuals depend on the pose order "
        f"(correlation {significant(alike.correlation, 2)}). Along a path these two cannot be "
        "distinguished.",
        alike.correlation,
    )


def sds_overruled(document: ResultDocument) -> Said | None:
    """Stated sds that are wrong by far, where the choice took a candidate that does without.

    By chi-squared of every candidate that used them: a structured model error takes up what the
    machine lacks, and where even plain candidates scatter too little, sds are too large.
    """
    over = () if document.chosen is None else document.chosen.over
    tested = [c.chi_squared for c in over if c.chi_squared and c.chi_squared.p_value is not None]
    if not tested or over[0].chi_squared in tested:
        return None
    factors = [chi.variance_factor or 1.0 for chi in tested]
    least, most = min(factors), max(factors)
    if most >= LOOSE and least <= 1.0 / LOOSE:
        return None
    size = "large" if most < LOOSE else "small"
    return Said(
        "The stated sds were not used, because they are about "
        f"{significant(max(least, 1.0 / least) ** 0.5, 2)} times too {size}: with them "
        f"chi-squared per degree of freedom is {significant(least, 2)}.",
        least,
    )
