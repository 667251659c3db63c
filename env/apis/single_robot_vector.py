"""Many single-robot environments stepped at once: what ``make_vec`` gives for them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from env.apis.fleet_infos import Columns, slot_columns
from env.apis.observation_spaces import robot_space
from env.apis.single_robot import NO_PHASE, config_with, everybodys_actions
from env.apis.starts import start_cells, starts_asked
from env.apis.vector_rules import Infos, checked_mode, final_infos, infos_of, reset_mask, seeds
from env.arrays import Bools, Complexes, Floats, Floats32, Ints
from env.checks import refuse
from env.config import EnvConfig
from env.mdp import lateness
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import StepResult, World

Observations = Floats32
Slot = tuple[Observations, Floats, Bools, Bools, Infos]


class SingleRobotVectorEnv(VectorEnv[Observations, Ints, NDArray[Any]]):
    """``num_envs`` times ``SingleRobotEnv``, as one batch of worlds.

    Number i gives the observations, rewards, ends and infos of the single environment with the
    same starts: ``reset(seed=s)`` seeds it with s + i. It has its own generator, so what one draws
    does not depend on the others. All of it is ``env.world.World`` with as many worlds.

    ``autoreset_mode`` is Gymnasium's: with ``NEXT_STEP`` an environment that has ended is reset by
    the next step, which ignores its action and pays 0; with ``SAME_STEP`` by the step that ends
    it, and the last observation and info stand under ``final_obs`` and ``final_info``; with
    ``DISABLED`` by ``reset(options={"reset_mask": mask})`` alone, the mask a bool array, shape
    (num_envs,).

    Args:
        num_envs: how many.
        config: as of ``SingleRobotEnv``, like all that follow; the same for all.
        others: ``"shortest"`` or ``"none"``.
        seed: names drawn destinations alone.
        render_mode: None; a single environment draws.
        autoreset_mode: an ``AutoresetMode`` or its value.

    Raises:
        ValueError: an argument is not allowed.
    """

    def __init__(
        self,
        num_envs: int = 1,
        config: EnvConfig | Mapping[str, Any] | None = None,
        *,
        others: str = "shortest",
        seed: int = 0,
        render_mode: str | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        if isinstance(num_envs, bool) or not isinstance(num_envs, int) or num_envs < 1:
            raise ValueError(f"num_envs={num_envs!r}: allowed is a whole number from 1 on")
        if render_mode is not None:
            raise ValueError(f"render_mode={render_mode!r}: allowed is None; a single one draws")
        self.config = config_with(others, config)
        self.num_envs, self._mode = num_envs, checked_mode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self._mode}
        scenario = Scenario.drawn(self.config, seed)
        refuse(lateness.problems(self.config, scenario.destinations))
        self.world = World(scenario, stream(seed, Stream.WORLD), num_envs)
        self.single_observation_space = robot_space(self.world.observer)
        self.single_action_space = spaces.Discrete(scenario.actions.count)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._sources: list[np.random.Generator] = []
        self._seeds: list[int] = []
        self._begun, self._ended = False, np.zeros(num_envs, dtype=bool)
        self._draws = self.config.channel.fading == "slot"

    @property  # type: ignore[misc]  # nobody sets them
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]  # one of each
        """The environments' generators."""
        self._seed([None] * self.num_envs)
        return tuple(self._sources)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]  # one of each
        """The seeds of the environments' generators."""
        self._seed([None] * self.num_envs)
        return tuple(self._seeds)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> tuple[Observations, Infos]:
        """Begins an episode in every environment, or in those of ``reset_mask``.

        Args:
            seed: s, which makes s + i of the i-th environment, or a list of seeds; None goes on.
            options: ``starts_m``, in m, shape (K, 2), for all that are reset; ``reset_mask``, which
                those are, bools, shape (num_envs,).

        Returns:
            The observations of all, shape (num_envs, size), and the infos of those that were reset.

        Raises:
            ValueError: another option or a wrong one, or not a seed for each environment.
        """
        begun, options = reset_mask(options, self.num_envs)
        starts = starts_asked(options)
        cell = None if starts is None else start_cells(self.world, starts)
        if not (self._begun or begun.all()):
            raise ResetNeeded("no episode has begun yet: the first reset takes no reset_mask")
        self._seed(seeds(seed, self.num_envs), begun)
        self._begin(begun, cell)
        self._begun, self._ended = True, self._ended & ~begun
        return self._seen(), infos_of(self._columns(), begun)

    def step(self, actions: Ints) -> Slot:
        """One slot of each environment; shapes (num_envs, size) and (num_envs,).

        Raises:
            ResetNeeded: no episode has begun, or one has ended and nobody resets it.
            ValueError: an action outside the space.
        """
        if not self._begun or (self._mode is AutoresetMode.DISABLED and self._ended.any()):
            raise ResetNeeded("an episode is over or has not begun: call reset")
        actions = np.asarray(actions)
        if not self.action_space.contains(actions):
            allowed = (
                f"{self.num_envs} whole numbers from 0 to {self.world.scenario.actions.count - 1}"
            )
            raise ValueError(f"actions={actions.tolist()}: allowed is {allowed}")
        waiting, self._ended = self._ended, np.zeros(self.num_envs, dtype=bool)
        columns, outcome = self._slot(actions, waiting)
        terminated = outcome.arrived[:, 0]
        truncated = outcome.truncated & ~terminated
        ended = terminated | truncated
        infos: Infos = {}
        if self._mode is AutoresetMode.SAME_STEP:
            waiting = ended
            if ended.any():
                infos = final_infos(self._seen(), columns, ended)
        else:
            self._ended = ended
        if waiting.any():
            self._begin(waiting)
            new = self._columns()
            columns = {name: np.where(waiting, new[name], columns[name]) for name in new}
        everywhere = np.ones(self.num_envs, dtype=bool)
        infos.update(infos_of(columns, everywhere))
        return self._seen(), outcome.local_reward[:, 0].copy(), terminated, truncated, infos

    def _slot(self, actions: Ints, waiting: Bools) -> tuple[Columns, StepResult]:
        """A slot in all worlds but those that wait for their reset, with its infos."""
        world = self.world
        if waiting.any():
            world.driving = world.driving & ~waiting[:, None]
        phase, direction, level = everybodys_actions(world, actions)
        channel = world.channel(phase)
        idle = [self._sources[i].bit_generator for i in np.flatnonzero(waiting & self._draws)]
        states = [source.state for source in idle]
        outcome = world.step(phase, direction, level)
        for source, state in zip(idle, states, strict=True):
            source.state = state  # fading was drawn for a slot that its episode does not have
        return self._columns(channel, outcome, phase), outcome

    def _columns(
        self,
        channel: Complexes | None = None,
        outcome: StepResult | None = None,
        phase: Ints | None = None,
    ) -> Columns:
        """The infos of a slot, each of shape (num_envs,); without one, those of a reset."""
        columns = slot_columns(self.world, channel, outcome)
        return {
            **{name: column[:, 0] for name, column in columns.items()},
            "sum_rate": columns["rate"].sum(axis=-1),
            "phase": np.full(self.num_envs, NO_PHASE) if phase is None else phase,
        }

    def _seen(self) -> Observations:
        """What each environment's robot sees."""
        return self.world.local_observations()[:, 0].copy()

    def _begin(self, begun: Bools, cell: Ints | None = None) -> None:
        """Begins an episode in some worlds, from the cells given, shape (K,), or drawn ones."""
        rows = np.flatnonzero(begun)
        start = np.tile(cell, (len(rows), 1)) if cell is not None else self._drawn(rows)
        if len(rows) == self.num_envs:
            self.world.reset(start, self._sources)
        else:
            self.world.restart(begun, start, [self._sources[i] for i in rows])

    def _drawn(self, rows: Ints) -> Ints:
        """Starts in some worlds, each from its own source, shape (rows, K)."""
        drawn = []
        for i in rows:
            self.world.generator = self._sources[i]
            drawn.append(self.world.draw_starts(1))
        return np.concatenate(drawn)

    def _seed(self, seeds: Sequence[int | None], begun: Bools | None = None) -> None:
        """Makes the generators of environments that have none, and of those with a new seed."""
        for i, seed in enumerate(seeds):
            known = i < len(self._sources)
            if known and (seed is None or (begun is not None and not begun[i])):
                continue
            source, used = seeding.np_random(seed)
            self._sources[i : i + 1], self._seeds[i : i + 1] = [source], [used]
