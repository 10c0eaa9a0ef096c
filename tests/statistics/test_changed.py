"""What changed: false alarms, power, place; `analyses/what_changed.py` at full size."""

from __future__ import annotations

import json
from functools import cache
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import loopcal as lc
from analyses.instruments import FIRST, TOOL, at, looked_at, setup
from analyses.verify import another_day
from analyses.what_changed import CHANGES, draw
from loopcal.estimation.problem.problem import build_problem
from loopcal.mechanisms.instruments.length import draw_wire
from loopcal.statistics.change_tests import _System
from loopcal.statistics.changed import LEVEL, Candidate, Change, WhatChanged, larger
from loopcal.statistics.innovation import Innovation
from loopcal.statistics.possible_changes import BETWEEN_DAYS, Possible, possible
from tests.reference.simulated import planar_arm
from tests.statistics.test_comparison import elsewhere, sds_of


@cache
def arm() -> lc.Result:
    """A six-axis arm calibrated with a tracker."""
    given = setup("six-axis spherical")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1)
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    return lc.calibrate(nominal, made.dataset, noise=given.noise, method="implicit-loop")


def later(seed: int = 7, **changed: float) -> lc.Verification:
    """The same arm on another day, its tracker moved, with these changes of its parameters."""
    given = setup("six-axis spherical")
    there = another_day(given, 1)
    values = {p.name: p.nominal for p in there.parameters}
    there = there.with_nominal({name: values[name] + by for name, by in changed.items()})
    some = {q: v[::3] for q, v in given.driven.items()}
    return lc.verify(arm(), lc.simulate(there, some, noise=given.noise, seed=seed).dataset)


def changes(found: lc.Verification) -> lc.WhatChanged:
    assert found.changes is not None
    return found.changes


def test_an_unchanged_machine_is_unchanged() -> None:
    found = later()
    assert changes(found).verdict == "unchanged"
    assert changes(found).found == ()
    assert found.verdict["consistent"].next is None
    assert not found.failed


@pytest.mark.parametrize("by", [np.radians(0.02), np.radians(-0.5), np.radians(4.0)])
def test_a_zero_that_moved_is_named_however_far_it_moved(by: float) -> None:
    found = later(offset_3=by)
    (change,) = changes(found).found
    assert (change.name, change.kind) == ("q3", "zero")
    assert abs(change.value - by) < 3.5 * change.sd
    assert change.low < change.value < change.high
    assert change.alike == ()  # what is added to the reading of a joint is its zero
    assert changes(found).verdict == "re-master"
    assert changes(found).joints == ("q3",)
    assert found.verdict["consistent"].code == "re-master"
    assert "q3" in found.headline


def test_two_changes_are_separated_and_a_length_asks_for_a_calibration() -> None:
    found = changes(later(offset_3=np.radians(0.1), a_2=1e-3))
    assert {one.name for one in found.found} == {"q3", "a_2"}
    for one in found.found:
        assert abs(one.value - {"q3": np.radians(0.1), "a_2": 1e-3}[one.name]) < 3.5 * one.sd
    assert found.verdict == "calibrate-anew"
    assert found.joints == ()


def test_a_tool_that_moved_is_mounting_and_its_alias_is_named() -> None:
    found = later(tool_x=1e-3)
    (change,) = changes(found).found
    assert (change.name, change.kind) == ("tool", "mounting")
    assert change.parts["tool_x"] == pytest.approx(1e-3, abs=4.0 * change.sd)
    assert "a_6" in [other.name for other in change.alike]
    assert "--remounted" in str(found)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_another_machine_of_the_type_is_none_that_changed(seed: int) -> None:
    """Lengths 0.3 mm and angles 1 mrad otherwise, and a tool of its own."""
    draw, parameters = np.random.default_rng(seed), arm().mechanism.parameters
    sizes = {"a": 3e-4, "d": 3e-4, "tool": 1e-3, "alpha": 1e-3, "offset": 1e-3}
    others = {
        n: size * draw.standard_normal()
        for n in parameters.free
        for stem, size in sizes.items()
        if n.startswith(f"{stem}_")
    }
    consistent = later(7, **others).verdict["consistent"]
    assert consistent.passed is False
    assert "another machine of this type" in consistent.words


def test_three_changes_are_no_other_machine() -> None:
    words = later(offset_3=1e-3, a_2=1e-3, tool_x=5e-3).verdict["consistent"].words
    assert "another machine" not in words


@pytest.mark.parametrize(("degrees", "first"), [(0.2, "q6"), (8.0, "tool")])
def test_what_a_zero_and_a_tool_explain_is_named_by_its_size(degrees: float, first: str) -> None:
    """The reflector goes round the last axis: zeros seldom jump by degrees, tools do by mm."""
    found = later(offset_6=np.radians(degrees))
    (change,) = changes(found).found
    assert change.name == first
    assert {"q6", "tool"} - {first} <= {one.name for one in change.alike}
    code = found.verdict["consistent"].code
    assert code == ("changed" if first == "tool" else "re-master")


@pytest.mark.parametrize("mm", [2.0, 7.0])
def test_a_tool_that_moved_about_the_last_axis_is_the_tool(mm: float) -> None:
    found = later(tool_y=1e-3 * mm)
    (change,) = changes(found).found
    assert (change.name, change.kind) == ("tool", "mounting")
    assert change.value == pytest.approx(1e-3 * mm, abs=4.0 * change.sd)
    assert "--remounted" in str(found)


def test_a_larger_change_of_a_kind_is_less_likely() -> None:
    """In proportion to the size at first, and then as its tail falls; what is not seen has none."""
    zero, sure = Possible("zero", ("q6",)), np.array([[1e-12]])
    sizes = [1e-4, 1e-3, 1e-2, 1e-1]
    each = [zero.unlikely(np.array([size]), sure, ["rad"]) for size in sizes]
    assert each == sorted(each)
    assert each[0] < 0.01
    assert each[3] - each[2] == pytest.approx(2.0 * np.log(10.0), rel=0.05)
    assert zero.unlikely(np.array([0.1]), np.array([[1e-2]]), ["rad"]) < 1.0
    link = Possible("length", ("a_2",))
    assert link.unlikely(np.array([1e-5]), sure, ["m"]) > each[2]


def test_what_the_placement_takes_up_is_not_visible() -> None:
    hidden = {c.name for c in changes(later()).candidates if c.smallest is None}
    assert hidden == {"q1", "d_1"}


def test_more_than_a_few_changes_ask_for_a_calibration() -> None:
    rng = np.random.default_rng(0)
    names = ("a_2", "a_3", "alpha_2", "alpha_3", "d_4", "alpha_4", "d_2")
    found = changes(later(**dict(zip(names, 2e-3 * rng.standard_normal(7), strict=True))))
    assert found.verdict == "calibrate-anew"
    assert found.left is not None
    assert found.left < LEVEL
    assert "do not explain all differences" in "\n".join(found.lines())


def test_the_smallest_change_is_seen_as_often_as_stated() -> None:
    """40 draws of noise at 90 %; the calibration's own error is the same in all of them."""
    arm = planar_arm(60)
    result = lc.calibrate(
        arm.truth, arm.read(sds_of(arm), 1), noise=lc.Noise(sds_of(arm)), method="implicit-loop"
    )
    seen = []
    for seed in range(40):
        day = elsewhere(arm, 1000 + seed, 30).read(sds_of(arm), 5000 + seed)
        found = changes(lc.verify(result, day))
        one = next(c for c in found.candidates if c.smallest is not None and c.kind == "zero")
        assert one.smallest is not None
        moved = day.with_readings({one.name: day[one.name] - one.smallest})
        seen.append(changes(lc.verify(result, moved)).verdict != "unchanged")
    assert np.mean(seen) > 0.72


@pytest.mark.parametrize("kind", ["rigid", "sagging"])
def test_a_changed_machine_is_told_from_a_sagging_one(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first draws of the analysis, with a length that is seen at 90 %: a zero is named first in
    all, a length is named in most."""
    name, _ = CHANGES["length"]
    monkeypatch.setitem(cast("dict[str, tuple[str, float]]", CHANGES), "length", (name, 1.5e-4))
    drawn = [draw(kind, seed)["days"] for seed in range(4)]
    assert sum(days["unchanged"]["alarm"] for days in drawn) <= 1
    assert all(days["zero"]["first"] for days in drawn)
    assert sum(days["length"]["listed"] for days in drawn) >= 3


def test_residuals_larger_than_the_stated_sds_do_not_look_like_a_change() -> None:
    """Noise three times as large as stated, on both days: chi-squared rejected the sds."""
    arm, alarms = planar_arm(40), 0
    stated = lc.Noise(sds_of(arm))
    larger = {q: 3.0 * sd for q, sd in sds_of(arm).items()}
    for seed in range(15):
        result = lc.calibrate(
            arm.truth, arm.read(larger, seed), noise=stated, method="implicit-loop"
        )
        assert result.chi_squared is not None
        assert result.chi_squared.too_large
        day = elsewhere(arm, 1000 + seed, 30).read(larger, 5000 + seed)
        found = lc.verify(result, day)
        alarms += changes(found).verdict != "unchanged"
    assert alarms <= 3


def test_the_document_holds_every_candidate() -> None:
    found = later(offset_3=np.radians(0.1))
    document = json.loads(json.dumps(found.document()))["changes"]
    assert document["verdict"] == "re-master"
    assert document["joints"] == ["q3"]
    assert document["found"][0]["alike"] == []
    assert {c["name"] for c in document["candidates"]} >= {"q1", "q6", "a_2", "tool"}
    assert document["power"] == 0.9


@pytest.mark.parametrize(
    ("alike", "code", "words"),
    [
        (Candidate("the load", "load", "rad/m"), "conditions-first", "or else the load changed"),
        (Candidate("q3", "zero", "rad"), "re-master", "or else the zero of q3 changed"),
        (Candidate("offset_2", "angle", "rad"), "re-master", "± 0.0012 deg"),
        (Candidate("eye_f", "lens", "px"), "re-master", "or else eye_f changed"),
    ],
)
def test_a_change_is_named_with_what_asks_for_another_remedy(
    alike: Candidate, code: str, words: str
) -> None:
    """A joint is not to be mastered again for a load that these poses do not rule out."""
    change = Change("q2", "zero", "rad", 5e-5, 1e-5, 2.9e-5, 7.1e-5, 1e-3, (alike,))
    what = WhatChanged("re-master", (change,), (alike,), Innovation(40.0, 20, None, 1e-3), 1.0, 0.5)
    assert what.code == code
    assert change.among.startswith("the zero of q2 moved by")
    assert change.among.endswith(words)


def test_the_zero_of_a_slide_is_not_blamed_where_the_machine_may_have_grown() -> None:
    """A spindle that grew by 30 um along Z reads as the zero of Z."""
    change = Change("Z", "zero", "m", 3e-5, 1e-6, 2.8e-5, 3.2e-5, 1e-9, ())
    what = WhatChanged("re-master", (change,), (), Innovation(40.0, 20, None, 1e-9), 1.0, 0.5)
    assert what.code == "re-master-slides"
    assert what.joints == ("Z",)


@pytest.mark.parametrize(("freedom", "seen"), [(5, 1.0), (60, 3.0)])
def test_few_poses_show_no_larger_error_by_chance(freedom: int, seen: float) -> None:
    """Of 12 unchanged poses the 5 degrees of freedom that changes left had the variance 3; an error
    1.7 times as large as stated was named, while the poses erred as stated."""
    assert larger(3.0, freedom, 200.0) == seen


def test_the_zero_of_a_slide_has_the_sizes_of_a_length() -> None:
    """Half a metre, which it had as an angle has half a radian, was named at 47 mm."""
    given = setup("origins, two prismatic, point")
    data = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1).dataset
    causes = possible(build_problem(given.truth, data, given.noise), BETWEEN_DAYS)
    units = given.truth.quantities
    most = {one.names[0]: one.most for one in causes if one.kind == "zero"}
    assert {units[q] for q in most} == {"rad", "m"}
    assert all((limit < 0.05) == (units[q] == "m") for q, limit in most.items())


def test_a_warm_machine_with_slides_is_named_by_its_scale() -> None:
    """What slides read grows as its lengths do."""
    given, grown = setup("origins, two prismatic, point"), 1.8e-4
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1)
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    first = lc.calibrate(nominal, made.dataset, noise=given.noise, method="implicit-loop")
    lengths = [p for p in given.truth.parameters if p.dimension == "length"]
    warm = given.truth.with_nominal({p.name: (1.0 + grown) * p.nominal for p in lengths})
    units = given.truth.quantities
    stretched = {q: v * (1.0 + grown * (units[q] == "m")) for q, v in given.driven.items()}
    day = lc.simulate(warm, stretched, noise=given.noise, seed=2).dataset
    read = {q: day.readings[q] / (1.0 + grown) for q in given.driven if units[q] == "m"}
    (change,) = changes(lc.verify(first, day.with_readings(read))).found
    assert change.kind == "expansion"
    assert change.value == pytest.approx(grown, abs=4.0 * change.sd)


@pytest.mark.parametrize("share", [6e-4, -3e-3])
def test_a_slide_with_another_scale_is_named_alone(share: float) -> None:
    """The spindle of one axis of a gantry grew by 300 ppm: "the scale of the machine changed by 221
    ppm; the load changed", and no cause was named of a screw with another pitch."""
    given = setup("origins, two prismatic, point")
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1)
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    first = lc.calibrate(nominal, made.dataset, noise=given.noise, method="implicit-loop")
    slides = [q for q in given.driven if given.truth.quantities[q] == "m"]
    for slide in slides:
        stretched = {**given.driven, slide: given.driven[slide] * (1.0 + share)}
        day = lc.simulate(given.truth, stretched, noise=given.noise, seed=2).dataset
        found = lc.verify(first, day.with_readings({slide: day[slide] / (1.0 + share)}))
        (change,) = changes(found).found
        assert (change.name, change.kind) == (f"the scale of {slide}", "slide")
        assert change.value == pytest.approx(share, abs=4.0 * change.sd)
        assert found.verdict["consistent"].code == "changed"
        assert "Let the slide reach the temperature" in str(found)


def test_a_tool_whose_targets_are_one_point_moves_by_the_way_of_that_point() -> None:
    """Three wires on one hook: "the tool moved by 75 mm ± 71 mm", with a turn about the flange that
    cancelled it, for 1 mm."""
    hooks = ("tool", "second", "third")
    wires = [draw_wire(f"w{i}", target=name) for i, name in enumerate(hooks)]
    anchors = at("w0", 1.5, 0.8, 0.3) | at("w1", -0.6, 1.4, 0.2) | at("w2", -0.4, -1.2, 1.1)
    there = {f"{name}_{axis}": TOOL[f"tool_{axis}"] for name in hooks for axis in "xyz"}
    given = looked_at(wires, anchors | there, 0, held=FIRST)
    made = lc.simulate(given.truth, given.driven, noise=given.noise, seed=1)
    nominal = given.truth.with_parameters(given.truth.parameters.with_fixed(given.held))
    first = lc.calibrate(nominal, made.dataset, noise=given.noise, method="implicit-loop")
    moved = given.truth.with_nominal({f"{name}_x": TOOL["tool_x"] + 1e-3 for name in hooks})
    some = {q: v[::3] for q, v in given.driven.items()}
    for seed in range(59301, 59304):
        day = lc.simulate(moved, some, noise=given.noise, seed=seed).dataset
        (change,) = changes(lc.verify(first, day)).found
        assert (change.name, change.kind) == ("the tool", "mounting")
        assert change.value == pytest.approx(1e-3, abs=1e-4)
        assert change.low < 1e-3 < change.high


@pytest.mark.parametrize(("half", "named"), [(2e-3, True), (15e-3, False)])
def test_a_size_that_no_pose_determines_is_not_named(half: float, named: bool) -> None:
    value, parts = 10.4e-3, {"tool_x": 4e-3, "tool_z": -9.6e-3}
    bounds = (0.5 * half, value - half, value + half)
    change = Change("tool", "mounting", "m", value, *bounds, 1e-9, (), parts)
    assert ("mm" in change.words) is named
    assert change.words.startswith("tool moved")


def test_a_part_that_no_pose_determines_does_not_hide_the_others() -> None:
    parts = {"tool_x": 2e-3, "tool_y": -3e-3}
    bounds = (1e-5, 3.58e-3, 3.62e-3)
    change = Change("tool", "mounting", "m", 3.6e-3, *bounds, 1e-9, (), parts, ("tool_z",))
    assert change.words.endswith("(tool_x 2.00 mm, tool_y -3.00 mm, tool_z unknown)")


class Explaining:
    """Changes that explain so much alone, and so much beside each of the others."""

    scale = 1.0
    kept: Any = _System.kept

    def __init__(self, *gains: tuple[float, float]) -> None:
        self.gains = gains

    def critical(self, i: int, rank: int) -> float:
        return 10.0

    def beside(self, i: int, others: list[int]) -> SimpleNamespace:
        return SimpleNamespace(rank=1, gain=self.gains[i][bool(others)])


@pytest.mark.parametrize(
    ("gains", "kept"),
    [
        (((40.0, 1.0), (90.0, 5.0)), (1,)),
        (((40.0, 30.0), (90.0, 80.0)), (0, 1)),
        (((9.0, 9.0),), (0,)),
    ],
)
def test_of_two_changes_that_do_the_same_one_is_kept(
    gains: tuple[tuple[float, float], ...], kept: tuple[int, ...]
) -> None:
    """A load and a zero that each other made superfluous were both named, the zero as moved by
    -0.0003 ± 0.0081 degrees."""
    assert Explaining(*gains).kept(tuple(range(len(gains)))) == kept


@pytest.mark.parametrize("several", [False, True])
def test_print_and_lens_at_once_may_be_the_poses_that_a_robot_states(several: bool) -> None:
    """An axis of a gantry that was 500 ppm longer was a smaller print and another focus."""
    scale = Change("board_scale", "print", "1", -3e-4, 5e-5, -4e-4, -2e-4, 1e-7, ())
    focus = Change("eye_f", "lens", "px", 0.6, 0.1, 0.4, 0.8, 1e-4, ())
    found = (scale, focus) if several else (scale,)
    what = WhatChanged("calibrate-anew", found, (), Innovation(40.0, 20, None, 1e-9), 1.0, 0.5)
    stated = SimpleNamespace(
        flange=True, sound=None, innovation=what.test, _statistic=lambda: "chi-squared 40"
    )
    one = lc.Verification._changed(cast(Any, stated), what)
    assert one.code == "images-changed"
    assert ("the robot states other poses" in str(one)) == several
