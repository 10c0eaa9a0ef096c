"""Versions of this program and of what its numbers depend on."""

from __future__ import annotations

import platform


def versions() -> dict[str, str]:
    """Version of loopcal, Python and NumPy."""
    import numpy as np

    return {"loopcal": version(), "python": platform.python_version(), "numpy": np.__version__}


def version_and_engine() -> str:
    """What `loopcal --version` says."""
    from loopcal.expressions.choice import in_words

    return f"loopcal {version()} (engine: {in_words()})"


def version() -> str:
    """Version of the installed loopcal."""
    from importlib.metadata import version as installed

    return installed("loopcal")
