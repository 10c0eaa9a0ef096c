"""XML checked against a published schema that the user has on the disk; nothing is fetched."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from loopcal.errors import InputError
from loopcal.files.guarded import Stopped, guarded
from loopcal.files.tables.raw import bytes_of

MOST_BYTES = 5_000_000
SHOWN = 5
"""Places that a message names."""
_XS = "{http://www.w3.org/2001/XMLSchema}"
_IMPORTS = (f"{_XS}import", f"{_XS}include")


def schema_version(schema: Path) -> str | None:
    """The version that a schema states of itself. Raises InputError for what is no schema."""
    version = _parsed(schema).get("version")
    return None if version is None else str(version)


def check_against(content: str, schema: Path) -> None:
    """Raise InputError where XML does not validate against a schema, or this has no end.

    The guarded child does it: a short schema may stand for any number of elements.

    What the schema imports is taken from the folder of the schema: by the stated path, by the name
    of the file, or by that and its last folder (`si/SI_Format.xsd`). An address is never opened.
    """
    arguments = {"content": content, "schema": str(schema.absolute())}
    try:
        guarded(f"{__name__}:validate", arguments, len(content))
    except Stopped as why:
        raise _no_schema(schema, str(why)) from None


def validate(content: str, schema: str) -> bytes:
    """`check_against`; runs in the child."""
    from lxml import etree

    path = Path(schema)
    files = _imported(path)

    class Local(etree.Resolver):  # type: ignore[misc]
        def resolve(self, url: str, _: str, context: Any) -> Any:
            imported = files.get(_name(url or ""))
            if imported is None:
                # All else, an address above all, is empty instead of fetched.
                return self.resolve_empty(context)
            return self.resolve_string(
                bytes_of(imported, MOST_BYTES), context, base_url=str(imported)
            )

    parser = _parser()
    parser.resolvers.add(Local())
    try:
        compiled = etree.XMLSchema(etree.parse(schema, parser))
    except (etree.XMLSchemaParseError, etree.XMLSyntaxError) as error:
        raise _no_schema(path, str(error)) from None
    document = etree.fromstring(content.encode("utf-8"), _parser())
    if not compiled.validate(document):
        complaints = [f"line {entry.line}: {entry.message}" for entry in compiled.error_log]
        more = f"\nand {len(complaints) - SHOWN} more" if len(complaints) > SHOWN else ""
        raise InputError(
            "the XML does not validate against this schema:\n"
            + "\n".join(complaints[:SHOWN])
            + more,
            code="invalid-value",
            place=schema,
            remedy="correct the keys of [record] that these lines name",
        )
    return b""


def _parser() -> Any:
    from lxml import etree

    return etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, dtd_validation=False
    )


def _parsed(path: Path) -> Any:
    from lxml import etree

    try:
        root = etree.fromstring(bytes_of(path, MOST_BYTES, empty_too=True), _parser())
    except (etree.XMLSyntaxError, ValueError) as error:
        raise _no_schema(path, str(error)) from None
    if root.tag != f"{_XS}schema":
        raise _no_schema(path, f"its first element is {root.tag}")
    return root


def _no_schema(path: Path, why: str) -> InputError:
    return InputError(
        f"this is no XML schema that can be used: {why}",
        code="wrong-file-type",
        place=str(path),
        remedy="name an .xsd file, with the schemas that it imports beside it",
    )


def _imported(schema: Path) -> dict[str, Path]:
    """The files that a schema imports, and these import, by name."""
    files: dict[str, Path] = {}
    waiting = [schema]
    while waiting:
        path = waiting.pop()
        for node in _parsed(path).iter(*_IMPORTS):
            location = node.get("schemaLocation")
            name = _name(location or "")
            # Schemas may import each other.
            if location is None or name in files:
                continue
            files[name] = _beside(location, path, schema)
            waiting.append(files[name])
    return files


def _beside(location: str, importing: Path, schema: Path) -> Path:
    path = PurePosixPath(urlsplit(location).path)
    named = Path(*path.parts[-2:]) if len(path.parts) > 1 else Path(path.name)
    stated = [importing.parent / location] if "://" not in location else []
    for at in (*stated, *(folder / p for folder in (importing.parent, schema.parent)
                          for p in (path.name, named))):  # fmt: skip
        if at.is_file():
            return at
    raise InputError(
        f"the schema imports {location}, which is not beside it, and no address is opened",
        code="missing-file",
        place=str(importing),
        remedy=f"save {location} as {schema.parent / path.name}",
    )


def _name(location: str) -> str:
    return PurePosixPath(urlsplit(location).path).name
