"""Where a fit ended: parameters, the state of the merit there, and the parameter system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

from loopcal.arrays import Array
from loopcal.estimation.solve.merit import Evaluation, State
from loopcal.estimation.solve.reduction import Accumulator, Spectrum

Other = TypeVar("Other")


@dataclass(frozen=True)
class End(Generic[State]):
    """Where a fit ended.

    parameters: (n_all,) [SI]; state: of the merit, with loops closed there; sums: over all poses;
    spectrum: of data and prior; prior_square: (p - nominal)^2 over prior variance, summed; status.
    """

    parameters: Array
    state: State
    sums: Evaluation[None]
    spectrum: Spectrum
    prior_square: float
    status: Status

    def with_state(self, state: Other) -> End[Other]:
        """The same end, with the state of another merit."""
        return End(self.parameters, state, self.sums, self.spectrum, self.prior_square, self.status)

    @property
    def corrections(self: End[Array]) -> Array:
        """Of poses in memory: the corrections (k, N) [SI] that close the loops."""
        return self.state

    @property
    def data(self) -> Accumulator:
        """The parameter system of all poses, without the prior."""
        return self.sums.data

    @property
    def cost(self) -> float:
        """The loss summed over all poses."""
        return self.sums.cost

    @property
    def equations(self) -> int:
        """Loop equations of all poses, less the unmeasured quantities they determine."""
        return self.sums.equations

    @property
    def poses(self) -> int:
        """How many poses were used."""
        return self.sums.poses

    @property
    def chi_squared(self) -> float:
        """The merit: corrections, or what the loss makes of them, and prior together."""
        return self.cost + self.prior_square


Solution = End[Array]
"""Where a fit of poses in memory ended."""


# Why a fit stopped: a status is its cause and what to do about it.

# docs/decisions/0002: a cap; fits end by progress.
MOST_ITERATIONS = 1000
"""Iterations that a fit may take, unless the user says otherwise."""
REASONS = {
    "converged": "The gradient of the Lagrangian is zero to rounding and every loop closes.",
    "crept": (
        "Every loop closes, and what further steps would gain is small beside the sds: they follow "
        "a curved valley of chi-squared too slowly. For more digits give weakly determined "
        "parameters a prior sd."
    ),
    "max_iterations": (
        "The iterations allowed ran out before the gradient was small. Allow more "
        "(fit.max_iterations), or start nearer: check nominal values, units and joint signs."
    ),
    "file_at_fault": (
        "The file is at fault, so the fit ended early. Correct what is named and calibrate again."
    ),
    "stalled": (
        "Steps no longer lower chi-squared although its gradient is not small. Check the "
        "nominal values and units, scale sds that differ by many orders of magnitude, or give "
        "weakly determined parameters a prior sd."
    ),
    "runaway": (
        "Chi-squared falls towards infinite parameters: some have lost all effect on the loops. "
        "Start nearer, give them a prior sd, or fix them."
    ),
    "diverged": (
        'The undamped iteration diverged. Use method "implicit-loop", which damps its steps, '
        "or start nearer."
    ),
    "cannot_close": (
        "Some loops cannot be closed by correcting the readings. Check the poses named, "
        "and whether every loop contains a quantity with an sd above zero."
    ),
}


CONVERGED = ("converged", "crept")
"""The reasons of a fit that can be used."""


@dataclass(frozen=True)
class Status:
    """How a fit ended.

    reason: one of the keys of REASONS; message: cause and
    remedy; iterations: parameter steps tried; evaluations: loop evaluations per pose;
    note: from where the fit was started instead, if it was; part of the message.
    """

    converged: bool
    reason: str
    message: str
    iterations: int
    evaluations: float = 0.0
    note: str = ""

    @classmethod
    def of(cls, reason: str, iterations: int, evaluations: float, detail: str = "") -> Status:
        """The status for a reason, with its cause and remedy."""
        message = f"{REASONS[reason]} {detail}".strip()
        return cls(reason in CONVERGED, reason, message, iterations, evaluations)

    def ended_early(self) -> Status:
        """The same where more iterations would be of no use, for the file is at fault."""
        if self.reason != "max_iterations":
            return self
        return Status.of("file_at_fault", self.iterations, self.evaluations)


def weakness(names: tuple[str, ...]) -> str:
    """What to do about a direction that the poses hardly determine; nothing if there is none."""
    if not names:
        return ""
    return (
        f"These poses weakly distinguish {', '.join(names)}: fix one of them or give it a prior "
        f"sd, "
        'and describe axes that are nearly parallel by the form "hayati" or by transitions.'
    )
