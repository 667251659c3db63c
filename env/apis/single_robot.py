"""One robot as a Gymnasium environment, with everything else about it played by oracles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from env.apis.fleet_infos import AP, Infos
from env.apis.parallel_env import RISFleetParallelEnv
from env.arrays import Floats32, Ints
from env.checks import checked_config
from env.config import EnvConfig
from env.oracles import per_slot
from env.world import World

ROBOT = "robot_0"
OTHERS = ("shortest", "none")
NO_PHASE = -1
"""The info ``phase`` after a reset, before the access point has taken one."""


class SingleRobotEnv(gymnasium.Env[Floats32, np.int64]):
    r"""Drive one robot to its destination and pick its downlink power, with the RIS at its best.

    ## Description

    Robot 0 of the fleet is the agent. The other K - 1 robots drive shortest ways with the
    canonical powers (by gain, the strongest of n driving robots takes P_max / 2^n, ..., the
    weakest P_max / 2), and the access point takes the phase setting with the largest sum of rates
    (of the quality with ``metric=qoe``) in each slot. A task for testing learners: a shortest path,
    with a little to gain from powers.

    ## Action Space

    ``Discrete(4 N_P)``, 24 actions: direction * N_P + level - 1.

    | Direction | Move             |
    |-----------|------------------|
    | 0         | north, y + 0.5 m |
    | 1         | south, y - 0.5 m |
    | 2         | east, x + 0.5 m  |
    | 3         | west, x - 0.5 m  |

    Level l = 1 ... N_P asks for the power P_max / 2^l; out of the room, a robot stays put,
    and so it does before a wall with ``walls.block_motion`` and before a robot with
    ``collisions=block``, where the others give way to nobody and may stand before it to the end.

    ## Observation Space

    ``Box``, float32, shape (5,), or (3,) with ``state.destination=none``:

    | Num | Observation                          | Min | Max |
    |-----|--------------------------------------|-----|-----|
    | 0   | x over half the room's width, - 1    | -1  | 1   |
    | 1   | y over half the room's depth, - 1    | -1  | 1   |
    | 2   | (\|hbar\|^2 in dB + 70) / 20, direct | -10 | 10  |
    | 3   | way left in x over the room's width  | -1  | 1   |
    | 4   | way left in y over the room's depth  | -1  | 1   |

    What ``state.way`` adds, also by default where walls are solid, and ``state.others`` is that of
    ``RISFleetParallelEnv``.

    ## Rewards

    phi R + psi (distance gone towards the destination, in m) - 1, and + 100 on arrival, with
    phi = 0.05 and psi = 3. R is the robot's rate in bit/s/Hz, or the quality lg(R) with
    ``metric=qoe``, weighed as ``reward.credit`` says. Not scaled.

    ## Starting State

    Every robot in a random cell at least 10 m from its destination, or in that of
    ``tasks.starts_m`` with ``tasks.start=fixed``; destinations stay.
    ``options={"starts_m": [[x, y], ...]}`` sets the starts of all robots, in m.

    ## Episode End

    1. Termination: the robot arrives.
    2. Truncation: T_max slots (150) are over. Other robots' arrivals end nothing.

    Infos hold ``rate``, ``power_w``, ``gain_db``, ``sic_failed`` and ``arrived`` of the robot,
    ``shortest_slots``, the length of the way that it has left, ``sum_rate`` of all and the
    ``phase`` taken. A reset has the same keys: nothing has been sent, ``gain_db`` is that of the
    direct channel, and ``phase`` is -1.

    ## Arguments

    ```python
    >>> import gymnasium
    >>> import env
    >>> gymnasium.make("risfleet/SingleRobot-v0", config={"robots": 2}, others="shortest")
    <OrderEnforcing<PassiveEnvChecker<SingleRobotEnv<risfleet/SingleRobot-v0>>>>

    ```

    | Argument      | Default      | Description                                                  |
    |---------------|--------------|--------------------------------------------------------------|
    | `config`      | `None`       | an `EnvConfig`, or its fields nested: `{"ris": {"side": 0}}` |
    | `others`      | `"shortest"` | `"none"`: the robot is alone, whatever K and its state are   |
    | `seed`        | `0`          | names drawn destinations alone; starts follow `reset(seed)`  |
    | `render_mode` | `None`       | `"rgb_array"`: a picture of the floor; `"ansi"`: text        |

    ## Version History

    * v0: initial version.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # Gymnasium's type
        "render_modes": ["rgb_array", "ansi"],
        "render_fps": 10,
    }

    def __init__(
        self,
        config: EnvConfig | Mapping[str, Any] | None = None,
        *,
        others: str = "shortest",
        seed: int = 0,
        render_mode: str | None = None,
    ) -> None:
        config = config_with(others, config)
        self._fleet = RISFleetParallelEnv(config, seed=seed, render_mode=render_mode)
        self.config = config
        self.render_mode = render_mode
        self.observation_space = self._fleet.observation_space(ROBOT)
        self.action_space = self._fleet.action_space(ROBOT)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats32, dict[str, Any]]:
        """Begins an episode; ``starts_m`` in the options is in m, shape (K, 2).

        Raises:
            ValueError: another option, or starts that cannot be.
        """
        super().reset(seed=seed)
        self._fleet.world.generator = self.np_random
        observations, infos = self._fleet.reset(options=options)
        return observations[ROBOT], _info(infos, NO_PHASE)

    def step(self, action: np.int64) -> tuple[Floats32, float, bool, bool, dict[str, Any]]:
        """One slot of the robot, and of all around it."""
        if ROBOT not in self._fleet.agents:
            raise ResetNeeded("the episode is over or has not begun: call reset")
        moves = self._others_and_phase(action)
        observations, rewards, terminated, truncated, infos = self._fleet.step(moves)
        ended, out_of_time = terminated[ROBOT], truncated[ROBOT]
        info = _info(infos, moves[AP])
        return observations[ROBOT], rewards[ROBOT], ended, out_of_time, info

    def _others_and_phase(self, action: np.int64) -> dict[str, Any]:
        """Everybody's actions: the robot's own, and those of the oracles given that."""
        world = self._fleet.world
        phase, direction, level = everybodys_actions(world, np.array([action]))
        codes = world.scenario.actions.encode(direction, level)[0]
        others = zip(self._fleet.robots[1:], codes[1:], strict=True)
        return {ROBOT: action, AP: int(phase[0]), **dict(others)}

    def render(self) -> NDArray[np.uint8] | str | None:
        """The floor and the ways so far: a picture, shape (480, 480, 3), or lines of text."""
        return self._fleet.render()

    def close(self) -> None:
        """Lets the picture go."""
        self._fleet.close()


def config_with(others: str, config: EnvConfig | Mapping[str, Any] | None) -> EnvConfig:
    """The checked configuration, of one robot with ``others="none"``.

    Raises:
        ValueError: a value is not allowed.
    """
    if others not in OTHERS:
        raise ValueError(f"others={others!r}: allowed is {' or '.join(OTHERS)}")
    config = checked_config(config)
    if others == "none":
        config = replace(config, robots=1, state=replace(config.state, others=0))
    return config


def everybodys_actions(world: World, action: Ints) -> tuple[Ints, Ints, Ints]:
    """What is done in B worlds where robot 0 takes the actions (B,) and oracles play all else.

    Returns:
        The phases, shape (B,), and all robots' directions and power levels, shape (B, K).
    """
    space = world.scenario.actions
    own_direction, own_level = space.decode(action)
    level = per_slot.canonical_levels(
        per_slot.phase_gains(world), world.driving[:, None], space.levels
    )
    level[..., 0] = own_level[:, None]
    phase = per_slot.best_phase(world, level)
    direction = per_slot.shortest_directions(world)
    direction[:, 0] = own_direction
    return phase, direction, level[np.arange(len(phase)), phase]


def _info(infos: Infos, phase: int) -> dict[str, Any]:
    """The robot's info, with the access point's phase."""
    return {**infos[ROBOT], "sum_rate": infos[AP]["sum_rate"], "phase": phase}
