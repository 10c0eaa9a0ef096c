"""Where valid, better than what, good enough: each answer from the figures that belong to it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from analyses.instruments import ARM_VALUES, six_axis
from loopcal.document.choice import Candidate, Chosen
from loopcal.document.findings import RegionEntry, RegionSd
from loopcal.document.result_document import ResultDocument
from loopcal.mechanisms.instruments.pose import pose
from loopcal.mechanisms.machine import assemble
from loopcal.mechanisms.outputs import distance_unit
from loopcal.statistics.verdict import better, good_enough, valid
from tests.reference.machines import dh_arm
from tests.reference.verdicts import finding_of, verdict_of
from tests.statistics.test_verdict import clean

METRES = RegionSd("m", 1e-4, 1.1e-4, 1.1)
TURNS = RegionSd("rad", 1e-5, 9e-4, 90.0)


def with_region(*by: RegionSd) -> ResultDocument:
    """The clean planar arm with this region."""
    document = clean()
    assert document.prediction is not None
    region = RegionEntry((), by) if by else None
    return replace(document, prediction=replace(document.prediction, region=region))


def test_a_tolerance_in_metres_is_widened_by_metres_only() -> None:
    mixed, alone = with_region(TURNS, METRES), with_region(METRES)
    assert good_enough(mixed, 1.0) == good_enough(alone, 1.0)
    assert finding_of(valid(mixed)).number == 90.0
    unbounded = with_region(replace(METRES, sd=None, ratio=None), TURNS)
    assert finding_of(good_enough(unbounded, 1.0)).severity == "refuse"


def test_without_a_region_the_tolerance_speaks_of_the_measured_poses() -> None:
    for document in (with_region(), with_region(TURNS)):
        assert "near the measured poses" in finding_of(good_enough(document, 1.0)).words
    assert "in the working region" in finding_of(good_enough(with_region(METRES), 1.0)).words


def chosen(*rivals: tuple[str, float]) -> ResultDocument:
    """The clean planar arm chosen over these rivals, at twice the rms of its validation."""
    document = clean()
    assert document.validation is not None
    seen = document.validation.accuracy
    assert seen is not None
    own = replace(seen, rms=2.0 * seen.rms)
    over = (
        Candidate("implicit-loop", own, None, 0.0, 0.0),
        *(Candidate(name, own, None, difference, 1e-6) for name, difference in rivals),
    )
    return replace(document, chosen=Chosen("implicit-loop", (), "", over))


def test_differences_of_the_choice_stand_beside_the_rms_of_the_choice() -> None:
    document = chosen(("nominal", 1e-3))
    assert document.chosen is not None
    own = document.chosen.over[0].out_of_sample
    assert own is not None
    answer = finding_of(better(document))
    assert f"{1e3 * own.rms:.3g}" in answer.words
    assert answer.words.startswith("Better than the nominal machine:")


@pytest.mark.parametrize(
    "rivals",
    [
        (("nominal", 1e-3), ("least-squares", 1e-3)),
        (("nominal machine of mine", 1e-3),),
        (("least-squares", 0.0),),
    ],
)
def test_the_headline_names_the_nominal_machine_whatever_else_was_beaten(
    rivals: tuple[tuple[str, float], ...],
) -> None:
    document = chosen(*rivals)
    assert document.accuracy is not None
    drawn = replace(document.accuracy.before, rms=1.0)
    found = verdict_of(replace(document, accuracy=replace(document.accuracy, nominal=drawn)))
    assert found.grade == "good"
    assert found.headline.endswith("better than the nominal machine.")


@pytest.mark.parametrize(
    ("own", "drawn", "code"), [(2e-3, 1e-3, "better-near-only"), (1e-3, 2e-3, "better")]
)
def test_a_result_that_the_drawing_beats_in_regions_not_used_is_not_better_everywhere(
    own: float, drawn: float, code: str
) -> None:
    document = chosen(("nominal", 1e-3))
    assert document.chosen is not None
    mine, nominal = document.chosen.over
    assert mine.out_of_sample is not None
    over = (
        replace(mine, blocked=replace(mine.out_of_sample, rms=own)),
        replace(nominal, blocked=replace(mine.out_of_sample, rms=drawn)),
    )
    answer = finding_of(better(replace(document, chosen=replace(document.chosen, over=over))))
    assert answer.code == code
    assert (answer.severity == "caution") == (code == "better-near-only")
    assert ("In regions not used it is worse: 2.00 mm rms instead of 1.00 mm" in answer.words) == (
        code == "better-near-only"
    )


def test_distances_are_positions_where_any_is_seen() -> None:
    arm = assemble(six_axis(), [pose()], ARM_VALUES)
    assert distance_unit(dh_arm()) == "m"
    assert distance_unit(arm) == "m"
    turned_round = replace(arm, outputs=tuple(reversed(arm.outputs)))
    assert distance_unit(turned_round) == "m"
