"""What every result offers that layers above compute: named here, connected by the package."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from loopcal.errors import InputError, LoopcalError

Find = Callable[[str], Callable[..., Any]]


@dataclass(frozen=True)
class Plots:
    """The report's figures of a result, as plotly figures; they show themselves in a notebook.

    drawn: key -> figure.
    """

    drawn: Mapping[str, Any]

    def residuals(self) -> Any:
        """Computed minus measured outputs pose by pose, before and after."""
        return self._figure("residuals")

    def space(self) -> Any:
        """Arrows from measured to computed points, and the machine."""
        return self._figure("arrows")

    def parameters(self) -> Any:
        """Changes of the parameters from their nominal values, with 95 % intervals."""
        return self._figure("parameters")

    def correlations(self) -> Any:
        """Correlations of the estimated parameters, as a map."""
        return self._figure("correlations")

    def _figure(self, key: str) -> Any:
        if key not in self.drawn:
            raise InputError(
                f"the result has no numbers for the figure {key!r}",
                code="no-data",
                remedy=f"draw one of: {', '.join(self.drawn)}",
            )
        return self.drawn[key].plotly()


_finders: list[Find] = []


def connect(find: Find) -> None:
    """State who finds what is offered: a name -> a function of the result."""
    _finders[:] = [find]


def offered(name: str) -> Callable[..., Any]:
    """The function of this name, found by the package."""
    if not _finders:
        raise LoopcalError(f"{name!r} is not connected", remedy="import loopcal")
    return _finders[0](name)
