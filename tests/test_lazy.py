"""A property of one object is computed while another thread computes that of another."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Barrier

from loopcal.lazy import cached_property


@dataclass(frozen=True)
class Fit:
    """Whose property takes until another object's is being computed too."""

    both: Barrier
    calls: list[int]

    @cached_property
    def found(self) -> int:
        """Waits for the other."""
        self.calls.append(1)
        return self.both.wait()


def test_threads_do_not_wait_for_each_others_objects() -> None:
    both = Barrier(2, timeout=20)
    fits = [Fit(both, []), Fit(both, [])]
    with ThreadPoolExecutor(2) as pool:
        assert sorted(pool.map(lambda fit: fit.found, fits)) == [0, 1]


def test_a_value_is_computed_once_for_an_object() -> None:
    fit = Fit(Barrier(1), [])
    assert [fit.found, fit.found] == [0, 0]
    assert fit.calls == [1]
    assert vars(fit)["found"] == 0
