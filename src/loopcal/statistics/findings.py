"""What a calibration's own equations tell beyond the parameters: collected for file and summary."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from loopcal.document.findings import Observability, OtherOptimum, RegionEntry
from loopcal.document.result_document import ResultDocument
from loopcal.estimation.result import Result
from loopcal.estimation.solve.scratch import one_blas_thread
from loopcal.statistics.identifiability import WhatDataSay, calibration_index, what_data_say
from loopcal.statistics.observability import data_spectrum, observability
from loopcal.statistics.optima import other_optima
from loopcal.statistics.outliers import Outliers, find_outliers
from loopcal.statistics.predictor import Predictor, predictor, usual_words
from loopcal.statistics.region import Span, region_of


@dataclass(frozen=True, eq=False)
class Findings:
    """identifiability: data beside prior; observability: of the poses; predictor: or None;
    outliers: what does not fit; optima: others that fit about as well; region: where the machine
    works, and the sd there."""

    identifiability: WhatDataSay
    observability: Observability
    predictor: Predictor | None
    outliers: Outliers
    optima: tuple[OtherOptimum, ...]
    region: RegionEntry | None = None

    def added_to(self, document: ResultDocument) -> ResultDocument:
        """The document of the result with these figures."""
        return replace(
            document,
            identifiability=self.identifiability.added_to(document.identifiability),
            observability=self.observability,
            prediction=None
            if self.predictor is None
            else replace(self.predictor.entry, region=self.region),
            outliers=self.outliers.found,
            outlier_tests=self.outliers.tests,
            column_faults=self.outliers.columns,
            other_optima=self.optima,
        )

    def words(self) -> str:
        """For the summary: one line each."""
        lines = [self.observability.words(), self.identifiability.index.words()]
        if self.predictor is not None:
            lines += [
                f"prediction: {words} at 95 % of these poses"
                for words in usual_words(self.predictor.usual)
            ]
        lines += self.identifiability.words() + self.outliers.lines()
        return "\n".join(lines + [str(optimum) for optimum in self.optima])


def findings(result: Result, region: Mapping[str, Span] | None = None) -> Findings:
    """Everything that follows from the result's parameter system.

    region: quantity -> range [SI] in which the machine works, where not its joints' limits.
    """
    solution = result.solution
    with one_blas_thread():
        known = predictor(result)
        return Findings(
            what_data_say(
                result.problem,
                result.information,
                result.sd,
                calibration_index(result.problem, solution.poses, solution.equations),
                unit_sd=_unit_sd(result),
            ),
            observability(result.information, solution.poses),
            known,
            find_outliers(result),
            () if result.all_poses is not None else other_optima(result),
            None if known is None else region_of(result, known, region),
        )


def _unit_sd(result: Result) -> float | None:
    """Sd of a whitened equation: 1 by the stated sds, else from the residuals."""
    freedom = result.solution.equations - data_spectrum(result.information).rank
    variance = result.fit.solver.unit_variance(result.information.chi_squared, freedom)
    return None if variance is None else math.sqrt(variance)
