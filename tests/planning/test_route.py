"""The order of the chosen poses."""

from __future__ import annotations

from itertools import permutations

import numpy as np

from loopcal.companions.planning.plan import out_and_back, route, travel
from loopcal.statistics.run_order import order_by_joints


def test_the_way_visits_every_pose_once_and_is_hardly_longer_than_the_shortest() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        joints = rng.uniform(size=(2, 7))
        order = route(joints)
        assert sorted(order) == list(range(7))
        assert order[0] == 0
        shortest = min(travel(joints, [0, *rest]) for rest in permutations(range(1, 7)))
        assert travel(joints, order) < 1.15 * shortest


def test_poses_on_a_line_are_visited_along_it() -> None:
    joints = np.array([[0.0, 0.7, 0.1, 0.9, 0.3]])
    assert route(joints) == [0, 2, 4, 1, 3]


def test_the_joints_do_not_show_the_order_of_a_way_out_and_back() -> None:
    """The way itself does, and is at most about half as long."""
    for seed in range(5):
        joints = np.random.default_rng(seed).uniform(size=(3, 60))
        way = route(joints)
        back = out_and_back(way)
        assert sorted(back) == sorted(way)
        assert travel(joints, back) < 2.2 * travel(joints, way)
        assert order_by_joints(joints[:, back].T) < 0.25
