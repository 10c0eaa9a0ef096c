"""What every result answers, whether it was just fitted or read from its folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from loopcal.document.aliases import aliased
from loopcal.document.offers import Plots, offered
from loopcal.document.parameter_table import ParameterTable
from loopcal.document.plain import plain
from loopcal.document.result_document import ResultDocument, WrittenResult

if TYPE_CHECKING:
    from loopcal.document.verdict import Verdict


class Views:
    """Tables, figures and texts of a result, from its document.

    Names that users of SciPy, lmfit and statsmodels try first work as well, where they mean the
    same (`loopcal.document.aliases`).
    """

    # At run time these would become defaults of fields with the same names in dataclasses below.
    if TYPE_CHECKING:

        @property
        def document(self) -> ResultDocument:
            """Everything that result.json holds."""
            ...

        @property
        def judged(self) -> ResultDocument:
            """The same with verdict and findings, if anything is there to judge it."""
            ...

        @property
        def verdict(self) -> Verdict | None:
            """Whether the result can be used, and for what."""
            ...

    @property
    def converged(self) -> bool:
        """Whether the point found is the optimum; `verdict` says whether it can be used."""
        return self.document.status.converged

    @property
    def params(self) -> ParameterTable:
        """Every parameter by name [SI]: value, sd, nominal; as a DataFrame by `to_pandas()`."""
        return ParameterTable(self.document.parameters)

    @property
    def plot(self) -> Plots:
        """The report's figures, as plotly figures: `result.plot.residuals()`."""
        plots: Plots = offered("plot")(self)
        return plots

    def __str__(self) -> str:
        return str(self.judged)

    def summary(self) -> str:
        """The printed summary, headed by the verdict."""
        return str(self)

    def predict(self, data: Any, **options: Any) -> Any:
        """`loopcal.predict` of this result: outputs for readings, with their covariance."""
        return offered("predict")(self, data, **options)

    def save(
        self, folder: str | Path, *, report: bool = True, force: bool = False
    ) -> WrittenResult:
        """Write result.json, residuals.csv, mechanism.toml and report.html to a folder.

        `loopcal.read_result` reads them back. report: whether report.html is written too; force:
        replace files that loopcal did not write, keeping backups. Raises InputError where they
        cannot be written, and for a result that has a folder already.
        """
        written: WrittenResult = offered("save")(self, folder, report=report, force=force)
        return written

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json as plain data."""
        content: dict[str, Any] = plain(self.judged)
        return content

    def _repr_html_(self) -> str:
        from loopcal.document.notebook_html import result_html

        return result_html(self.judged)

    if not TYPE_CHECKING:  # a type checker shall still find misspelt names

        def __getattr__(self, name: str) -> Any:
            if hasattr(type(self), name):  # a property that failed: say what failed in it
                return object.__getattribute__(self, name)
            return aliased(self, name)
