"""What a project says of the models it compares: their effects, and what they do not estimate."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from loopcal.errors import InputError
from loopcal.files.toml.place import Place
from loopcal.mechanisms.effects.model import Model, with_only
from loopcal.mechanisms.mechanism import Mechanism

if TYPE_CHECKING:
    from loopcal.files.project.project_schema import CompareEntry


def compare_spec(
    entry: CompareEntry | None, mechanism: Mechanism, place: Place
) -> Mapping[str, Model]:
    """The models by name; none where the project states none.

    Raises InputError for two of one name, and for effects or parameters that are not there.
    """
    found: dict[str, Model] = {}
    for i, model in enumerate(entry.model if entry else ()):
        here = place.at("model", i)
        if model.name in found:
            raise InputError(
                f"{model.name!r} names two models",
                code="duplicate-name",
                place=str(here.at("name")),
                remedy="give each a unique name",
            )
        found[model.name] = Model(tuple(model.effects), tuple(model.fixed))
        try:
            with_only(mechanism, found[model.name])
        except InputError as error:
            raise error.at(str(here)) from None
    return found
