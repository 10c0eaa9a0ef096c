"""Changes of a project's text that keep everything else of it: comments, order, spaces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from loopcal.errors import InputError


def with_value(text: str, keys: Sequence[str], value: Any) -> str:
    """The text with a value under these keys; None takes the key away.

    >>> with_value("[fit]\\nmethod = 'auto' # best\\n", ["fit", "method"], "least-squares")
    '[fit]\\nmethod = "least-squares" # best\\n'
    """
    document = _parsed(text)
    table = document
    for key in keys[:-1]:
        if key not in table:
            table[key] = _tomlkit().table()
        table = table[key]
    if value is None:
        table.pop(keys[-1], None)
    else:
        table[keys[-1]] = value
    return str(document.as_string())


def without_poses(text: str, poses: Sequence[str]) -> str:
    """The text with these poses among those that are left out (data.exclude)."""
    data = _parsed(text).get("data", {})
    kept = [str(pose) for pose in data.get("exclude", [])]
    return with_value(text, ["data", "exclude"], list(dict.fromkeys([*kept, *poses])))


def with_shift(text: str, changing: Sequence[str], at: Sequence[float], column: str) -> str:
    """The text with an effect `shift`: these parameters are others from each of these numbers on.

    column: of the known constant that counts poses. An effect for the same parameters gets the
    further steps.
    """
    effect = {
        "type": "shift",
        "name": f"shift of {', '.join(changing)}",
        "changing": list(changing),
        "column": column,
        "at": sorted(map(float, at)),
    }
    return _with_effect(text, effect)


def with_changes(text: str, lines: str, begins: Mapping[tuple[str, ...], Sequence[float]]) -> str:
    """The text with effects of other lines: `change_points.toml` of a result.

    begins: what changes together -> the numbers from which on its steps are taken; of what has no
    steps, the whole effect.
    """
    for effect in _parsed(lines).unwrap().get("mechanism", {}).get("effect", []):
        names = tuple(effect["changing"])
        if names not in begins:
            continue
        if "at" in effect:
            effect["at"] = [at for at in effect["at"] if at in begins[names]]
        text = _with_effect(text, effect)
    return text


def _with_effect(text: str, effect: Mapping[str, Any]) -> str:
    document = _parsed(text)
    mechanism = document.setdefault("mechanism", _tomlkit().table())
    effects = mechanism.get("effect")
    for entry in effects or ():
        same = entry.get("type") == effect["type"]
        if same and list(entry.get("changing", ())) == list(effect["changing"]):
            if "at" in effect:
                entry["at"] = sorted({*map(float, entry["at"]), *map(float, effect["at"])})
            return str(document.as_string())
    made = _tomlkit().table()
    made.update(effect)
    if effects is None:
        mechanism["effect"] = effects = _tomlkit().aot()
    effects.append(made)
    return str(document.as_string())


def _parsed(text: str) -> Any:
    try:
        return _tomlkit().parse(text)
    except Exception as error:
        raise InputError(
            f"the project cannot be changed here: {error}",
            code="invalid-syntax",
            remedy="edit the file by hand",
        ) from None


def _tomlkit() -> Any:
    try:
        import tomlkit
    except ModuleNotFoundError:
        raise InputError(
            "tomlkit is not installed, which changes projects",
            code="missing-dependency",
            remedy="pip install loopcal[app]",
        ) from None
    return tomlkit
