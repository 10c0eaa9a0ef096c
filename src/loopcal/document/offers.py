"""What every result offers that layers above compute: named here, connected by the package."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

from loopcal.errors import LoopcalError

Find = Callable[[str], Callable[..., Any]]


class Plots(Protocol):
    """The report's figures of a result, as plotly figures; they show themselves in a notebook."""

    def residuals(self) -> Any:
        """Computed minus measured outputs pose by pose, before and after."""

    def space(self) -> Any:
        """Arrows from measured to computed points, and the machine."""

    def parameters(self) -> Any:
        """Changes of the parameters from their nominal values, with 95 % intervals."""

    def correlations(self) -> Any:
        """Correlations of the estimated parameters, as a map."""


_finders: list[Find] = []


def connect(find: Find) -> None:
    """State who finds what is offered: a name -> a function of the result."""
    _finders[:] = [find]


def offered(name: str) -> Callable[..., Any]:
    """The function of this name, found by the package."""
    if not _finders:
        raise LoopcalError(f"{name!r} is not connected", remedy="import loopcal")
    return _finders[0](name)
