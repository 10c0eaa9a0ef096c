"""A figure in space on a plain canvas: it turns smoothly where no graphics processor is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from nicegui.element import Element


class Space(Element, component="scripts/space.js"):
    """Traces as plotly names them, drawn by `scripts/space.js`; with the methods of `ui.plotly`
    that the app uses."""

    def __init__(self, figure: Mapping[str, Any]) -> None:
        super().__init__()
        self.update_figure(figure)

    def update_figure(self, figure: Mapping[str, Any]) -> None:
        """Draw other traces; the eye stays where it is."""
        self.props["options"] = dict(figure)

    def run_plot_method(self, name: str, *args: Any) -> Any:
        """`restyle` alone: move the points of some traces."""
        return self.run_method("run_plot_method", name, *args)
