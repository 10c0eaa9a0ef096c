"""What a reader of others' code may do to its process; called by name in the guarded child."""

from __future__ import annotations

import ctypes
import os

from loopcal.errors import InputError


def echoed(**arguments: object) -> bytes:
    print("what a library prints")
    return repr(sorted(arguments.items())).encode()


def process() -> bytes:
    return str(os.getpid()).encode()


def refused() -> bytes:
    raise InputError("no sheet", place="a.xlsx", remedy="name one").then("pip install it")


def failed() -> bytes:
    raise IndexError("\n" + "x" * 100_000)


def panicked() -> bytes:
    raise BaseException("a panic")


def aborted() -> bytes:
    os.abort()


def touched_nothing() -> bytes:
    ctypes.string_at(0)
    return b""


def endless() -> bytes:
    while True:
        pass


def insatiable() -> bytes:
    return b"".join(bytes(1 << 20) for _ in range(1 << 20))
