"""What every result answers, whether it was just fitted or read from its folder."""

from __future__ import annotations

from dataclasses import replace
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

    if TYPE_CHECKING:

        @property
        def document(self) -> ResultDocument:
            """Everything that result.json holds."""
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
        found: Plots = offered("plot")(self)
        return found

    def summary(self) -> str:
        """The printed summary, headed by the verdict."""
        return str(self._judged)

    def predict(self, data: Any, **given: Any) -> Any:
        """`loopcal.predict` of this result: outputs for readings, with their covariance."""
        return offered("predict")(self, data, **given)

    def save(self, folder: str | Path, *, report: bool = True) -> WrittenResult:
        """Write result.json, residuals.csv, mechanism.toml and report.html to a folder.

        `loopcal.read_result` reads them back. report: whether report.html is written too. Raises
        InputError where they cannot be written, and for a result that has a folder already.
        """
        written: WrittenResult = offered("save")(self, folder, report=report)
        return written

    def to_dict(self) -> dict[str, Any]:
        """The content of result.json as plain data."""
        content: dict[str, Any] = plain(self._judged)
        return content

    @property
    def _judged(self) -> ResultDocument:
        document = self.document
        return document if document.verdict else replace(document, verdict=self.verdict)

    def _repr_html_(self) -> str:
        from loopcal.document.notebook_html import result_html

        return result_html(self._judged)

    if not TYPE_CHECKING:  # a type checker shall still find misspelt names

        def __getattr__(self, name: str) -> Any:
            if hasattr(type(self), name):  # a property that failed: say what failed in it
                return object.__getattribute__(self, name)
            return aliased(self, name)
