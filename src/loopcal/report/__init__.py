"""One self-contained HTML page that says what a calibration found and how far to trust it."""

import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    """Importing this package binds it in `loopcal` under the name of `loopcal.report(result)`."""

    def __call__(self, *given: Any, **options: Any) -> Any:
        from loopcal.report.writing import report

        return report(*given, **options)


sys.modules[__name__].__class__ = _Callable
