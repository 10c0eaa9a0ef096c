"""The result of a calibration: a fit, its document with the verdict, and its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.companions import called
from loopcal.document.plain import finite_only
from loopcal.document.result_document import ResultDocument, WrittenResult
from loopcal.errors import Instead
from loopcal.estimation.fit_document import fit_document
from loopcal.estimation.result import FitResult
from loopcal.files.outputs import one_command
from loopcal.files.result import result_file
from loopcal.files.versions import versions as installed_versions
from loopcal.lazy import cached_property, keep
from loopcal.measurements.dataset import Dataset
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.statistics.calibrated import Calibrated
from loopcal.statistics.calibration_document import calibration_document, with_findings
from loopcal.statistics.findings import Findings, findings
from loopcal.statistics.predictor import Predictor, predictor, without_outputs
from loopcal.statistics.verdict import judged
from loopcal.workflow.keeping import Keeper
from loopcal.workflow.views import Views

if TYPE_CHECKING:
    from loopcal.report.source import Source


@dataclass(frozen=True, eq=False, repr=False)
class Result(FitResult, Views):
    """The result of a calibration. Values are SI; mappings go by name.

    It holds the fit and what was stated, chosen and validated beside it (`parts`). Everything else
    follows from these and is computed when it is first asked for. Document and verdict take as
    long as the search for outliers, change points and other optima.
    """

    load = from_file = Instead("lc.load(folder)")

    @classmethod
    def of(cls, fit: FitResult, **parts: Any) -> Result:
        """Of a fit, with further parts beside it: fields of `Parts`."""
        if isinstance(fit, Result) and not parts:
            return fit
        made = cls(**{one.name: getattr(fit, one.name) for one in fields(fit)})
        keep(fit, made, FitResult)
        return made.with_parts(**parts)

    @cached_property
    def findings(self) -> Findings:
        """What follows from the equations of the fit beyond the parameters."""
        return findings(self, self.parts.region, beside=attrgetter("unjudged"))

    @cached_property
    def document(self) -> ResultDocument:
        """Everything that result.json holds, with verdict and findings."""
        searched = self.findings  # ahead of `unjudged`, which it computes meanwhile
        whole = with_findings(self.unjudged, searched)
        return judged(whole, self.parts.tolerance, self.parts.files or {})

    @cached_property
    def unjudged(self) -> ResultDocument:
        """The document without verdict and findings, at hand before any search for these."""
        return calibration_document(fit_document(self), self.parts)

    @cached_property
    def predictor(self) -> Predictor:
        """What predictions need. Raises InputError for a result without outputs."""
        if (made := predictor(self)) is None:
            raise without_outputs(self.mechanism)
        return made

    @property
    def machine(self) -> Mechanism:
        """The calibrated mechanism."""
        return self.calibrated

    @property
    def poses(self) -> Dataset:
        """The poses used."""
        return self.dataset

    @property
    def source(self) -> Source:
        """What the report shows: the document, and what became of every reading."""
        from loopcal.report.source import source_of

        return source_of(self, self.document, "result")

    def save(
        self, folder: str | Path, *, report: bool = True, force: bool = False
    ) -> WrittenResult:
        """Write result.json, residuals.csv, mechanism.toml and report.html to a folder.

        `loopcal.read_result` reads them back. report: whether report.html is written too; force:
        replace files that loopcal did not write, keeping backups. Raises InputError where they
        cannot be written.
        """
        return write_result(self, folder, report=report, force=force)


@one_command
def write_result(
    result: FitResult,
    folder: str | Path,
    *,
    title: str | None = None,
    inputs: Mapping[str, Any] | None = None,
    warnings: tuple[str, ...] = (),
    report: bool = False,
    force: bool = False,
) -> WrittenResult:
    """Write result.json, residuals.csv and mechanism.toml (calibrated), all or none.

    The folder is made if need be. title, inputs (the project as it was read) and warnings go to
    result.json, beside what the result says itself. report: whether report.html comes with them;
    force: replace files that loopcal did not write, keeping backups. Raises InputError, naming the
    file, the reason and a remedy, where they cannot be written.
    """
    return save_result(result, folder, title=title, inputs=inputs, warnings=warnings, report=report)


def save_result(
    result: FitResult,
    folder: str | Path,
    *,
    title: str | None = None,
    inputs: Mapping[str, Any] | None = None,
    warnings: tuple[str, ...] = (),
    report: bool = False,
    keeper: Keeper | None = None,
) -> WrittenResult:
    """`write_result` within a command; keeper: keeps the result with its files."""
    result = Result.of(result)
    document = result.document
    if result.parts.files is None:
        files = {"result": Path(folder).name or "."}
        document = judged(document, result.parts.tolerance, files)
    versions = installed_versions()
    document = replace(
        document,
        loopcal=versions["loopcal"],
        title=document.title if title is None else title,
        warnings=(*warnings, *document.warnings),
        inputs=document.inputs if inputs is None else finite_only(inputs),
        versions=versions,
    )
    page = None
    if report:
        from loopcal.report.page import page_of

        page = page_of(result, folder, called("sections"))
    if keeper is None:
        return result_file.write_result(result, document, folder, report=page)
    path = Path(folder) / "result.json"
    write = keeper.of_calibration(document, Calibrated.of(result, str(folder)), path)
    written = result_file.write_result(result, document, folder, report=page, write=write)
    keeper.note(written.folder)
    return written
