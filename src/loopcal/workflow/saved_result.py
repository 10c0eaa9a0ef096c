"""A result read from its folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from loopcal.arrays import Array
from loopcal.document.fit import ChiSquared, StatusEntry
from loopcal.document.result_document import ResultDocument, WrittenResult
from loopcal.errors import InputError
from loopcal.files.machines.python_function import Loops, load_function
from loopcal.files.result.result_file import read_result as read_document
from loopcal.files.result.result_file import read_result_mechanism
from loopcal.files.result.result_poses import read_result_poses
from loopcal.lazy import cached_property
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.report.source import Source, read_source
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.predictor import Predictor, predictor_of
from loopcal.workflow.views import Views


@dataclass(frozen=True, eq=False, repr=False)
class SavedResult(Views):
    """A result as its folder holds it: `loopcal.read_result`.

    document: of result.json; path: of that file; loops: of a mechanism written in Python.
    """

    document: ResultDocument
    path: Path
    loops: Loops | Mechanism | None = field(default=None)

    @property
    def unjudged(self) -> ResultDocument:
        """The document."""
        return self.document

    @property
    def estimated(self) -> tuple[str, ...]:
        """The names of the estimated parameters, in the order of `covariance`."""
        return self.document.covariance.names

    @cached_property
    def value(self) -> Mapping[str, float]:
        """Every parameter [SI]."""
        return MappingProxyType({p.name: p.value for p in self.document.parameters})

    @cached_property
    def sd(self) -> Mapping[str, float | None]:
        """Of every parameter [SI]: None if fixed, inf if not identifiable."""
        return MappingProxyType(
            {
                p.name: np.inf if p.sd is None and not p.fixed else p.sd
                for p in self.document.parameters
            }
        )

    @cached_property
    def covariance(self) -> Array:
        """(n, n) of the estimated parameters [SI]; NaN where one is not identifiable."""
        size = len(self.estimated)
        return np.array(self.document.covariance.matrix, dtype=float).reshape(size, size)

    @property
    def chi_squared(self) -> ChiSquared | None:
        """None where the method or the loss has none."""
        return self.document.chi_squared

    @property
    def status(self) -> StatusEntry:
        """How the fit ended."""
        return self.document.status

    @property
    def corrections(self) -> Mapping[str, Array]:
        """Quantity -> (N,) estimated true values minus readings at the poses used [SI]."""
        return self.source.table.corrections

    @property
    def machine(self) -> Mechanism:
        """The calibrated mechanism."""
        return self.mechanism

    @cached_property
    def mechanism(self) -> Mechanism:
        """The calibrated mechanism. Raises InputError where mechanism.toml cannot be read."""
        return read_result_mechanism(self.path, self.document, self.loops)

    @cached_property
    def poses(self) -> Dataset | None:
        """The poses used; None where residuals.csv is not there."""
        return read_result_poses(self.path.parent, self.mechanism)

    @cached_property
    def predictor(self) -> Predictor:
        """What predictions need. Raises InputError for a result without outputs."""
        try:
            return predictor_of(self.document, self.mechanism)
        except InputError as error:
            raise error.at(str(self.path)) from None

    @cached_property
    def calibrated(self) -> Calibrated:
        """What comparisons and verifications need."""
        name = str(self.path.parent)
        return Calibrated.from_document(self.document, self.mechanism, self.poses, name)

    @cached_property
    def source(self) -> Source:
        """With what became of every reading. Raises InputError without residuals.csv."""
        return read_source(self.path)

    def save(self, folder: str | Path, **options: Any) -> WrittenResult:
        """Refused: it is saved already. Raises InputError."""
        raise InputError(
            f"this result is saved already: {self.path.parent}",
            code="unsupported",
            remedy="copy that folder",
        )

    def __repr__(self) -> str:
        state = "converged" if self.converged else self.document.status.reason
        return f"<SavedResult {self.path.parent}: {self.document.method}, {state}>"


def read_result(
    path: str | Path, *, mechanism: Loops | Mechanism | str | None = None
) -> SavedResult:
    """A result from its folder, or from the result.json in it.

    mechanism: of a result whose loops are Python code, for predictions; "FILE.py:NAME" names it.
    Raises InputError, naming the place in the file, for anything that is no result.
    """
    path = Path(path)
    # A result.json under another name is read as the file that it is.
    if path.name != "result.json" and path.suffix != ".json":
        path = path / "result.json"
    loops = load_function(mechanism) if isinstance(mechanism, str) else mechanism
    return SavedResult(read_document(path), path, loops)
