"""The engine that was chosen, made for a tape."""

from __future__ import annotations

import threading
from typing import Any

from loopcal.expressions.choice import chosen_engine, use_threads
from loopcal.expressions.compiled_engine import CompiledEngine
from loopcal.expressions.derivative import linearise
from loopcal.expressions.loop_values import Engine, LoopValues, Stage
from loopcal.expressions.numpy_engine import NumpyEngine
from loopcal.expressions.tape import Tape

__all__ = ["Engine", "LoopValues", "Stage", "engine_class", "engine_for"]

_engines = threading.local()


def engine_class() -> type[NumpyEngine] | type[CompiledEngine]:
    """The one place where an engine is selected."""
    return CompiledEngine if chosen_engine() == "compiled" else NumpyEngine


def engine_for(
    tape: Tape,
    parameters: tuple[str, ...],
    size: int,
    quantities: tuple[str, ...] | None = None,
) -> Engine:
    """This thread's engine for f and its derivatives by the given parameters and quantities (all).

    Made once and kept, because binding the registers takes longer than a small block; made anew for
    blocks of more poses than it takes.
    """
    kept: dict[Any, NumpyEngine | CompiledEngine] = _engines.__dict__.setdefault("kept", {})
    quantities = tape.quantities if quantities is None else quantities
    kind = engine_class()
    use_threads()
    key = (kind, tape, parameters, quantities)
    present = kept.get(key)
    if present is None or present.size < size:
        # Studies make tapes without end; a mechanism at work needs a handful of engines.
        if len(kept) > 32:
            kept.clear()
        present = kept[key] = kind(linearise(tape, quantities, parameters), size)
    return present
