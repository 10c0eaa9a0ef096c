"""What residuals.csv says of every pose, whether just computed or read from the disk again."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loopcal.estimation.result import Result
from loopcal.files.result.residuals_file import residual_columns
from loopcal.files.tables.readers import read_dataset

Array = NDArray[np.float64]
_UNIT = re.compile(r" \[(?P<unit>[^\[\]]*)\]$")


@dataclass(frozen=True, eq=False)
class ResultColumns:
    """poses: ids; columns: header of residuals.csv -> (N,) values, SI, NaN where empty."""

    poses: tuple[str, ...]
    columns: Mapping[str, Array]

    @classmethod
    def of(cls, result: Result) -> ResultColumns:
        """Of a result that is not on the disk."""
        columns = residual_columns(result)
        ids = tuple(str(pose) for pose in columns.pop("pose"))
        return cls(ids, {name: np.asarray(values, float) for name, values in columns.items()})

    def reading(self, quantity: str) -> Array | None:
        """The readings (N,) of a quantity, None where there are none."""
        return self._named(re.escape(quantity)).get("")

    def normalised(self, quantity: str) -> Array | None:
        """The corrections (N,) of a quantity over its sds, None where there are none."""
        return self.columns.get(f"{quantity} correction/sd")

    def differences(self, when: str) -> dict[str, Array]:
        """Output -> (N,) computed minus measured; when: "before" or "after"."""
        return self._named(rf"(?P<name>.+) computed - measured {when}")

    def residuals(self, when: str) -> dict[str, Array]:
        """Loop -> (N,) its values; when: "before" or "after"."""
        return self._named(rf"residual (?P<name>.+) {when}")

    def _named(self, pattern: str) -> dict[str, Array]:
        found = {}
        for header, values in self.columns.items():
            match = re.fullmatch(pattern, _UNIT.sub("", header))
            if match:
                found[match.groupdict().get("name", "")] = values
        return found


def read_result_columns(path: str | Path) -> ResultColumns:
    """What residuals.csv says; raises InputError where it is absent or cannot be read."""
    read = read_dataset(path, pose="pose")
    return ResultColumns(read.poses, read.readings)
