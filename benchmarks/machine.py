"""On what machine, with what versions and when something was measured."""

from __future__ import annotations

import os
import platform
import subprocess
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from shutil import which

import numpy as np
from threadpoolctl import threadpool_info

from loopcal.expressions.choice import in_words


@dataclass(frozen=True)
class Machine:
    """What a time depends on besides the program."""

    date: str
    processor: str
    cores: int
    system: str
    python: str
    numpy: str
    blas: str
    others: str
    loopcal: str
    engine: str
    load: float
    """Processes that wanted a core, on average over the last minute."""

    def __str__(self) -> str:
        return (
            f"{self.date}; {self.processor}, {self.cores} cores, {self.system}; "
            f"Python {self.python}, NumPy {self.numpy}, {self.blas}, {self.others}, "
            f"loopcal {self.loopcal} ({self.engine}); load before the run {self.load:.1f}"
        )


def this_machine() -> Machine:
    """The machine that this runs on, now."""
    libraries = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    libraries.sort(key=lambda pool: "numpy" not in pool.get("filepath", ""))  # not scipy's own
    blas = libraries[0] if libraries else {"internal_api": "BLAS", "version": ""}
    return Machine(
        date=datetime.now(UTC).date().isoformat(),
        processor=_processor(),
        cores=os.cpu_count() or 0,
        system=f"{platform.system()} {platform.machine()}",
        python=platform.python_version(),
        numpy=np.__version__,
        blas=f"{blas['internal_api']} {blas['version']} on one thread",
        others=", ".join(_others()),
        loopcal=version("loopcal"),
        engine=in_words(),
        load=os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan"),
    )


def _others() -> list[str]:
    """Other programs that are compared, as far as they are installed."""
    found = []
    for name in ("odrpack", "scipy", "gtsam", "pyceres"):
        with suppress(PackageNotFoundError):
            found.append(f"{name} {version(name)}")
    if which("octave-cli"):
        asked = ["octave-cli", "--version"]
        told = subprocess.run(asked, capture_output=True, text=True, check=True).stdout
        found.append(told.splitlines()[0].replace(", version", ""))
    return found


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    flags = next((line for line in lines if line.startswith("flags")), "")
    vector = next((f" with {text}" for flag, text in _VECTORS if flag in flags.split()), "")
    return (names[0] if names else platform.processor() or "unknown processor") + vector


_VECTORS = (("avx512f", "AVX-512"), ("avx2", "AVX2"))
