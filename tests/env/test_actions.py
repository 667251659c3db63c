"""Actions as integers: a robot's, and those of all agents together."""

import numpy as np
import pytest

from env import actions


def test_a_robots_actions_are_four_directions_times_levels():
    action = np.arange(actions.count(6))
    direction, level = actions.decode(action, 6)
    assert len({*zip(direction.tolist(), level.tolist(), strict=True)}) == 24
    assert (direction.min(), direction.max(), level.min(), level.max()) == (0, 3, 1, 6)
    np.testing.assert_array_equal(actions.encode(direction, level, 6), action)


@pytest.mark.parametrize(("robots", "count"), [(1, 96), (2, 2_304), (3, 55_296), (4, 1_327_104)])
def test_joint_actions_are_as_many_as_the_paper_says(robots, count):
    assert actions.joint_count(4, robots, 6) == count


def test_every_joint_action_is_another_combination_of_all_agents_actions():
    joint = np.arange(actions.joint_count(3, 2, 2))
    phase, robots = actions.joint_decode(joint, 2, 2)
    assert len({*zip(phase.tolist(), *robots.T.tolist(), strict=True)}) == len(joint) == 192
    assert (phase.max(), robots.max()) == (2, 7)


def test_a_joint_action_by_hand():
    """Two robots with eight actions each: 2 * 64 + 5 * 8 + 3."""
    phase, robots = actions.joint_decode(np.array([171]), 2, 2)
    assert (phase.tolist(), robots.tolist()) == ([2], [[5, 3]])
