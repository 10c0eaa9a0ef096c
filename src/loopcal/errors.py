"""The errors a user can meet, each with a code, and with the exit code that ends the command.

An error says what is wrong, why that stops us, and what to do about it. Its code names its kind
and stays the same when the wording changes:

>>> raise InputError("sd is -0.1 mrad; an sd cannot be negative",
...                  place="arm.toml: noise.theta_1", remedy="give 0 for an exact sensor")
Traceback (most recent call last):
    ...
loopcal.errors.InputError: arm.toml: noise.theta_1: sd is -0.1 mrad; an sd cannot be negative
  What to do: give 0 for an exact sensor
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from shlex import join
from typing import Literal, NoReturn, Self

LONGEST_NAME, LONGEST_TEXT, MOST_NAMES = 80, 2_000, 10
"""Characters of a quoted name and of a whole text, and names of a list, that a message shows."""
_QUOTED = re.compile(r"""(?<!\w)(['"])(?:\\.|(?!\1(?!\w))[^\\]){0,1000}+\1(?!\w)""", re.DOTALL)
_OPTION = re.compile(r"loopcal [a-z]+ [^\n;]*|(?<![\w-])--([a-z][a-z-]*)(?: (?=['A-Z0-9]))?")
NEXT_COMMAND = "Next command:\n"
"""What stands before the command that an error names."""
_UNBROKEN = re.compile(r"\S{300,}+")


Code = Literal[
    "conflicting-keys",
    "duplicate-column",
    "duplicate-name",
    "exact-readings",
    "failing-function",
    "implausible-readings",
    "implausible-unit",
    "internal",
    "invalid-covariance",
    "invalid-number",
    "invalid-syntax",
    "invalid-usage",
    "invalid-value",
    "lost-reflector",
    "mismatched-machines",
    "mismatched-poses",
    "missing-column",
    "missing-dependency",
    "missing-file",
    "missing-key",
    "missing-reading",
    "missing-sd",
    "no-data",
    "no-free-parameter",
    "no-outputs",
    "no-scheduler",
    "no-trustworthy-result",
    "not-converged",
    "not-identifiable",
    "not-verified",
    "open-loops",
    "outside-domain",
    "too-few-poses",
    "too-few-results",
    "too-large",
    "undetermined-quantities",
    "unknown-name",
    "unknown-size",
    "unknown-unit",
    "unreadable-file",
    "unsupported",
    "untraceable-function",
    "unwritable-file",
    "version-mismatch",
    "worker-lost",
    "wrong-file-type",
    "wrong-schema",
    "wrong-shape",
    "wrong-unit",
]
"""The kinds of errors; `docs/reference/messages.md` describes each."""


class Remedy(str):
    """What to do, with the word that was meant: `meant` is a name and what should stand there."""

    meant: tuple[str, ...] = ()


class LoopcalError(Exception):
    """Root of all errors raised on purpose; by itself it means a fault of ours (exit code 1).

    code: its kind, where it is not the usual one of its class; place: file, row and key; remedy:
    what to do; options: those with which the same command goes on; meant: an argument of it, and
    the words that should stand there; follows: another command, files of the user in capitals;
    command: what to type next; again: whether that is the same command, once the remedy is done.
    """

    options: tuple[str, ...] = ()
    meant: tuple[str, ...] = ()
    follows = ""
    command = ""
    again = False
    exit_code = 1
    usual_code: Code = "internal"

    def __init__(
        self,
        message: str,
        *,
        code: Code | None = None,
        place: str | None = None,
        remedy: str | None = None,
    ) -> None:
        self.code: Code = code or self.usual_code
        self.message = _bounded(message)
        self.place = place and _bounded(place).replace("\n", "\\n")
        self.remedy = remedy and _bounded(remedy)
        if isinstance(remedy, Remedy):
            self.meant = remedy.meant
        super().__init__(self.message)

    def __str__(self) -> str:
        return in_python(self.text)

    @property
    def text(self) -> str:
        """As the command line prints it; as a text the error names arguments of Python."""
        text = f"{self.place}: {self.message}" if self.place else self.message
        text = f"{text}\n  What to do: {self.remedy}" if self.remedy else text
        label = "Then run:\n" if self.again else NEXT_COMMAND
        return f"{text}\n  {label}    {self.command}" if self.command else text

    def offering(self, *options: str) -> Self:
        """The same error with the options that decide what is open."""
        self.options = options
        return self

    def meaning(self, argument: str, *others: str) -> Self:
        """The same error with the words that should stand for an argument of the command."""
        self.meant = (argument, *others)
        return self

    def then(self, command: str) -> Self:
        """The same error with the command that follows; PROJECT, RESULT, READINGS and ROBOT stand
        for files of the user."""
        self.follows = command
        return self

    def next_command(self, words: Sequence[str]) -> None:
        """Fill in what to type next, where the error shows it; words: of the command that failed.

        Where nothing differs, the same command follows once the remedy is done.
        """
        mended = _with_options(_as_meant(words, *self.meant), self.options)
        self.again = sorted(mended) == sorted(words)
        self.command = join(["loopcal", *mended])

    def at(self, place: str) -> LoopcalError:
        """The same error with the place filled in, for callers that know the file."""
        joined = f"{place}: {self.place}" if self.place else place
        error = type(self)(self.message, code=self.code, place=joined, remedy=self.remedy)
        error.options, error.meant, error.command = self.options, self.meant, self.command
        error.follows = self.follows
        return error


class UsageError(LoopcalError):
    """A command called with arguments that do not go together (exit code 2)."""

    exit_code = 2
    usual_code: Code = "invalid-usage"


class InputError(LoopcalError):
    """A file, column, unit, value or key that cannot be used as it stands (exit code 3)."""

    exit_code = 3
    usual_code: Code = "invalid-value"


class DomainError(InputError):
    """An operation of a loop equation met a value outside its domain (exit code 3)."""

    usual_code: Code = "outside-domain"


def unknown_name(
    words: str, name: str, names: Iterable[str], place: str | None = None
) -> InputError:
    """The error for a name that is none of those there are: what to do names the nearest."""
    return InputError(words, code="unknown-name", place=place, remedy=nearest(name, names))


def refuse_repeated(
    names: Iterable[str],
    words: str,
    remedy: str = "give each a unique name",
    place: Callable[[int], object] = lambda _: None,
) -> None:
    """Raise InputError for the first name that stands among those before it.

    words: the message, with {!r} for the name; place: of the name with this number, from 0.
    """
    before: set[str] = set()
    for i, name in enumerate(names):
        if name in before:
            at = place(i)
            raise InputError(
                words.format(name),
                code="duplicate-name",
                place=None if at is None else str(at),
                remedy=remedy,
            )
        before.add(name)


@contextmanager
def placed(place: object, *, unless_stated: bool = False) -> Iterator[None]:
    """Give what is raised inside its place in a file, ahead of the place that it states.

    place: a text, or what becomes one; unless_stated: leave errors alone that state one.
    """
    try:
        yield
    except InputError as error:
        raise error if unless_stated and error.place else error.at(str(place)) from None


class Unfinished(InputError):
    """What was written is whole, but the command could not do the rest (exit code 5)."""

    exit_code = 5
    usual_code: Code = "unwritable-file"

    @classmethod
    def of(cls, error: LoopcalError) -> Unfinished:
        """The same error, met after files were written."""
        return cls(error.message, code=error.code, place=error.place, remedy=error.remedy)


class NoTrustworthyResult(LoopcalError):
    """The fit ended, but its result does not meet what was asked of it (exit code 4)."""

    exit_code = 4
    usual_code: Code = "no-trustworthy-result"


def in_python(words: str) -> str:
    """Words with the options of the command line as arguments; command lines stay.

    >>> in_python("name --urdf FILE or --sheet 'A', or: loopcal init a.csv --urdf FILE")
    "name urdf=FILE or sheet='A', or: loopcal init a.csv --urdf FILE"
    """
    return _OPTION.sub(lambda m: m[0] if not m[1] else f"{m[1].replace('-', '_')}=", words)


def short(text: str, most: int = LONGEST_NAME) -> str:
    """The text with its middle cut out where it has more characters than `most`.

    >>> short("a" * 50 + "b" * 50, 21)
    'aaaaaaaa[...]bbbbbbbb'
    """
    half = (most - 5) // 2
    return text if len(text) <= most else f"{text[:half]}[...]{text[-half:]}"


def listed(names: Iterable[str], most: int = MOST_NAMES) -> str:
    """Names in quotes for a message: the first few, and how many more there are.

    >>> listed(["x", "y", "z"], most=2)
    "'x', 'y' and 1 more"
    """
    every = list(names)
    shown = ", ".join(repr(short(name)) for name in every[:most])
    return f"{shown} and {len(every) - most} more" if len(every) > most else shown


def closest(name: str, choices: Sequence[str]) -> str | None:
    """The known spelling nearest to `name`; None where none is near."""
    # Bounded in number and length: a damaged file may offer any number of names of any length.
    folded = {choice[:200].casefold(): choice for choice in reversed(choices[:1000])}
    typed = name[:200].casefold()
    close = get_close_matches(typed, folded, n=1, cutoff=0.6)
    if not close and len(typed) > 2:  # an abbreviation, as thr of three
        close = [one for one in folded if one[:1] == typed[0] and _abbreviates(typed, one)]
    return folded[close[0]] if len(close) == 1 else None


def _abbreviates(short_name: str, name: str) -> bool:
    """Whether all letters of the short name are in the other one, in their order."""
    rest = iter(name)
    return all(letter in rest for letter in short_name)


def nearest(name: str, candidates: Iterable[str]) -> Remedy:
    """A remedy naming the known spelling nearest to `name`, or the first of them.

    >>> nearest("collumns", ["columns", "file"])
    "did you mean 'columns'?"
    """
    choices = list(candidates)
    close = closest(name, choices)
    every = "known are " + listed(choices, 40) if choices else "none is known here"
    remedy = Remedy(f"did you mean {close!r}?" if close else every)
    remedy.meant = (name, close) if close else (name, *choices[:1])
    return remedy


class Instead:
    """A constructor that a class does not have, and the calls that do what its name says."""

    def __init__(self, words: str) -> None:
        self.words = words

    def __get__(self, instance: object, owner: type) -> NoReturn:
        raise AttributeError(f"{owner.__name__} has no such constructor: use {self.words}")


def _as_meant(words: Sequence[str], argument: str = "", *others: str) -> list[str]:
    """Words of a command line with others for an argument, or for one name of a list in it."""
    mended: list[str] = []
    for word in words:
        before, equals, after = word.rpartition("=" if word.startswith("--") else "\n")
        names = after.split(",")
        if word == argument:
            mended += others
        elif argument in names and len(others) == 1:
            listed_names = ",".join(others[0] if name == argument else name for name in names)
            mended.append(f"{before}{equals}{listed_names}")
        else:
            mended.append(word)
    return mended


def _with_options(words: Sequence[str], options: Sequence[str]) -> list[str]:
    """Words of a command line with these options, in place of others of the same name.

    Poses to leave out are added to those that are named.
    """
    names = [option for option in options if option.startswith("--")]
    if names == ["--exclude"] and names[0] in words[:-1]:
        options = [names[0], f"{words[[*words].index(names[0]) + 1]},{options[-1]}"]
    kept = [
        w for i, w in enumerate(words) if not {w.partition("=")[0], *words[i - 1 : i]} & {*names}
    ]
    return [*kept, *options]


def _bounded(text: str) -> str:
    """A text of bounded length, long quoted names cut."""
    if len(text) > LONGEST_NAME:
        text = _UNBROKEN.sub(lambda run: short(run[0], 300), text)
        text = _QUOTED.sub(lambda quoted: short(quoted[0], LONGEST_NAME + 2), text)
    return short(text, LONGEST_TEXT)
