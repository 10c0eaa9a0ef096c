"""What the verdict finds in the readings: their sds, digits and copies, and the size they show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from loopcal.document.choice import DECISIVE
from loopcal.document.findings import ColumnFault, Outlier, OutlierTests
from loopcal.document.fit import undetected
from loopcal.document.result_document import DataEntry, ResultDocument
from loopcal.document.verdict import Fact, Figure, Where, fact
from loopcal.mechanisms.effects.effect import RUN_DRIFT, RUN_DRIFTS
from loopcal.mechanisms.structure.smooth import DISCREPANCY
from loopcal.presentation.shown import significant

# Record 0054.
RARE = 1e-3
"""p-value of a single test from which a result is not sound: several tests are made."""
# Half as large in sd, a quarter in the square.
LOOSE = 0.25
"""Chi-squared per degree of freedom of sds twice as large as the readings show."""
# Chosen, not derived: 3 mm of a metre, more than the noise of any instrument here.
SIZE = 3e-3
"""Relative sd of a size that only priors determine from which on its bias counts."""
# As the changes that may move the end point: record 0054.
UNSURE = 0.5
"""Stated sds by which a drift along ordered poses may move what it moves, rms over the run."""
# Chosen, not derived: half way to 1.5, from which the gauntlet counts a stated sd as wrong.
LITTLE = 1.25
"""Times by which predictions may be less sure, at the upper bounds of sds that were learnt as 0."""
# Chosen, not derived: three of 44 clean sets of the gauntlet have 1.3 to 1.7, and err as stated.
FAR = 2.0
"""The same of sds that were not learnt as 0, but may be."""
# The 95 % point of half of chi-squared(1), as a variance of 0 is at the boundary.
SUGGESTED = 2.71
"""Gain in -2 log restricted likelihood from which readings suggest that a drift is there."""
# Chosen, not derived: one good data set of a hundred; `analyses.gauntlet` counts all codes.
_CHANCE = 0.01
"""Share of good data sets with a pose so far off; the search for outliers names more."""
# Chosen, not derived: gross errors of a run are a few in a hundred.
_MANY = 0.25
"""Share of the poses from which on those that do not fit are no single mistakes."""
# Record 0054; `analyses.residual_outliers` counts the good poses that are named.
_UNLIKE = 1.5
"""Where residuals are the scale, a good pose may have so many times the usual variance: errors of
joints act through lever arms of unlike length. The log of a p-value falls in proportion."""


@dataclass(frozen=True)
class Readings:
    """What was found out about the readings of a calibration, or of another day.

    faults: of whole columns; tests: of the outliers, None where none were sought.
    """

    data: DataEntry
    faults: Sequence[ColumnFault]
    outliers: Sequence[Outlier]
    tests: OutlierTests | None

    @classmethod
    def of(cls, document: ResultDocument) -> Readings:
        """Of a calibration."""
        faults, outliers = document.column_faults or (), document.outliers or ()
        return cls(document.data, faults, outliers, document.outlier_tests)

    def facts(self) -> list[Fact]:
        """Faults of the file, outliers, copies, coarse digits and repeats, where there are any."""
        rows = self._rows_copied(), self._coarse(), self._averaged()
        return [one for one in (self._column_fault(), self._outliers(), *rows) if one is not None]

    def _column_fault(self) -> Fact | None:
        words = "; ".join(fault.words for fault in self.faults)
        place = Where(readings=tuple(dict.fromkeys(q for f in self.faults for q in f.quantities)))
        return fact("column-fault", place, faults=words) if self.faults else None

    def _outliers(self) -> Fact | None:
        """As in `find_outliers`, half of the level goes to the poses and half to their readings."""
        poses = 0 if self.tests is None else self.tests.poses
        by_residuals = self.tests is not None and self.tests.by_residuals
        # Bonferroni, over the poses and over all their readings.
        whole = 0.5 * _CHANCE / poses if poses else 1.0
        single = whole / max(len(self.data.quantities), 1) if poses else 1.0
        if by_residuals:
            whole, single = whole**_UNLIKE, single**_UNLIKE
        corners = [entry.pose for entry in self.outliers if entry.unit == "px"]
        named = [
            entry.pose
            for entry in self.outliers
            if entry.unit != "px" and entry.p_value <= (whole if entry.quantity is None else single)
        ]
        bad = tuple(dict.fromkeys(named))
        # Too few poses are left to tell: any few can be fitted exactly.
        few = 2 * poses < self.data.used or 2 * len(bad) > poses
        if by_residuals and few:
            bad = ()
        bad = tuple(dict.fromkeys([*self.data.discarded, *bad]))
        every = self.data.used + len(self.data.discarded)
        many = len(bad) > _MANY * every
        count = [] if not bad else [f"{len(bad)} poses" if len(bad) > 1 else "1 pose"]
        if corners:
            images = len(set(corners))
            count.append(
                f"{len(corners)} corner{'s' * (len(corners) > 1)} in {images} "
                f"image{'s' * (images > 1)}"
            )
        if not count:
            return None
        several = len(count) > 1 or len(bad) > 1 or len(corners) > 1
        bad = tuple(dict.fromkeys([*bad, *corners]))
        gone = "; left out of the fit" if set(bad) <= {*self.data.discarded} else ""
        return fact(
            "outliers-many" if many else "outliers",
            Where(poses=bad),
            {"poses": len(bad)},
            named=", ".join(bad[:5]) + (", ..." if len(bad) > 5 else "") + gone,
            count=" and ".join(count) + (" do" if several else " does"),
            every=str(every),
        )

    def _rows_copied(self) -> Fact | None:
        copied = self.data.copied
        if not copied:
            return None
        return fact("rows-copied", numbers={"rows": len(copied)}, copied=self.data.warnings()[0])

    def _averaged(self) -> Fact | None:
        """Repeats that share an error."""
        count = len(self.data.averaged)
        words = f"{count} rows repeat" if count > 1 else "1 row repeats"
        return fact("repeats-averaged", numbers={"rows": count}, repeats=words) if count else None

    def _coarse(self) -> Fact | None:
        """Readings recorded in steps that are not small against their sds."""
        steps = self.data.coarse
        if not steps:
            return None
        numbers = {"sd": max(one.sd for one in steps)}
        return fact("readings-coarse", numbers=numbers, quantities="; ".join(map(str, steps)))


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


def not_detectable(document: ResultDocument) -> Fact | None:
    """Sensors whose learnt sd may be 0, where their upper bounds would make predictions less sure.

    Noise that is below what the other readings show comes out as 0 in half of all draws. Nothing
    follows from that where the bounds say that it is small in what is predicted as well.
    """
    every = undetected(document.noise)
    names = tuple(q for e in every for q in e.quantities)
    region = document.region
    by = () if region is None else region.by
    stated = [one for one in by if one.unit != "px"] or by
    at_bounds = [(one.sd_at_bounds or math.inf) / one.sd_at_poses for one in stated]
    most = FAR if any(e.sd for e in every) else LITTLE
    if not names or max(at_bounds, default=math.inf) <= most:
        return None
    return fact("sd-not-detectable", Where(readings=names))


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
    if changes is not None and all(point.imitated for point in changes.found):
        unsure = changes.found or (changes.unsure if document.terms else ())
        if unsure:
            likely = min(unsure, key=lambda point: point.p_value)
            what = f": {likely.what}" if likely.imitated else f" near pose {likely.pose}"
            place, evidence = Where(poses=(likely.pose,)), {"evidence": likely.p_value}
            return fact("change-or-model", place, evidence, what=what)
    if chosen is None or depends is None or depends.serial:
        return None
    alike = next((one.serial for one in chosen.over if one.serial), None)
    effect_terms = [t for t in document.terms if t.effects and not t.name.startswith(DISCREPANCY)]
    if alike is None or any((t.gain or 0.0) >= DECISIVE for t in effect_terms):
        return None
    return fact("drift-or-model", numbers={"evidence": alike.correlation})


def drift_or_machine(document: ResultDocument) -> Fact | None:
    """A drift of the instrument that the poses cannot tell from an error of the machine.

    It is among the parameters only where the joints tell the order of the poses (`run_drift`). What
    the readings say of it is stated, and closes nothing: a machine can take up what they would say.
    """
    region = document.region
    for by in () if region is None else region.by:
        drifts = [p for p in document.parameters if (p.owner, p.unit) == (RUN_DRIFT, by.unit)]
        # From -1/2 to 1/2 of it over the run: 1/sqrt(12) of it rms, in each of three coordinates.
        sd = max((p.sd or 0.0 for p in drifts), default=0.0) * math.sqrt(min(len(drifts), 3) / 12.0)
        if sd > UNSURE * by.sd_at_poses:
            numbers = {"sd": Figure(sd, by.unit), "stated": Figure(by.sd_at_poses, by.unit)}
            terms = [t for t in document.terms if t.name in RUN_DRIFTS and t.unit == by.unit]
            suggested = any(t.gain is None or t.gain >= SUGGESTED for t in terms)
            suggest = "suggest" if suggested else "do not suggest"
            return fact("drift-or-machine", numbers=numbers, suggest=suggest)
    return None


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
