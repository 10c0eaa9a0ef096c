"""What a learnt model error does joint by joint, beside a truth from code of its own."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import loopcal as lc
from analyses.gauntlet_truth import SIX
from analyses.gauntlet_worlds import SAGGING, World
from loopcal.document.choice import TermEntry, TermPart
from loopcal.estimation.noise.term_parts import gain
from tests.reference.verdicts import verdict_of


@cache
def sagging() -> tuple[lc.Result, dict[str, np.ndarray]]:
    trial = replace(SAGGING, stated=None).made(np.random.default_rng(5))
    mechanism = lc.structured(trial.mechanism, harmonics=False)
    result = lc.calibrate(
        mechanism, trial.readings, method="least-squares", model_error="structured"
    )
    return result, trial.readings


def term(result: lc.Result, name: str) -> TermEntry:
    return next(entry for entry in result.document.terms if entry.name == name)


@pytest.mark.parametrize("joint", ["q2", "q3"])
def test_a_joint_gives_way_as_the_moment_of_its_weight_says(joint: str) -> None:
    result, readings = sagging()
    part = next(p for p in term(result, "sag").parts if p.joints == (joint,))
    q = np.column_stack([readings[f"q{i}"] for i in range(1, 7)])
    arm = replace(SIX, yielding=2e-6)
    turns = arm._given(q, 1.0, np.zeros((len(q), 6, 3)))[:, int(joint[1]) - 1]
    truth = np.linalg.norm(turns, axis=1)
    pose = result.problem.poses.index(part.pose or "")
    assert part.sd is not None
    assert part.size == pytest.approx(truth[pose], abs=4.0 * part.sd)
    assert truth[pose] > 0.8 * truth.max()
    assert part.clear
    assert f"under gravity {joint} gives way about its axis by up to" in part.words
    assert "mrad" in part.words


def test_a_smooth_discrepancy_depends_on_the_joints_of_its_waves() -> None:
    """1 mm of cos(q1 - q2) upwards, which no length or angle of a SCARA can be."""
    trial = World("scara").made(np.random.default_rng(5))
    readings = dict(trial.readings)
    bent = 1e-3 * np.cos(readings["q1"] - readings["q2"])
    readings["z"] = readings["z"] + bent
    mechanism = lc.structured(trial.mechanism, discrepancy=True, sag=False, harmonics=False)
    result = lc.calibrate(mechanism, readings, method="least-squares", model_error="structured")
    (part,) = term(result, "discrepancy").parts
    assert part.joints == ("q1", "q2")
    assert part.size == pytest.approx(np.std(bent), rel=0.2)
    assert part.words.startswith("what remains unexplained: 0.")
    assert part.words.endswith(" mm rms, smooth in q1 and q2")


def test_the_summary_and_the_verdict_name_what_the_data_need_alone() -> None:
    result, _ = sagging()
    document = result.document
    sag = term(result, "sag")
    assert sag.sentences
    assert sag.sentences[0] == sag.parts[0].words
    assert sag.sentences[0] in str(document)
    assert sag.sentences[0] in verdict_of(document).sound.words
    needless = replace(sag, gain=9.0)
    unsure = replace(sag, parts=tuple(replace(p, sd=p.size / 2.0) for p in sag.parts))
    for other in (needless, unsure):
        assert other.sentences == ()
        less = replace(document, terms=(other,))
        assert sag.sentences[0] not in str(less)
        assert sag.sentences[0] not in verdict_of(less).sound.words


def test_a_part_without_sd_is_not_clear() -> None:
    assert not TermPart(("q1",), "m", 1.0, None, None, "").clear


def test_what_a_term_gains_is_sought_once(monkeypatch: pytest.MonkeyPatch) -> None:
    result, _ = sagging()
    assert result.estimate is not None
    learnt = result.estimate.variances.terms
    assert learnt is not None
    present = learnt.beside_noise
    first = [gain(present, i) for i in range(len(learnt.system.terms))]
    monkeypatch.delattr("loopcal.estimation.noise.term_scales.search")
    assert learnt.beside_noise is present
    assert [gain(present, i) for i in range(len(learnt.system.terms))] == first
    assert [entry.gain for entry in result.document.terms] == first
