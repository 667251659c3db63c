"""Actions as integers: a robot's, and those of all agents together."""

import numpy as np
import pytest

from env.mdp.actions import ActionSpace


def test_a_robots_actions_are_four_directions_times_levels():
    action = np.arange(ActionSpace(6).count)
    direction, level = ActionSpace(6).decode(action)
    assert len({*zip(direction.tolist(), level.tolist(), strict=True)}) == 24
    assert (direction.min(), direction.max(), level.min(), level.max()) == (0, 3, 1, 6)
    np.testing.assert_array_equal(ActionSpace(6).encode(direction, level), action)


@pytest.mark.parametrize(("robots", "count"), [(1, 96), (2, 2_304), (3, 55_296), (4, 1_327_104)])
def test_joint_actions_are_as_many_as_the_paper_says(robots, count):
    assert ActionSpace(6).joint_count(4, robots) == count


def test_every_joint_action_is_another_combination_of_all_agents_actions():
    joint = np.arange(ActionSpace(2).joint_count(3, 2))
    phase, robots = ActionSpace(2).joint_decode(joint, 2)
    assert len({*zip(phase.tolist(), *robots.T.tolist(), strict=True)}) == len(joint) == 192
    assert (phase.max(), robots.max()) == (2, 7)


def test_a_joint_action_by_hand():
    """Two robots with eight actions each: 2 * 64 + 5 * 8 + 3."""
    phase, robots = ActionSpace(2).joint_decode(np.array([171]), 2)
    assert (phase.tolist(), robots.tolist()) == ([2], [[5, 3]])
