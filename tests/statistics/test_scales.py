"""The scale of a station is found in readings that have it; `analyses/scales.py` at full size."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from analyses.gauntlet_kinds import KINDS
from analyses.scales import POSES, begun, drawn, lengths_of, within
from loopcal.statistics.change_points import Search
from loopcal.statistics.ordered_system import OrderedSystem
from loopcal.statistics.possible_changes import BETWEEN_DAYS, possible
from loopcal.statistics.scales import joint_scale, scales

PLANTED = 1e-4


@cache
def two_stations() -> OrderedSystem:
    """An arm seen from two places, the second of which measures too long."""
    return begun(0, 2, PLANTED)


def test_the_scale_of_a_second_station_has_its_size_and_sign() -> None:
    station, drawing = scales(two_stations().fitted())
    assert station.instruments == ("point_2",)
    assert abs(station.size - PLANTED) < 4.0 * station.sd
    assert station.sd < 0.2 * PLANTED
    assert station.p_value < 1e-9
    # 0.1 mm at a metre; and the drawing of this arm is no such scale.
    assert 5e-5 < station.moves < 5e-4
    assert (drawing.instruments, drawing.p_value > 1e-3) == ((), True)


@pytest.mark.parametrize("number", [1, 3, 4])
def test_a_second_station_that_measures_too_long_is_no_change_along_the_run(number: int) -> None:
    """Without that scale beside it, these machines warm up, bend a link or drop a load."""
    shifts, fit = Search(begun(number, 2, PLANTED)).run()
    assert not shifts.found
    assert scales(fit)[0].p_value < 1e-6


@pytest.mark.parametrize("number", [4, 6])
def test_a_joint_of_another_gear_ratio_is_named_and_gears_out_of_round_are_none(
    number: int,
) -> None:
    """The arms sag; the gears of the second are out of round."""
    assert joint_scale(begun(number, 1).fitted()) == ()
    (one,) = joint_scale(begun(number, 1, ratio=1.001, joint=3).fitted())
    assert (one.joint, one.instruments) == ("theta_4", ())
    assert abs(one.size - 1e-3) < 4.0 * one.sd < 1e-3
    assert one.p_value < 1e-6
    assert one.moves == pytest.approx(one.size * np.radians(90.0), rel=0.5)


def test_over_a_small_range_a_gear_out_of_round_looks_like_another_ratio() -> None:
    assert joint_scale(begun(4, 1, ratio=1.001, joint=1).fitted()) == ()


def test_a_slip_at_the_change_of_stations_is_named_beside_their_scales() -> None:
    system = two_stations()
    half, slip = POSES // 2, np.array([3e-4, -2e-4, 2e-4])
    E = system.E.copy()
    E[half:] += system.columns(["tool_x", "tool_y", "tool_z"])[half:] @ slip
    shifts, _ = Search(replace(system, E=E)).run()
    (slipped,) = shifts.found
    assert (slipped.moved, slipped.number) == ("target", half + 1)


def test_the_scale_of_all_readings_shows_beside_a_drawing_that_is_kept_to() -> None:
    for length, shows in ((5e-6, True), (1e-3, False)):
        system = within(two_stations(), length)
        assert (scales(system.fitted())[-1].sd < 1e-4) is shows


def test_a_target_that_two_stations_see_is_one_tool() -> None:
    causes = possible(two_stations().problem, BETWEEN_DAYS)
    assert [one.name for one in causes if one.kind == "mounting"] == ["tool"]


def test_a_scale_is_in_what_the_sd_of_lengths_was_learnt_from() -> None:
    """By the sd alone 0.5 % of all lengths are hardly more than three of their sds."""
    system = within(begun(0, 1), 3e-4)
    (scaled,), (kept,) = drawn(system, 5e-3, 1), drawn(system, 0.0, 1)
    assert scaled.size > 3e-3
    assert scaled.p_value < 1e-3 < kept.p_value
    assert abs(scaled.size / scaled.sd) < 4.0


def test_slides_that_are_read_show_a_scale_beside_two_lengths_of_a_drawing() -> None:
    """Hardly of what the two lengths say is in it: taken as all theirs, 1.8 sds were certain."""
    system = begun(KINDS["SCARA"].machine(2006), 1)
    assert len(lengths_of(system)) == 2
    entries = [[drawn(system, scale, seed)[0] for seed in range(25)] for scale in (0.0, 3e-4)]
    by_chance, planted = (np.array([one.p_value for one in some]) for some in entries)
    assert by_chance.min() > 1e-4
    assert (by_chance < 0.05).sum() < 5  # 5 or more of 25 at 5 %: 0.7 %
    assert (planted < 1e-3).mean() > 0.7
    z = np.array([one.size / one.sd for one in entries[0]])
    assert 0.7 < z.std() < 1.3
