"""The parameters of a result as a table: by name, as a DataFrame, as text and HTML."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from loopcal.document.fit import ParameterEntry, validity
from loopcal.document.tables import parameter_table
from loopcal.errors import InputError, nearest
from loopcal.lazy import cached_property


@dataclass(frozen=True, eq=False, repr=False)
class ParameterTable(Mapping[str, ParameterEntry]):
    """Parameters by name, in the order of the result; SI, each with its unit.

    `table["l2"].value`, `.sd`, `.nominal`; `to_pandas()` and `to_polars()` give a DataFrame.
    """

    entries: tuple[ParameterEntry, ...]

    @cached_property
    def _by_name(self) -> dict[str, ParameterEntry]:
        return {entry.name: entry for entry in self.entries}

    def __getitem__(self, name: str) -> ParameterEntry:
        try:
            return self._by_name[name]
        except KeyError:
            raise KeyError(f"no parameter {name!r}; {nearest(str(name), self._by_name)}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    def columns(self) -> dict[str, Sequence[Any]]:
        """Column -> one value per parameter: value, sd, nominal, change, prior sd [SI] and more."""
        every = self.entries
        return {
            "name": [e.name for e in every],
            "value": [e.value for e in every],
            "sd": [e.sd for e in every],
            "nominal": [e.nominal for e in every],
            "change": [e.value - e.nominal for e in every],
            "unit": [e.unit for e in every],
            "prior_sd": [e.prior_sd for e in every],
            "fixed": [e.fixed for e in every],
            "validity": [validity(e) for e in every],
        }

    def to_dataframe(self) -> Any:
        """A pandas DataFrame where pandas is installed, else one of polars."""
        from importlib.util import find_spec

        return self.to_polars() if find_spec("pandas") is None else self.to_pandas()

    def to_pandas(self) -> Any:
        """A pandas DataFrame with the names as index; InputError where pandas is not installed."""
        try:
            import pandas
        except ImportError:
            raise InputError(
                "pandas is not installed",
                code="missing-dependency",
                remedy="pip install pandas, or use to_polars()",
            ) from None
        # A column with None would hold objects: as float it holds NaN.
        numbers = dict.fromkeys(("value", "sd", "nominal", "change", "prior_sd"), float)
        return pandas.DataFrame(self.columns()).astype(numbers).set_index("name")

    def to_polars(self) -> Any:
        """A polars DataFrame, with null for what is unknown."""
        import polars

        numbers = dict.fromkeys(("value", "sd", "nominal", "change", "prior_sd"), polars.Float64)
        return polars.DataFrame(self.columns(), schema_overrides=numbers)

    def __str__(self) -> str:
        return "\n".join(parameter_table(self.entries))

    def __repr__(self) -> str:
        return str(self)

    def _repr_html_(self) -> str:
        from loopcal.document.notebook_html import parameters_html

        return parameters_html(self.entries)
