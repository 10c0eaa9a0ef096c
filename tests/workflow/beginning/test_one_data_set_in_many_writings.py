"""One data set is recognised as the same, or refused, however it is written.

Ids, layouts, numbers, encodings, marks of headers and sheets are varied; what is compared are the
joints [rad] and the points [m] that are recognised.
"""

from __future__ import annotations

import codecs
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import xlsxwriter

import loopcal as lc
from loopcal.errors import InputError
from loopcal.files.recognition.fields import Source
from loopcal.files.recognition.joins import joined
from loopcal.files.recognition.layouts import layouts
from loopcal.files.recognition.sources import sources_of
from loopcal.files.tables.readers import read_dataset
from tests.reference import dh_arm

N = 24
JOINTS = dh_arm.poses(N, seed=5)
FRAMES = dh_arm.seen(JOINTS, sd=2e-5)
SEATS = np.array([[0.0, 0.0, 0.0], [0.05, -0.03, 0.04]])
"""Where two reflectors sit on the tool [m]."""
AWAY = np.array([3.5, -4.5, 2.5])
POINTS = AWAY + np.stack([FRAMES[:, :3, 3] + FRAMES[:, :3, :3] @ s for s in SEATS], axis=1)
"""(N, 2, 3) [m], far from the station: all beyond a metre in x and y."""
IDS = {
    "numeric": [str(i) for i in range(1, N + 1)],
    "text": [f"P{i}" for i in range(1, N + 1)],
    "padded": [f"{i:03d}" for i in range(1, N + 1)],
    "float": [f"{i}.0" for i in range(1, N + 1)],
    "none": None,
}
ENGLISH = [*(f"J{i} [deg]" for i in range(1, 7)), "x [mm]", "y [mm]", "z [mm]"]
CHINESE = [*(f"关节{i}（度）" for i in range(1, 7)), "x（毫米）", "y（毫米）", "z（毫米）"]
ID, TARGET = {False: "pose", True: "姿态"}, {False: "reflector", True: "靶球"}


def grouped(value: float, group: str, decimal: str) -> str:
    """With six decimals, thousands divided."""
    return f"{value:,.6f}".replace(",", "G").replace(".", decimal).replace("G", group)


def rows_of(
    kind: str, layout: str, chinese: bool, group: str = "", decimal: str = "."
) -> tuple[list[str], list[list[str]]]:
    """Header and cells. layout: wide, long (a row per reflector), or either with three shots."""

    def cells(*values: np.ndarray) -> list[str]:
        return [grouped(v, group, decimal) for v in np.concatenate(values).tolist()]

    names = list(CHINESE if chinese else ENGLISH)
    ids, rng = IDS[kind], np.random.default_rng(3)
    rows = []
    for i, (joints, points) in enumerate(zip(np.degrees(JOINTS), 1e3 * POINTS, strict=True)):
        first = [] if ids is None else [ids[i]]
        if layout.startswith("wide"):
            off = rng.normal(0.0, 0.01, (3, 3)) if layout == "wide shots" else np.zeros((1, 3))
            rows += [[*first, *cells(joints, *(points + shot))] for shot in off - off.mean(axis=0)]
            continue
        for seat, point in enumerate(points, 1):
            off = rng.normal(0.0, 0.01, (3, 3)) if layout == "shots" else np.zeros((1, 3))
            for shot in off - off.mean(axis=0):
                rows.append([*first, f"SMR{seat}", *cells(joints, point + shot)])
    head = [] if ids is None else [ID[chinese]]
    if layout.startswith("wide"):
        own = [name[0] + str(k) + name[1:] for k in (1, 2) for name in names[6:]]
        return [*head, *names[:6], *own], rows
    return [*head, TARGET[chinese], *names], rows


def understood(*paths: Path) -> tuple[np.ndarray, np.ndarray]:
    """Joints (N, 6) [rad] and points (N, 6) [m] of files; InputError where they are refused."""
    sources: list[Source] = []
    for path in paths:
        sources += sources_of(path, len(sources))
    fields = joined(sources)
    (layout,) = layouts(fields.fields, 6)
    seen = [f for one in layout.seen for f in one.position]
    assert [f.unit for f in layout.joints] == ["deg"] * 6
    assert [f.unit for f in seen] == ["mm"] * 6
    joints = np.radians([f.values for f in layout.joints])
    return joints.T, 1e-3 * np.array([f.values for f in seen]).T


def assert_same(found: tuple[np.ndarray, np.ndarray]) -> None:
    np.testing.assert_allclose(found[0], JOINTS, atol=1e-8)
    np.testing.assert_allclose(found[1], POINTS.reshape(N, 6), atol=2e-8)


def written(folder: Path, head: list[str], rows: list[list[str]], **how: str) -> Path:
    """A text. how: delimiter, encoding, header (plain, or behind a sign of comments)."""
    mark = how.get("header", "")
    between = how.get("delimiter", ",")
    lines = [mark + between.join(head), *(between.join(row) for row in rows)]
    path = folder / "readings.csv"
    encoding = how.get("encoding", "utf-8")
    bom = codecs.BOM_UTF8 if encoding == "utf-8-bom" else b""
    text = "\r\n".join(lines) + "\r\n"
    path.write_bytes(bom + text.encode(encoding.removesuffix("-bom")))
    return path


@pytest.mark.parametrize(
    ("kind", "layout"), list(product(IDS, ("wide", "long", "shots", "wide shots")))
)
def test_the_kind_of_ids_and_the_layout_change_nothing(
    kind: str, layout: str, tmp_path: Path
) -> None:
    path = written(tmp_path, *rows_of(kind, layout, chinese=False))
    if kind == "none" and layout == "wide shots":
        assert len(understood(path)[0]) == 3 * N  # nothing says which rows are of one pose
        return
    if kind == "none" and layout != "wide":
        with pytest.raises(InputError) as refused:
            understood(path)
        assert "reflector" in str(refused.value)
        return
    assert_same(understood(path))


WRITINGS = [
    {"delimiter": delimiter, "group": group, "decimal": decimal}
    for delimiter, group, decimal in (
        *((";", "", "."), (";", "", ","), ("\t", "", "."), ("\t", "", ","), (" ", "", ",")),
        *((";", ",", "."), (";", ".", ","), ("\t", ",", "."), ("\t", ".", ",")),
        *(
            (";", " ", ","),
            (";", " ", "."),
            ("\t", "\u00a0", ","),
            (";", "'", "."),
            (",", " ", "."),
        ),
    )
]


@pytest.mark.parametrize("writing", WRITINGS)
@pytest.mark.parametrize(("kind", "layout"), [("numeric", "long"), ("text", "wide")])
def test_the_way_to_write_numbers_changes_nothing(
    writing: dict[str, str], kind: str, layout: str, tmp_path: Path
) -> None:
    head, rows = rows_of(kind, layout, False, writing["group"], writing["decimal"])
    head = [name.replace(" ", "_" if writing["delimiter"] == " " else " ") for name in head]
    head = [name.replace("_[", "[") for name in head]
    assert_same(understood(written(tmp_path, head, rows, delimiter=writing["delimiter"])))


ENCODINGS = ("utf-8", "utf-8-bom", "gb18030", "utf-16")


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize(("kind", "layout"), [("numeric", "long"), ("none", "wide")])
@pytest.mark.parametrize("header", ["", "% ", "%", "# "])
def test_the_encoding_and_the_mark_of_the_header_change_nothing(
    encoding: str, kind: str, layout: str, header: str, tmp_path: Path
) -> None:
    head, rows = rows_of(kind, layout, chinese=True)
    assert_same(understood(written(tmp_path, head, rows, encoding=encoding, header=header)))


SHEETS = [
    (kind, layout, sheets)
    for kind, layout in (("numeric", "wide"), ("text", "wide"), ("none", "wide"))
    for sheets in ("one", "two", "two in another order")
]


@pytest.mark.parametrize(("kind", "layout", "sheets"), [*SHEETS, ("numeric", "long", "one")])
def test_sheets_of_a_workbook_are_joined_as_files_are(
    kind: str, layout: str, sheets: str, tmp_path: Path
) -> None:
    head, rows = rows_of(kind, layout, chinese=False)
    ids = 0 if kind == "none" else 1
    parts = {"Readings": [*range(len(head))]}
    if sheets != "one":
        parts = {"Joints": [*range(6 + ids)], "Points": [*range(ids), *range(6 + ids, len(head))]}
    if sheets == "two in another order":
        parts = dict(reversed(parts.items()))
    with xlsxwriter.Workbook(tmp_path / "readings.xlsx") as book:
        for name, columns in parts.items():
            sheet = book.add_worksheet(name)
            sheet.write_row(0, 0, [head[c] for c in columns])
            for number, row in enumerate(rows, 1):
                cells = [row[c] if row[c][0] in "PS" else float(row[c]) for c in columns]
                sheet.write_row(number, 0, cells)
        book.add_worksheet("Notes").write(0, 0, "measured on Monday")
    assert_same(understood(tmp_path / "readings.xlsx"))


@pytest.mark.parametrize("layout", ["wide", "shots"])
def test_a_project_of_such_a_file_reads_it_as_it_was_recognised(
    layout: str, tmp_path: Path
) -> None:
    (tmp_path / "dh.csv").write_text(dh_arm.dh_table(), "utf-8")
    head, rows = rows_of("numeric", layout, True, ".", ",")
    path = written(tmp_path, head, rows, delimiter=";", encoding="gb18030", header="% ")
    made = lc.init(path, dh=tmp_path / "dh.csv", out=tmp_path / "out")
    assert ("shots" in str(made)) == (layout == "shots")
    loaded = lc.load_dataset(lc.read_project(tmp_path / "out" / "project.toml")).dataset
    assert len(loaded) == N
    result = lc.calibrate(made, method="least-squares")
    assert result.accuracy_after is not None
    assert result.accuracy_after.rms < 1e-4
    for name, values in made.dataset.readings.items():
        np.testing.assert_allclose(loaded[name], values, atol=1e-9)


@pytest.mark.parametrize(
    ("cells", "decimal", "values"),
    [
        (["1,234.5", "1,000", "999.5"], ".", [1234.5, 1000.0, 999.5]),
        (["1.234,5", "1.000", "999,5"], ",", [1234.5, 1000.0, 999.5]),
        (["-1'234.5", "12'000", "0.25"], ".", [-1234.5, 12000.0, 0.25]),
        (["1 234 567,5", "12 000", "0,25"], ",", [1234567.5, 12000.0, 0.25]),
        (["1,234,567", "12,000", "3"], ".", [1234567.0, 12000.0, 3.0]),
        (["1,234", "12,000", "999.5"], ".", None),
        (["1.234", "12.000", "999,5"], ",", None),
        (["1,234.5", "0,123"], ".", None),
        (["1,234.5", "12,34"], ".", None),
        (["1,234.5", "1,2345"], ".", None),
        (["1,234.5", "1,234,56"], ".", None),
        (["1,234.5", "1.234,5"], ".", None),
    ],
)
@pytest.mark.parametrize("large", [False, True])
def test_thousands_are_read_where_the_column_shows_them_and_refused_where_it_does_not(
    cells: list[str], decimal: str, values: list[float] | None, large: bool, tmp_path: Path
) -> None:
    path = tmp_path / "a.csv"
    filler = ["0" + decimal + "5"] * (60_000 if large else 3)  # large texts are read by polars
    rows = [f"{i};{cell}" for i, cell in enumerate([*cells, *filler], 1)]
    path.write_text("\n".join(["pose;x [mm]", *rows, *["# " + "-" * 90] * 1000 * large]), "utf-8")
    columns = {"x": {"column": "x [mm]", "unit": "mm"}}
    if values is None:
        with pytest.raises(InputError) as refused:
            read_dataset(path, columns, pose="pose", decimal=decimal)
        assert "row " in str(refused.value)
        assert refused.value.code == "invalid-number"
        return
    found = read_dataset(path, columns, pose="pose", decimal=decimal)
    np.testing.assert_allclose(found["x"][: len(cells)], 1e-3 * np.array(values))


@pytest.mark.parametrize(
    "text",
    ["Größe", "Längen", "naïve façade", "Maß [°]", "à â é è ê", "Übermaß", "Ångström µm", "Güte"],
)
def test_western_text_without_utf_8_is_not_taken_for_chinese(text: str, tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(f"pose;{text}\n1;2,5\n2;3,5\n".encode("cp1252"))
    assert list(read_dataset(path).quantities) == ["pose", text]
