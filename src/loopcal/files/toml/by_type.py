"""Tables of several types: the model of a type is built when a file first names it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import reduce
from operator import or_
from typing import Annotated, Any

from pydantic import (
    BaseModel,
    Discriminator,
    GetCoreSchemaHandler,
    GetJsonSchemaHandler,
    Tag,
    TypeAdapter,
)
from pydantic_core import CoreSchema, PydanticKnownError, core_schema

from loopcal.errors import nearest
from loopcal.files.toml.model import complaint


@dataclass(frozen=True)
class ByType:
    """Annotates a table that is of one of several types.

    kinds: names of the types; model: the model of a type, or KeyError for what is none; named: the
    type of a table, where it is not what the key `type` says.
    """

    kinds: Callable[[], Iterable[str]]
    model: Callable[[str], type[BaseModel]]
    named: Callable[[Any], str] | None = None

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._validated)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        tables: list[Any] = [Annotated[self.model(kind), Tag(kind)] for kind in self.kinds()]
        one_of: Any = reduce(or_, tables)
        adapter: Any = TypeAdapter(Annotated[one_of, Discriminator(self.named or "type")])
        return handler(adapter.core_schema)

    def _validated(self, table: Any) -> BaseModel:
        if not isinstance(table, Mapping):
            raise PydanticKnownError("dict_type")
        if self.named is None and "type" not in table:
            raise complaint("'type' is missing", 'add type = "..."', "missing-key")
        kind = str(self.named(table) if self.named else table["type"])
        try:
            model = self.model(kind)
        except KeyError:
            remedy = nearest(kind, self.kinds())
            raise complaint(f"the type {kind!r} is not known", remedy, "unknown-name") from None
        return model.model_validate(table)
