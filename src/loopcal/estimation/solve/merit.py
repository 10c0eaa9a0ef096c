"""What the solver minimises, whatever poses it comes from: one protocol, one value.

    Phi(p) = min over corrections with f(reading + correction, p) = 0 of their weighted square

plus the prior's. The solver knows parameters and sums over poses, and hands on a state that it
does not look into: the corrections of poses in memory, or nothing at all for a stream.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Generic, Protocol, TypeVar

from loopcal.arrays import Array
from loopcal.estimation.problem.unknowns import Unknowns
from loopcal.estimation.solve.reduction import Accumulator

State = TypeVar("State")
NAMED = 5
"""Of the poses whose loops cannot be closed, so many are named."""


@dataclass(frozen=True)
class Failed:
    """Poses where something failed: how many, and the ids of the first."""

    count: int = 0
    poses: tuple[str, ...] = ()

    def __add__(self, other: Failed) -> Failed:
        return Failed(self.count + other.count, (self.poses + other.poses)[:NAMED])

    def __bool__(self) -> bool:
        return self.count > 0


NONE_FAILED = Failed()


@dataclass(frozen=True)
class Evaluation(Generic[State]):
    """Phi at some parameters, with the linearised equations of all poses added up.

    data: the parameter system; state: where the loops were linearised; proposal: the state that
    closes the linearised loops; step: the largest move from the one to the other in sds;
    contraction: the ratio of such a move to the one before; closing: to how many sds the loops
    were closed, None if they were not; rounding: what rounding of loop values does to the
    whitened residuals of a pose; equations: how many; sizes: poses of each chunk, in memory of the
    only one; singular, late: poses whose loops cannot be closed at all, or were not within the
    iterations allowed; surplus: what the loss adds to the weighted squares in `data`; swelling:
    whether steps that closed the loops did not shrink, although more than rounding.
    """

    data: Accumulator
    state: State
    proposal: State
    step: float
    contraction: float
    closing: float | None
    rounding: float
    equations: int
    sizes: tuple[int, ...]
    singular: Failed = NONE_FAILED
    late: Failed = NONE_FAILED
    surplus: float = 0.0
    swelling: bool = False

    @property
    def poses(self) -> int:
        """How many poses there are."""
        return sum(self.sizes)

    @property
    def cost(self) -> float:
        """The loss summed over all poses; chi-squared where it is gaussian."""
        return self.data.chi_squared + self.surplus

    @property
    def finite(self) -> bool:
        """Whether every loop could be evaluated."""
        return self.data.finite


def without_state(evaluation: Evaluation[Any]) -> Evaluation[None]:
    """The evaluation without what is kept of each pose."""
    return replace(evaluation, state=None, proposal=None)


class Merit(Protocol[State]):
    """The merit function: evaluates poses in memory, or chunk by chunk."""

    @property
    def unknowns(self) -> Unknowns:
        """The parameters to estimate, with the prior as far as the method uses it."""

    @property
    def evaluations(self) -> int:
        """Loop evaluations so far, summed over poses."""

    def first(self, parameters: Array) -> Evaluation[State]:
        """The evaluation to begin from, where unmeasured quantities are searched first.

        Raises InputError (DomainError) where a loop has no value or cannot be corrected.
        """

    def evaluate(
        self,
        parameters: Array,
        state: State,
        *,
        triangular: bool = False,
        closing: float | None = None,
        contraction: float = 1.0,
        trial: bool = False,
    ) -> Evaluation[State]:
        """The evaluation at parameters (n_all,), beginning from a state.

        triangular: keep a QR triangle, which has twice the digits; closing: correct the readings
        until the next step is at most this many sds; None: linearise where the state stands.
        contraction: of steps, as far as known. trial: of use only where all loops close, so the
        others may be left where one stays open.
        """

    def close(
        self, parameters: Array, state: State, tolerance: float, contraction: float
    ) -> State | None:
        """The state that closes all loops to so many sds; None where some stay open."""

    def nearer(self, parameters: Array, state: State) -> State | None:
        """The state with poses that are far off closed anew; None where none closes nearer."""
