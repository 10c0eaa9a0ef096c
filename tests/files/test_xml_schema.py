"""Validation against a schema of the user: imports lie in its folder, nothing is fetched."""

from __future__ import annotations

from pathlib import Path

import pytest

from loopcal.companions.record.xml_schema import check_against, schema_version
from tests.refusals import refused

XS = 'xmlns:xs="http://www.w3.org/2001/XMLSchema"'
INNER = f"""<xs:schema {XS} targetNamespace="urn:inner">
<xs:element name="size" type="xs:double"/></xs:schema>"""


def outer(location: str, head: str = "") -> str:
    return f"""<?xml version="1.0"?>{head}
<xs:schema {XS} xmlns:i="urn:inner" version="7.1" targetNamespace="urn:outer">
<xs:import namespace="urn:inner" schemaLocation="{location}"/>
<xs:element name="all"><xs:complexType><xs:sequence><xs:element ref="i:size"/></xs:sequence>
</xs:complexType></xs:element></xs:schema>"""


def xml(size: str) -> str:
    return f'<all xmlns="urn:outer"><size xmlns="urn:inner">{size}</size></all>'


@pytest.mark.parametrize(
    ("location", "at"),
    [
        ("inner.xsd", "inner.xsd"),
        ("https://schema.invalid/v1/si/inner.xsd", "inner.xsd"),
        ("https://schema.invalid/v1/si/inner.xsd", "si/inner.xsd"),
        ("../si/inner.xsd", "../si/inner.xsd"),
    ],
)
def test_imports_are_taken_from_the_folder(tmp_path: Path, location: str, at: str) -> None:
    folder = tmp_path / "schemas"
    for path, text in ((folder / "outer.xsd", outer(location)), (folder / at, INNER)):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    check_against(xml("1.5"), folder / "outer.xsd")
    with refused("invalid-value", "line 1", "wide"):
        check_against(xml("wide"), folder / "outer.xsd")
    assert schema_version(folder / "outer.xsd") == "7.1"


def test_an_import_that_is_not_there_is_named_and_not_fetched(tmp_path: Path) -> None:
    (tmp_path / "outer.xsd").write_text(outer("https://schema.invalid/si/inner.xsd"))
    with refused(
        "missing-file", "https://schema.invalid/si/inner.xsd", str(tmp_path / "inner.xsd")
    ):
        check_against(xml("1"), tmp_path / "outer.xsd")


def test_entities_of_a_schema_read_no_file(tmp_path: Path) -> None:
    secret = tmp_path / "secret.txt"
    secret.write_text('<xs:element name="secret"/>')
    head = f'<!DOCTYPE xs:schema [<!ENTITY e SYSTEM "{secret.as_uri()}">]>'
    text = outer("inner.xsd", head).replace("</xs:schema>", "&e;</xs:schema>")
    for name, content in (("outer.xsd", text), ("inner.xsd", INNER)):
        (tmp_path / name).write_text(content)
    for name, content in (("a.xsd", outer("b.xsd")), ("b.xsd", text.replace("urn:outer", "urn:b"))):
        (tmp_path / name).write_text(content)
    for path in ("outer.xsd", "a.xsd"):
        with refused("invalid-value" if path == "outer.xsd" else "wrong-file-type"):
            check_against('<secret xmlns="urn:outer"/>', tmp_path / path)


def test_a_document_type_as_that_of_xml_signatures_is_read(tmp_path: Path) -> None:
    """Its own entities are, but neither its address nor entities without end."""
    head = '<!DOCTYPE schema PUBLIC "-//W3C//DTD" "http://schema.invalid/XMLSchema.dtd" [{}]>'
    own = head.format("<!ATTLIST schema xmlns:ds CDATA #FIXED 'urn:ds'><!ENTITY % p ''>")
    (tmp_path / "outer.xsd").write_text(outer("inner.xsd"))
    (tmp_path / "inner.xsd").write_text(own + INNER)
    check_against(xml("1.5"), tmp_path / "outer.xsd")
    more = "".join(f"<!ENTITY a{i + 1} '{f'&a{i};' * 50}'>" for i in range(8))
    endless = head.format(f"<!ENTITY a0 '{'x' * 1000}'>{more}")
    note = "<xs:annotation><xs:documentation>&a8;</xs:documentation></xs:annotation></xs:schema>"
    (tmp_path / "inner.xsd").write_text(endless + INNER.replace("</xs:schema>", note))
    with refused("wrong-file-type", "inner.xsd"):
        check_against(xml("1.5"), tmp_path / "outer.xsd")


@pytest.mark.parametrize(
    "text", ["", "no XML", "<other/>", f"<xs:schema {XS}><xs:element/></xs:schema>"]
)
def test_what_is_no_schema_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "dcc.xsd").write_text(text)
    with refused("wrong-file-type", "dcc.xsd"):
        check_against("<all/>", tmp_path / "dcc.xsd")
    with refused("missing-file"):
        check_against("<all/>", tmp_path / "none.xsd")
