"""The app as a user starts it: a server of its own on a folder, killed at the end."""

from __future__ import annotations

import socket
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import sleep

import pytest

from tests.command_line import environment

LONGEST = 120.0
"""Seconds that a server may take to answer on a busy machine."""


@dataclass(frozen=True)
class Served:
    """A server that answers; address: without a slash at its end."""

    process: subprocess.Popen[str]
    port: int
    address: str

    def kill(self) -> None:
        """End it at once, as a power cut does."""
        self.process.kill()
        self.process.wait()
        if self.process.stderr is not None:
            self.process.stderr.close()


def free_port() -> int:
    """A port that nothing listens at."""
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


def started(folder: Path, *options: str, port: int | None = None) -> Served:
    """`loopcal app FOLDER`, once it answers."""
    pytest.importorskip("nicegui", reason="NiceGUI is absent; `pip install .[app]` installs it")
    number = free_port() if port is None else port
    line = [sys.executable, "-m", "loopcal", "app", str(folder), "--no-browser"]
    own = environment()
    own.pop("PYTEST_CURRENT_TEST", None)  # by which NiceGUI takes itself for tested
    process = subprocess.Popen(
        [*line, "--port", str(number), *options],
        env=own,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )
    assert process.stderr is not None
    told = process.stderr.readline()
    assert "the app is at " in told, told + process.stderr.read()
    served = Served(process, number, told.partition("the app is at ")[2].strip().rstrip("/"))
    for _ in range(int(LONGEST / 0.05)):
        if process.poll() is not None:
            break
        with socket.socket() as trial:
            if trial.connect_ex(("127.0.0.1", number)) == 0:
                return served
        sleep(0.05)
    process.kill()
    raise AssertionError(f"the server does not answer: {process.stderr.read()}")


@contextmanager
def serving(folder: Path, *options: str) -> Iterator[Served]:
    """The same, killed at the end."""
    served = started(folder, *options)
    try:
        yield served
    finally:
        served.kill()


@dataclass(frozen=True)
class Answer:
    """What the server answered."""

    status: int
    headers: dict[str, str]
    text: str


def asked(address: str, **headers: str) -> Answer:
    """GET an address; a refusal is an answer too."""
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=named)) as got:
            body = got.read().decode("utf-8", "replace")
            return Answer(got.status, {k.lower(): v for k, v in got.headers.items()}, body)
    except urllib.error.HTTPError as error:
        told = {k.lower(): v for k, v in error.headers.items()}
        return Answer(error.code, told, error.read().decode("utf-8", "replace"))
