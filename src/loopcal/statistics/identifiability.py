"""What the poses say about the parameters, and what only the prior says.

Three views of the same system: each parameter's sd beside what was known of it before; the
directions in which parameters trade against each other, in words; and the count of equations,
Hollerbach and Wampler's calibration index.

How well a set of poses shows the parameters, in the five numbers of the literature.

They are taken from the singular values sigma of the whitened parameter Jacobian of all poses, each
column divided by its length: numbers without a unit, which do not depend on the units of the
parameters, on how large all sds are together, nor on how the loop equations are written. Prior
knowledge is left out; they speak of the poses alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from loopcal.arrays import Array
from loopcal.document.findings import (
    CalibrationIndex,
    Identifiability,
    Learned,
    Observability,
    WeakDirection,
)
from loopcal.document.plain import finite
from loopcal.estimation.problem.problem import Problem
from loopcal.estimation.solve.reduction import Accumulator, Spectrum, spectrum, undetermined
from loopcal.mechanisms.mechanism import Mechanism
from loopcal.mechanisms.parameters import BEYOND
from loopcal.presentation.shown import SHOWN, significant
from loopcal.units import from_si

SCHROER = 100.0
"""Condition number of the scaled system up to which poses are good. Schroer (1993)."""
# Shares of the variance that the data took away: a tenth, and a half.
SAYS_NOTHING, SAYS_LITTLE = 0.95, 0.7
"""Posterior over prior sd from which on the data said nothing, or little."""
# Chosen, not derived: a tenth of the square of the largest, and what fits a line.
_LEADING, _MOST_NAMED = 0.3, 4
# Within 18 degrees. Chosen, not derived: a scale with small other parts is still one.
_SAME = 0.95
"""Cosine from which on a direction is that of the size."""


@dataclass(frozen=True)
class WhatDataSay:
    """condition_number: of the data alone, column-scaled; None where singular.

    learned: of parameters with a prior; weak: directions, the worst first; model_error: parameters
    beyond geometry whose sds are learnt.
    """

    condition_number: float | None
    learned: tuple[Learned, ...]
    weak: tuple[WeakDirection, ...]
    index: CalibrationIndex
    model_error: frozenset[str] = frozenset()

    def added_to(self, identifiability: Identifiability) -> Identifiability:
        """What a fit says of its poses, with this."""
        return replace(
            identifiability,
            data_condition_number=self.condition_number,
            data_versus_prior=self.learned,
            weak_directions=self.weak,
            calibration_index=self.index,
        )

    def words(self, most: int = 3) -> list[str]:
        """What a reader must know: the worst directions, and parameters the data left alone.

        Not those that the learnt model error takes part in: its sds hold them.
        """
        weak = [one for one in self.weak if self.model_error.isdisjoint(one.combination)]
        lines = [direction.words for direction in weak[:most]]
        if len(weak) > most:
            lines.append(f"and {len(weak) - most} more such directions (result.json)")
        learned = [e for e in self.learned if e.parameter not in self.model_error]
        silent = sorted((e for e in learned if e.ratio > SAYS_LITTLE), key=lambda e: -e.ratio)
        lines += [entry.words for entry in silent[:most]]
        if len(silent) > most:
            lines.append(f"and {len(silent) - most} more such parameters (result.json)")
        return lines


def what_data_say(
    problem: Problem,
    information: Accumulator,
    sds: Mapping[str, float | None],
    index: CalibrationIndex,
    *,
    unit_sd: float | None = 1.0,
) -> WhatDataSay:
    """What these poses say.

    information: the whitened equations of all poses, without the prior; sds: after the fit, or
    to be expected [SI]; unit_sd: sd of one whitened equation, None where it is not known.
    """
    system = data_spectrum(information)
    names = problem.names
    units = [problem.mechanism.parameters[name].unit for name in names]
    whole = system.rank == len(names)
    return WhatDataSay(
        system.condition if whole else None,
        _learned(problem, units, sds),
        (
            *_undetermined(problem, system),
            *_weak(system, names, units, unit_sd, _lengths(problem, units)),
        ),
        index,
        _model_error(problem.mechanism),
    )


def _model_error(mechanism: Mechanism) -> frozenset[str]:
    """The parameters beyond geometry whose sds are learnt."""
    learnt = {name for term in mechanism.terms for name in term.parameters}
    return frozenset(name for name in learnt if mechanism.roles.get(name) in BEYOND)


def calibration_index(problem: Problem, poses: int, equations: int) -> CalibrationIndex:
    """Count the equations that all poses give, as Hollerbach and Wampler do."""
    quantities, loops = problem.readings.shape[0], len(problem.mechanism.tape.loops)
    mobility = (quantities - loops) * poses
    return CalibrationIndex(
        equations,
        equations + mobility,
        mobility,
        poses,
        len(problem.free),
    )


def _learned(
    problem: Problem, units: Sequence[str], sds: Mapping[str, float | None]
) -> tuple[Learned, ...]:
    entries = []
    for name, unit, prior in zip(problem.names, units, problem.prior_sd.tolist(), strict=True):
        sd = sds[name]
        if sd is None or not (math.isfinite(prior) and math.isfinite(sd) and prior > 0.0):
            continue
        ratio = sd / prior
        shown = SHOWN.get(unit, unit)
        both = f"sd {_with(sd, shown)} of prior {_in(prior, shown)}"
        verdict = f"the data determine {name!r}"
        if ratio > 1.0 + 1e-6:  # only a method that leaves the prior unused gets here
            verdict = f"{name!r} is determined more by its prior than by the data"
        elif ratio > SAYS_NOTHING:
            verdict = f"the data do not determine {name!r}"
        elif ratio > SAYS_LITTLE:
            verdict = f"the data weakly determine {name!r}"
        entries.append(Learned(name, ratio, f"{verdict}: {both}"))
    return tuple(entries)


def _undetermined(problem: Problem, system: Spectrum) -> list[WeakDirection]:
    """Directions that the data leave open altogether."""
    prior = dict(zip(problem.names, np.isfinite(problem.prior_sd).tolist(), strict=True))
    directions = []
    for combination in undetermined(system, problem.names):
        names = list(combination)
        words = f"{_list(names)} cannot be distinguished by these poses"
        if len(names) == 1:
            words = f"these poses do not determine {_list(names)}"
        if any(prior[name] for name in names):
            words += "; only prior knowledge determines " + ("them" if names[1:] else "it")
        directions.append(WeakDirection(dict(combination), {}, None, words))
    return directions


def _lengths(problem: Problem, units: Sequence[str]) -> Array:
    """(n,) the step [SI] that doubles the size of the machine: its lengths, no angle."""
    return np.where(np.array(units) == "m", problem.nominal, 0.0)


def _weak(
    system: Spectrum,
    names: Sequence[str],
    units: Sequence[str],
    unit_sd: float | None,
    lengths: Array,
) -> list[WeakDirection]:
    """Directions beyond Schroer's condition number that the data determine, the worst first."""
    s, highest = system.singular_values, float(system.singular_values.max(initial=0.0))
    weak = np.flatnonzero(system.kept & (s * SCHROER < highest))
    return [
        _weak_direction(system, int(i), names, units, highest / float(s[i]), unit_sd, lengths)
        for i in weak[np.argsort(s[weak])]
    ]


def _weak_direction(
    system: Spectrum,
    which: int,
    names: Sequence[str],
    units: Sequence[str],
    condition: float,
    unit_sd: float | None,
    lengths: Array,
) -> WeakDirection:
    direction = system.directions[:, which]
    # The sign of a singular vector is arbitrary: its largest share counts as +1.
    direction = direction / direction[int(np.argmax(np.abs(direction)))]
    order = np.argsort(-np.abs(direction), kind="stable")[:_MOST_NAMED]
    leading = [int(i) for i in order if abs(direction[i]) >= _LEADING]
    shares = {names[i]: float(direction[i]) for i in leading}
    steps: dict[str, float] = {}
    words = f"{_list([names[i] for i in leading])} are weakly distinguished by these poses"
    if len(leading) == 1:
        words = f"{names[leading[0]]!r} is weakly determined by these poses"
    whole = _size(system, which, unit_sd, lengths)
    if whole is not None:
        words = (
            "the size of the machine, all its lengths alike, is weakly determined by these poses: "
            f"to {significant(100.0 * whole, 2)} %"
        )
    words += f" (condition {significant(condition, 3)}"
    if unit_sd is not None:
        along = system.directions[:, which]
        size = unit_sd / float(system.singular_values[which])
        size = math.copysign(size, float(along[leading[0]]))
        moves = system.scale * along * size
        steps = {names[i]: float(moves[i]) for i in leading}
        shown = [SHOWN.get(units[i], units[i]) for i in leading]
        shifts = [
            f"{names[i]} {_with(float(moves[i]), u, sign=True)}"
            for i, u in zip(leading, shown, strict=True)
        ]
        words += f"; one sd along it: {', '.join(shifts)}"
    return WeakDirection(shares, steps, finite(condition), words + ")", whole)


def _size(system: Spectrum, which: int, unit_sd: float | None, lengths: Array) -> float | None:
    """By which share all lengths change within one sd along a direction; None for another one."""
    # Directions are those of parameters over their scale, and so must the step be.
    scaled = lengths / system.scale
    length = float(np.linalg.norm(scaled))
    along = abs(float(system.directions[:, which] @ scaled))
    if unit_sd is None or along < _SAME * length or not length:
        return None
    return unit_sd / float(system.singular_values[which]) * along / length**2


def _in(value: float, unit: str, *, sign: bool = False) -> str:
    text = significant(float(from_si(value, unit)), 3)
    return f"+{text}" if sign and value > 0 else text


def _with(value: float, unit: str, *, sign: bool = False) -> str:
    """A value [SI] with its unit, where it has one."""
    text = _in(value, unit, sign=sign)
    return text if unit == "1" else f"{text} {unit}"


def _list(names: Sequence[str]) -> str:
    quoted = [repr(name) for name in names]
    if len(quoted) == 1:
        return quoted[0]
    return ", ".join(quoted[:-1]) + f" and {quoted[-1]}"


def data_spectrum(information: Accumulator) -> Spectrum:
    """The spectrum of what the data alone say, columns scaled to length 1."""
    n = len(information.total) - 1
    return spectrum(information, np.zeros(n), np.full(n, np.inf))


def observability(information: Accumulator, poses: int) -> Observability:
    """The indices of the poses whose whitened equations were added up."""
    system = data_spectrum(information)
    s = np.where(system.kept, system.singular_values, 0.0)
    if not s.all():
        return Observability(0.0, 0.0, 0.0, 0.0, 0.0)
    low, high = float(s.min()), float(s.max())
    return Observability(
        # By logarithms: the product of many small values would underflow.
        O1=float(np.exp(np.log(s).mean())) / float(np.sqrt(poses)),
        O2=low / high,
        O3=low,
        O4=low**2 / high,
        O5=1.0 / float((1.0 / s).sum()),
    )
