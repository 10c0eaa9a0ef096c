from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_Array = NDArray[np.float64]
_Table = NDArray[np.int32]

INTERFACE: int

def codes() -> list[str]: ...
def widths() -> list[str]: ...
def width() -> str: ...
def use_width(name: str) -> None: ...
def threads() -> int: ...
def use_threads(count: int) -> None: ...

class Noise:
    def __init__(
        self,
        sd: _Array,
        unmeasured: Sequence[int],
        measured: Sequence[int],
        places: Sequence[Sequence[int]],
        factors: Sequence[_Array],
        own: Sequence[int],
        shared: Sequence[int],
    ) -> None: ...

class Engine:
    def __init__(
        self,
        instructions: _Table,
        ends: Sequence[int],
        outputs: Sequence[int],
        shape: Sequence[int],
        inputs: Sequence[int],
        registers: int,
        once: _Table,
        constants: _Array,
        numbers: Sequence[int],
        factors: Sequence[int],
        members: Sequence[Sequence[int]],
        factor_of: Sequence[Sequence[int]],
    ) -> None: ...
    def at(self, parameters: _Array) -> None: ...
    def evaluate(self, x: _Array, known: _Array | None, stage: int, out: _Array) -> None: ...
    def reduce(
        self,
        readings: _Array,
        corrections: _Array,
        known: _Array | None,
        noise: Noise,
        exact: bool,
        by_parameter: bool,
        rounding: bool,
        correction: _Array,
        step: _Array,
        singular: NDArray[np.uint8],
        rows: _Array | None,
        total: _Array | None,
    ) -> None: ...
    def close(
        self,
        readings: _Array,
        corrections: _Array,
        known: _Array | None,
        noise: Noise,
        exact: bool,
        tolerance: float,
        contraction: float,
        correction: _Array,
        step: _Array,
        ratio: _Array,
        rounds: NDArray[np.int32],
        late: NDArray[np.uint8],
    ) -> None: ...
    def search(
        self,
        readings: _Array,
        corrections: _Array,
        known: _Array | None,
        noise: Noise,
        change: _Array,
    ) -> None: ...
