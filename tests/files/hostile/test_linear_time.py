"""What a reader does grows as its text does, whatever repeats: steps are counted, no clock."""

from __future__ import annotations

import contextlib
import importlib
import re
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any

import pytest

from analyses.hostile_inputs import FRAGMENTS
from loopcal import errors
from loopcal.companions.robot.exports import ur
from loopcal.companions.robot.programs import program
from loopcal.companions.robot.programs.coordinates import JointAxes
from loopcal.companions.robot.programs.registry import BY_ENDING, DIALECTS
from loopcal.errors import InputError, LoopcalError
from loopcal.files.recognition import headers
from loopcal.files.recognition.headers import heading
from loopcal.files.tables import cells
from loopcal.files.tables.cells import number
from tests.files.hostile.steps import steps

AXES = JointAxes({f"joint_{i}": "rad" for i in range(1, 7)}, pulses=(1000.0,) * 6)
MODULES: dict[str, ModuleType] = {
    one.endings[0]: importlib.import_module(one.read.__module__) for one in DIALECTS.values()
}
ANY = ("a ", "1,", "(", "[", '"', ";", "=", "\n", "move(")
"""Fragments of a dialect that `FRAGMENTS` does not have."""
MOST = 2.6
"""Times the steps that twice the text may take."""


MATCHED = {"_HARMLESS", "_PART", "_ENDED", "yaskawa._POSITION", "yaskawa._MOVE"}
"""Patterns that a place is compared with, and that are not searched."""


def patterns(module: ModuleType) -> Iterator[tuple[re.Pattern[Any], bool]]:
    """Those of a module, and whether they begin where the text does."""
    short = module.__name__.rpartition(".")[2]
    for name, own in vars(module).items():
        if isinstance(own, re.Pattern):
            yield own, bool(MATCHED & {name, f"{short}.{name}"})


def repeats(ending: str) -> Iterator[Callable[[int], str]]:
    """Texts in which one fragment, or two in turn, repeat, on one line or on many."""
    own = FRAGMENTS.get(ending, ANY)
    for i, one in enumerate(own):
        for behind in (" ", own[(i + 5) % len(own)]):
            yield lambda n, one=one, behind=behind: own[0] + (one + behind) * n + "!"  # type: ignore[misc]


@pytest.mark.parametrize("ending", MODULES)
def test_no_pattern_of_a_dialect_backs_out_further_than_the_text_grows(ending: str) -> None:
    for pattern, anchored in patterns(MODULES[ending]):
        for text in repeats(ending):
            few, many = (steps(pattern, text(n), anchored=anchored).count for n in (8, 16))
            assert many < MOST * few + 100, (pattern.pattern, text(3))


@pytest.mark.parametrize("ending", MODULES)
def test_steps_are_those_of_the_searches_of_python(ending: str) -> None:
    for pattern, _ in patterns(MODULES[ending]):
        for text in repeats(ending):
            found = [m.span() for m in pattern.finditer(text(3))]
            assert steps(pattern, text(3)).spans == found, (pattern.pattern, text(3))


class Watched:
    """The module `re`, or a pattern, with the characters that its searches pass over."""

    def __init__(self, own: Any, seen: list[int]) -> None:
        self.own, self.seen = own, seen

    def __getattr__(self, name: str) -> Any:
        its = getattr(self.own, name)
        if name == "compile":
            return lambda *given: Watched(its(*given), self.seen)
        return its

    def _passed(self, name: str, *given: Any) -> Any:
        its = given if isinstance(self.own, re.Pattern) else given[1:]
        text = its[0]
        begin = its[1] if len(its) > 1 and isinstance(self.own, re.Pattern) else 0
        end = its[2] if len(its) > 2 and isinstance(self.own, re.Pattern) else len(text)
        found = getattr(self.own, name)(*given)
        self.seen.append((end if found is None else found.end()) - begin + 1)
        return found

    def search(self, *given: Any) -> Any:
        return self._passed("search", *given)

    def match(self, *given: Any) -> Any:
        return self._passed("match", *given)

    def fullmatch(self, *given: Any) -> Any:
        return self._passed("fullmatch", *given)


def passed(ending: str, text: str, monkeypatch: pytest.MonkeyPatch) -> int:
    """Characters that the searches of a reader pass over, those of `finditer` aside."""
    seen: list[int] = []
    with monkeypatch.context() as patch:
        for module in (
            MODULES[ending],
            importlib.import_module("loopcal.companions.robot.programs.copying"),
        ):
            for name, own in vars(module).copy().items():
                if isinstance(own, re.Pattern) or own is re:
                    patch.setattr(module, name, Watched(own, seen))
        with contextlib.suppress(LoopcalError):
            BY_ENDING[ending].read(text, "prog", AXES)
    return sum(seen)


@pytest.mark.parametrize("ending", MODULES)
def test_a_program_is_searched_in_proportion_to_its_length(
    ending: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for text in repeats(ending):
        few, many = (passed(ending, text(n), monkeypatch) for n in (100, 200))
        assert many < MOST * few + 2_000, text(3)


@pytest.mark.parametrize("mark", [".", ","])
@pytest.mark.parametrize("text", ["1", "12.", "1e", ".5", "1.e+"])
def test_the_number_in_a_cell_is_seen_in_one_pass(mark: str, text: str) -> None:
    for pattern in (cells._NUMBER[mark], program.NUMBER):
        whole = re.compile(rf"\A{pattern.pattern}\Z", re.ASCII)
        few, many = (
            steps(whole, text.replace(".", mark) * n + "x", anchored=True).count for n in (40, 80)
        )
        assert many < MOST * few
    with pytest.raises(ValueError, match="x"):
        number(text * 20_000 + "x", mark)


@pytest.mark.parametrize("part", ["(", "[ ", "a )", "/", " ", "(]", "a/ "])
def test_a_header_is_taken_apart_without_a_pattern_that_backs_out(part: str) -> None:
    for pattern, _ in patterns(headers):
        few, many = (steps(pattern, part * n + "!").count for n in (20, 40))
        assert many < MOST * few + 100
    assert heading(part * 3_000 + "J1 [deg]").unit == "deg"


@pytest.mark.parametrize("part", ["'", '"', "\\", "'\\", "' ", " 'a", "a", "\\\\'"])
def test_a_message_is_shortened_in_proportion_to_its_length(part: str) -> None:
    for pattern in (errors._QUOTED, errors._UNBROKEN):
        few, many = (steps(pattern, f"it is {part * n}").count for n in (20, 40))
        assert many < 4.2 * few + 100, "each quote looks at most 1000 characters ahead"
    assert len(str(InputError(f"it is '{part * 5_000}", code="invalid-value"))) < 3_000


def test_the_hash_of_a_controller_is_sought_once_per_line() -> None:
    few, many = (steps(ur._HASH, "\n " * n).count for n in (50, 100))
    assert many < MOST * few


@pytest.mark.parametrize(
    ("slow", "part"), [(r"\A\d+\.?\d*x", "1"), (r"\A\s*(?:;\s*)?\s*x", " "), (r"a[^;]*;", "a")]
)
def test_where_steps_do_grow_faster_this_is_seen(slow: str, part: str) -> None:
    few, many = (steps(re.compile(slow), part * n).count for n in (20, 40))
    assert many > MOST * few
