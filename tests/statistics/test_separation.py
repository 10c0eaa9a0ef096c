"""Joints and instrument told apart in repeats, whatever the machine really did in between."""

from __future__ import annotations

import numpy as np
import pytest

import loopcal as lc
from loopcal.statistics.separation import separate
from tests.refusals import refused

ARM = lc.planar_two_link()
POSES = ((0.2, 1.2), (-0.8, 2.0), (1.0, 0.4))
JOINTS, TRACKER = 2e-5, 1.5e-5


def repeats(seed: int, *, tracker: float = TRACKER, rows: int = 20):
    """Series that really move by 300 urad, read with these sds."""
    rng = np.random.default_rng(1000 + seed)
    noise = lc.Noise({"phi?": JOINTS, "?P": tracker})
    made = []
    for i, pose in enumerate(POSES):
        true = np.array(pose)[:, None] + 3e-4 * rng.normal(size=(2, rows))
        moved = {"phi2": true[0], "phi3": true[1]}
        made.append(lc.simulate(ARM, moved, noise=noise, seed=10 * seed + i).dataset)
    return made


def told(seed: int, *, tracker: float = TRACKER):
    data = repeats(seed, tracker=tracker)
    raw = {s.name: s.about_mean.sd for s in lc.repeated_readings(data).sensors}
    return separate(ARM, data, raw)


def test_real_motion_is_left_out_and_the_sds_are_found_with_their_own():
    found = [told(seed) for seed in range(120)]
    for which, true in ((0, JOINTS), (1, TRACKER)):
        groups = [f.groups[which] for f in found]
        assert min(g.raw for g in groups) > 5 * true
        sds = np.array([g.sd for g in groups])
        assert np.sqrt(np.mean(sds**2)) == pytest.approx(true, rel=0.06)
        stated = [g.sd_of_sd for g in groups if g.sd_of_sd is not None and g.upper is None]
        assert np.median(stated) == pytest.approx(sds.std(), rel=0.25)
    assert [g.name for g in found[0].groups] == ["joints", "instrument"]


def test_an_instrument_that_is_perfect_is_bounded_and_said_to_be():
    groups = [told(seed, tracker=0.0).groups[1] for seed in range(40)]
    assert np.mean([g.sd < 0.3 * JOINTS for g in groups]) > 0.9
    bounded = [g for g in groups if g.upper is not None]
    assert len(bounded) > 30
    assert np.median([g.upper for g in bounded if g.upper is not None]) < JOINTS


def test_a_bound_covers_a_small_noise_it_cannot_see():
    groups = [told(seed, tracker=4e-6).groups[1] for seed in range(40)]
    covered = [g.upper is None or g.upper > 4e-6 for g in groups]
    assert np.mean(covered) > 0.85


def test_constant_offsets_of_a_machine_that_is_not_calibrated_do_not_matter():
    data = repeats(1)
    raw = {s.name: s.about_mean.sd for s in lc.repeated_readings(data).sensors}
    off = ARM.with_nominal({"xA": 0.02, "phi20": 0.001, "l2": 0.801})
    near, there = separate(off, data, raw), separate(ARM, data, raw)
    for one, other in zip(near.groups, there.groups, strict=True):
        assert one.sd == pytest.approx(other.sd, rel=0.02)


def test_an_instrument_that_stands_elsewhere_is_noticed():
    data = repeats(1)
    raw = {s.name: s.about_mean.sd for s in lc.repeated_readings(data).sensors}
    with refused("implausible-readings") as caught:
        separate(ARM.with_nominal({"xA": 1.0}), data, raw)
    assert caught.value.remedy


def test_readings_that_are_missing_or_still_are_refused():
    data = repeats(1)
    with refused("no-data"):
        separate(ARM, data, {})
    lost = [one.with_readings({"xP": np.full(len(one), np.nan)}) for one in data]
    with refused("missing-reading"):
        separate(ARM, lost, {"phi2": 1e-5})
