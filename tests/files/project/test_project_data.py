"""The readings of a project: as the file says, in SI, with noise by pose and with warnings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from loopcal.errors import InputError
from loopcal.files.project.project_data import load_dataset
from loopcal.files.project.project_file import read_project
from tests.refusals import refused

HEAD = 'schema = 1\n[mechanism]\ntype = "planar-two-link"\n[noise]\n"*" = 1e-3\n'
CSV = "pose,A,B,X,Y,uX\na,0,10,1400,0,0.1\nb,30,20,1000,600,0\nc,60,40,700,800,0.3\n"
COLUMNS = """
phi2 = { column = "A", unit = "deg" }
phi3 = { column = "B", unit = "deg" }
xP = { column = "X", unit = "mm" }
yP = { column = "Y", unit = "mm" }
"""


def load(folder: Path, data: str, *, csv: str = CSV, head: str = HEAD, columns: str = COLUMNS):
    (folder / "poses.csv").write_text(csv, "utf-8")
    path = folder / "project.toml"
    path.write_text(f'{head}[data]\nfile = "poses.csv"\n{data}\n[data.columns]\n{columns}', "utf-8")
    return load_dataset(read_project(path))


def test_readings_come_in_si_with_their_ids(tmp_path):
    data = load(tmp_path, 'pose = "pose"').dataset
    assert data.poses == ("a", "b", "c")
    np.testing.assert_allclose(data["phi3"], np.radians([10, 20, 40]))
    np.testing.assert_allclose(data["xP"], [1.4, 1.0, 0.7])
    assert data.source.columns["xP"] == "X"


def test_a_coverage_factor_divides_the_column_of_sds(tmp_path):
    column = '{ column = "X", unit = "mm", sd_column = "uX", coverage = 2, sd_at_least = 0.02 }'
    columns = COLUMNS.replace('{ column = "X", unit = "mm" }', column)
    loaded = load(tmp_path, "", columns=columns)
    np.testing.assert_allclose(loaded.dataset.sds["xP"], [0.5e-4, 2e-5, 1.5e-4])


@pytest.mark.parametrize(
    ("keys", "code"),
    [("coverage = 2", "conflicting-keys"), ('sd_column = "uX", coverage = 0', "invalid-value")],
)
def test_a_coverage_factor_needs_a_column_of_sds_and_is_positive(tmp_path, keys, code):
    columns = COLUMNS.replace('"X", unit = "mm"', f'"X", {keys}')
    with refused(code, "project.toml: data.columns.xP"):
        load(tmp_path, "", columns=columns)


def test_columns_of_their_own_name_complement_those_stated(tmp_path):
    csv = CSV.replace("X,Y", "xP,Y")
    columns = COLUMNS.replace('xP = { column = "X", unit = "mm" }\n', "")
    loaded = load(tmp_path, 'units = { length = "mm" }', csv=csv, columns=columns)
    np.testing.assert_allclose(loaded.dataset["xP"], [1.4, 1.0, 0.7])
    with refused("missing-column", "'xP'"):
        load(tmp_path, "", columns=columns)


@pytest.mark.parametrize("every", [1, 2])
def test_column_zero_is_the_number_of_the_row(tmp_path, every):
    columns = COLUMNS.replace('"A"', "0").replace("deg", "rad", 1)
    data = load(tmp_path, f"pose = 0\nevery = {every}", columns=columns).dataset
    assert data.poses == ("1", "2", "3")[::every]
    assert data["phi2"].tolist() == [1, 2, 3][::every]


def test_a_quantity_without_a_column_is_named_with_the_columns_there(tmp_path):
    columns = COLUMNS.replace('xP = { column = "X", unit = "mm" }\n', "")
    with refused("missing-column", "'xP'", "'uX'", "sd = inf"):
        load(tmp_path, "", columns=columns)


def test_a_known_constant_without_a_column_is_not_offered_an_sd(tmp_path):
    head = HEAD.replace(
        '"planar-two-link"\n',
        '"serial"\njoint = [{ name = "q1" }]\n[[mechanism.instrument]]\ntype = "pose"\n',
    )
    csv = "q1,x,y,z,qw,qx,qy\n0,1,0,0,1,0,0\n"
    with refused("missing-column", "known constant 'qz'", "every pose") as caught:
        load(tmp_path, "", csv=csv, head=head, columns="")
    assert "inf" not in str(caught.value)


def test_poses_are_thinned_and_left_out(tmp_path):
    data = load(tmp_path, 'pose = "pose"\nevery = 2\nexclude = ["a"]').dataset
    assert data.poses == ("c",)
    assert data.source.excluded == ("a",)


def test_sds_of_readings_come_from_their_column_and_have_a_floor(tmp_path):
    column = 'xP = { column = "X", unit = "mm", sd_column = "uX", sd_at_least = 0.02 }'
    columns = COLUMNS.replace('xP = { column = "X", unit = "mm" }', column)
    loaded = load(tmp_path, "", columns=columns)
    np.testing.assert_allclose(loaded.dataset.sds["xP"], [1e-4, 2e-5, 3e-4])
    assert loaded.warnings == ()
    rounded = columns.replace(", sd_at_least = 0.02", ', sd_unit = "um"')
    loaded = load(tmp_path, "", columns=rounded)
    np.testing.assert_allclose(loaded.dataset.sds["xP"], [1e-7, 0.0, 3e-7])
    assert "exact" in str(loaded.warnings[0])


def test_a_blank_sd_beside_a_blank_reading_makes_nothing_exact(tmp_path):
    column = 'xP = { column = "X", unit = "mm", sd_column = "uX" }'
    columns = COLUMNS.replace('xP = { column = "X", unit = "mm" }', column)
    csv = CSV.replace("1000,600,0", ",600,")
    assert load(tmp_path, "", columns=columns, csv=csv).warnings == ()


COVARIANCE = "pose,A,B,X,Y,xx,xy,yy\na,0,9,1400,0,4,1,2\nb,1,2,1000,600,1,0,1\n"


def covariance_head(columns: str = '["xx", "xy", "yy"]') -> str:
    return f'{HEAD}xPyP = {{ covariance_columns = {columns}, unit = "mm" }}\n'


def test_covariances_by_pose_come_from_columns(tmp_path):
    loaded = load(tmp_path, "", csv=COVARIANCE, head=covariance_head())
    found = loaded.noise.entries[("xP", "yP")]
    np.testing.assert_allclose(found[0], np.array([[4, 1], [1, 2]]) * 1e-6)
    np.testing.assert_allclose(found[1], np.eye(2) * 1e-6)
    assert loaded.dataset.quantities == ("phi2", "phi3", "xP", "yP")


def test_a_covariance_follows_the_poses_that_are_used(tmp_path):
    loaded = load(tmp_path, "exclude = [1]", csv=COVARIANCE, head=covariance_head())
    np.testing.assert_allclose(loaded.noise.entries[("xP", "yP")], np.eye(2)[None] * 1e-6)


def test_no_covariance_is_needed_of_what_was_not_read(tmp_path):
    csv = COVARIANCE.replace("1400,0,4,1,2", ",5,,,2")
    loaded = load(tmp_path, "", csv=csv, head=covariance_head())
    found = loaded.noise.entries[("xP", "yP")]
    np.testing.assert_allclose(found[0], np.diag([1.0, 2e-6]))


@pytest.mark.parametrize(
    ("csv", "columns", "words"),
    [
        (COVARIANCE.replace("4,1,2", "4,,2"), '["xx", "xy", "yy"]', "in 1 poses"),
        (COVARIANCE.replace("4,1,2", "4,9,2"), '["xx", "xy", "yy"]', "negative eigenvalue"),
        (COVARIANCE, '["xx", "xy", "xy", "yz"]', "'yz'"),
        (COVARIANCE, '["xx", "X", "yy"]', "twice"),
    ],
)
def test_columns_that_hold_no_covariance_are_refused(tmp_path, csv, columns, words):
    with pytest.raises(InputError) as caught:
        load(tmp_path, "", csv=csv, head=covariance_head(columns))
    assert words in str(caught.value)


def test_the_data_file_may_be_named_by_the_environment(tmp_path, monkeypatch):
    (tmp_path / "arm.csv").write_text("phi2,phi3,xP,yP\n0,1,1,1\n", "utf-8")
    text = f'{HEAD}[data]\nfile = "${{LOOPCAL_TEST_FOLDER}}/arm.csv"\n'
    monkeypatch.setenv("LOOPCAL_TEST_FOLDER", str(tmp_path))
    assert len(load_dataset(read_project("-", text=text)).dataset) == 1
    monkeypatch.delenv("LOOPCAL_TEST_FOLDER")
    with pytest.raises(InputError) as caught:
        load_dataset(read_project("-", text=text))
    assert "LOOPCAL_TEST_FOLDER, which is not set" in caught.value.message
    assert "export LOOPCAL_TEST_FOLDER=" in str(caught.value.remedy)
    assert caught.value.place == "standard input: data.file"


def test_units_that_cannot_be_right_stop(tmp_path):
    csv = CSV.replace("a,0,10", "a,170,100").replace("b,30,20", "b,-170,20")
    with refused("implausible-unit"):
        load(tmp_path, "", csv=csv, columns=COLUMNS.replace('"deg"', '"rad"'))


@pytest.mark.parametrize(
    ("head", "code", "stated"),
    [
        (HEAD, "missing-key", ("project.toml", "[data]")),
        (f'{HEAD}[data]\nfile = "absent.csv"\n', "missing-file", ("absent.csv",)),
        (f'{HEAD}[data]\nfile = "."\n', "wrong-file-type", ("folder",)),
    ],
)
def test_readings_that_are_not_there_are_missed(tmp_path, head, code, stated):
    path = tmp_path / "project.toml"
    path.write_text(head, "utf-8")
    with refused(code, *stated):
        load_dataset(read_project(path))


def test_readings_that_were_never_simulated_can_be(tmp_path):
    ranges = "ranges = { phi2 = { from = 0, to = 1 }, phi3 = { from = 0, to = 1 } }"
    path = tmp_path / "project.toml"
    path.write_text(f'{HEAD}[data]\nfile = "p.csv"\n[simulation]\nposes = 2\n{ranges}\n', "utf-8")
    with refused("missing-file", "loopcal simulate", "project.toml", "--out", "p.csv"):
        load_dataset(read_project(path))
