"""The whole fleet as a PettingZoo parallel environment: every robot and the access point."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium import logger, spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv  # type: ignore[import-untyped]

from env.apis.fleet_infos import AP, Infos, fleet_infos
from env.apis.observation_spaces import ap_space, robot_space
from env.apis.starts import start_cells, starts_asked
from env.arrays import Complexes, Floats32, Ints
from env.checks import checked_config, refuse
from env.config import EnvConfig
from env.mdp import lateness
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import StepResult, World

if TYPE_CHECKING:
    from env.rendering.drawing import Picture

Observations = dict[str, Floats32]


class RISFleetParallelEnv(ParallelEnv):  # type: ignore[misc]
    r"""K robots drive to their destinations while an access point steers an RIS for their rates.

    ## Description

    Each slot (1 s), each robot moves one cell of 0.5 m and picks the power of its downlink; the
    access point sets the phases of the reconfigurable intelligent surface. Rates are those of NOMA
    (of OMA with ``access=oma``) at the cells that robots leave. All of it is ``env.world.World``
    with one world.

    ## Agents

    ``robot_0`` ... ``robot_{K-1}`` and ``ap``. A robot that has arrived leaves ``agents``. With
    ``absorbing=True`` it stays there, for libraries in which no agent may leave: at its
    destination, whatever action it is given, and paid 0.

    ## Action Space

    | Agent | Space               | Action                                                        |
    |-------|---------------------|---------------------------------------------------------------|
    | robot | ``Discrete(4 N_P)`` | direction (n, s, e, w) * N_P + level - 1; power P_max/2^level |
    | ap    | ``Discrete(N_R^N)`` | its N base-N_R digits are phases, (digit + 1/2) 2 pi / N_R    |

    With ``ris.action=codebook`` the access point's space is ``Discrete`` of the number of sectors,
    and action ``a`` is the beam of sector ``a``, row by row from the bottom up.

    A move out of the room stays put, with ``walls.block_motion`` also one through a wall, with
    ``collisions=block`` one into another robot's cell (lower index first). Levels are picks: with
    ``power.resolve=project`` the AP sends the nearest combination that every robot can decode.
    With OMA they have no effect.

    ## Observation Space

    A robot's, ``Box``, float32, shape (5,), or (3,) with ``state.destination=none``:

    | Num | Observation                                    | Min | Max |
    |-----|------------------------------------------------|-----|-----|
    | 0-1 | x and y over half the room's side, - 1         | -1  | 1   |
    | 2   | (\|hbar\|^2 in dB + 70) / 20, direct channel   | -10 | 10  |
    | 3-4 | way left in x and y over the room's side       | -1  | 1   |

    With solid walls or ``state.way=on`` five more: for each direction the slots that the move
    saves (-1, 0 or 1), and the slots left over half of the floor's rows and columns (0 to 10).
    With ``state.others=m`` seven (or five) more for each of m other robots, those that will have
    driven the fewest slots first, zeros for one that has arrived: 1, how many slots more that is
    over ``reward.horizon_slots`` (-2 to 2), its 0-4; then the horizon over the robot's own slots
    (0 to 4).

    The access point's, shape (8 K,) or (6 K,): for each robot in turn, zeros once it has arrived,

    | Num | Observation                                    | Min | Max |
    |-----|------------------------------------------------|-----|-----|
    | 0-2 | the robot's 0-2                                |     |     |
    | 3-4 | cos and sin of arg hbar                        | -1  | 1   |
    | 5   | 1 while driving                                | 0   | 1   |
    | 6-7 | the robot's 3-4, the offset                    | -1  | 1   |

    With ``state.weights`` one more for each: its share of the weights of all that drive (0 to 1).
    With ``state.order=gain`` robots stand from the strongest direct channel to the weakest.

    ## Rewards

    Not scaled. A robot: phi R + psi (distance gone towards the destination, in m) - 1, and + 100
    where it arrives, with phi = 0.05 and psi = 3; the distance is straight, where walls are solid
    (or with ``reward.distance=way``) the shortest over the floor. The access point: 0.1 times the
    sum of rates. With ``metric=qoe`` the quality lg(R) of those that drive stands for R in both;
    ``reward.credit`` and ``reward.weights`` weigh the rates as the paper's objective does.

    ## Starting State

    Each robot in a random cell at least 10 m from its destination. Destinations are the first K of
    ``tasks.destinations_m``; further ones are drawn once, from the constructor's ``seed``.
    ``reset(seed=s)`` begins the stream of starts anew, the one of a training run with ``seed=s``,
    and leaves the destinations. ``tasks.destination=random`` draws all of them, ``common`` sends
    all robots to the first; ``tasks.start=fixed`` starts at ``tasks.starts_m``.
    ``options={"starts_m": [[x, y], ...]}`` sets the starts.

    ## Episode End

    1. Termination: of a robot, when it arrives; of the access point, when all have.
    2. Truncation: of all that are left after T_max slots (150).

    With ``absorbing=True`` an episode ends for all agents at once: terminated when all robots have
    arrived, else truncated.

    Infos of a robot hold ``rate`` (bit/s/Hz), ``power_w``, ``gain_db`` (|h|^2 with the RIS),
    ``sic_failed`` and ``arrived`` of the slot, and ``shortest_slots``, the length of the way that
    is left; of the access point ``sum_rate``, ``projected`` and ``margin_dropped``. A reset has the
    same keys: nothing has been sent, and ``gain_db`` is that of the direct channel. With
    ``absorbing=True`` all infos have ``action_mask``, int8, of which actions count: all of them,
    and 0 alone, for want of none, once the robot has arrived; those of a robot also ``driving``.

    ## Arguments

    | Argument      | Default | Description                                                     |
    |---------------|---------|-----------------------------------------------------------------|
    | `config`      | `None`  | an `EnvConfig`, or what differs from it: `{"ris": {"side": 0}}` |
    | `seed`        | `0`     | names drawn destinations, and the starts until `reset(seed)`    |
    | `render_mode` | `None`  | `"rgb_array"`: a picture of the floor; `"ansi"`: text           |
    | `absorbing`   | `False` | robots that have arrived stay among the agents, paid 0          |

    ## Version History

    * v0: initial version.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012  # PettingZoo's type
        "name": "risfleet_v0",
        "render_modes": ["rgb_array", "ansi"],
        "render_fps": 10,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        config: EnvConfig | Mapping[str, Any] | None = None,
        *,
        seed: int = 0,
        render_mode: str | None = None,
        absorbing: bool = False,
    ) -> None:
        modes = self.metadata["render_modes"]
        if render_mode is not None and render_mode not in modes:
            raise ValueError(f"render_mode={render_mode!r}: allowed is None, {', '.join(modes)}")
        self.config = checked_config(config)
        self.render_mode, self.absorbing = render_mode, absorbing
        scenario = Scenario.drawn(self.config, seed)
        refuse(lateness.problems(self.config, scenario.destinations))
        self.world = World(scenario, stream(seed, Stream.WORLD))
        self.robots = [f"robot_{k}" for k in range(self.world.robots)]
        self.possible_agents = [*self.robots, AP]
        self.agents: list[str] = []
        self._centres_m = self.world.floor.centres()
        self._way: list[Ints] = []
        self._outcome: StepResult | None = None
        self._picture: Picture | None = None
        self._make_spaces()

    def _make_spaces(self) -> None:
        world, encoder = self.world, self.world.observer
        actions = world.scenario.actions.count
        self.observation_spaces = {name: robot_space(encoder) for name in self.robots}
        self.observation_spaces[AP] = ap_space(encoder, world.robots)
        self.action_spaces = {name: spaces.Discrete(actions) for name in self.robots}
        self.action_spaces[AP] = spaces.Discrete(world.phase_actions)
        self.state_space = self.observation_spaces[AP]

    def observation_space(self, agent: str) -> spaces.Box[np.float32]:
        """The agent's observations; the same object at each call."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """The agent's actions; the same object at each call."""
        return self.action_spaces[agent]

    def state(self) -> Floats32:
        """What the access point sees, s_G, shape (global_size,)."""
        return np.asarray(self.world.global_observation()[0])

    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Observations, Infos]:
        """Begins an episode; ``starts_m`` in the options is in m, shape (K, 2).

        Raises:
            ValueError: another option, or starts that cannot be.
        """
        starts = starts_asked(options)
        cell = None if starts is None else start_cells(self.world, starts)[None]
        if seed is not None:
            self.world.generator = stream(seed, Stream.WORLD)
        self.world.reset(cell)
        self.agents = list(self.possible_agents)
        self._way, self._outcome = [self.world.cell[0]], None
        return self._observations(), self._infos()

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """One slot for all agents that are left; with none left, five empty dictionaries.

        Raises:
            ValueError: an agent's action is missing or outside its space.
        """
        if not self.agents:
            if not self._way:
                raise RuntimeError("step was called before reset")
            return {}, {}, {}, {}, {}
        live = self.agents
        picks = np.array([[self._action(name, actions) for name in self.robots]])
        phase = np.array([self._action(AP, actions)])
        channel = self.world.channel(phase)
        outcome = self.world.step(phase, *self.world.scenario.actions.decode(picks))
        self._way.append(self.world.cell[0])
        self._outcome = outcome
        ended = dict(zip(self.robots, outcome.arrived[0].tolist(), strict=True))
        over = ended[AP] = bool(outcome.terminated[0])
        if self.absorbing:
            ended = dict.fromkeys(ended, over)
        paid = dict(zip(self.robots, outcome.local_reward[0].tolist(), strict=True))
        paid[AP] = float(outcome.global_reward[0])
        out_of_time = bool(outcome.truncated[0])
        seen, infos = self._observations(), self._infos(channel, outcome)
        self.agents = [name for name in live if not (ended[name] or out_of_time)]
        return (
            {name: seen[name] for name in live},
            {name: paid[name] for name in live},
            {name: ended[name] for name in live},
            {name: out_of_time and not ended[name] for name in live},
            {name: infos[name] for name in live},
        )

    def _action(self, agent: str, actions: Mapping[str, Any]) -> int:
        """The agent's action, checked; -1 for a robot that has arrived."""
        if agent != AP and not self.world.driving[0, self.robots.index(agent)]:
            return -1
        space = self.action_spaces[agent]
        action = actions.get(agent)
        if action is None or not space.contains(action):
            allowed = f"a whole number from 0 to {space.n - 1}"
            raise ValueError(f"action of {agent}={action!r}: allowed is {allowed}")
        return int(action)

    def _infos(self, channel: Complexes | None = None, outcome: StepResult | None = None) -> Infos:
        return fleet_infos(self.world, self.robots, channel, outcome, masks=self.absorbing)

    def _observations(self) -> Observations:
        local = self.world.local_observations()
        seen = {name: local[0, k].copy() for k, name in enumerate(self.robots)}
        return {**seen, AP: self.world.global_observation(local)[0]}

    def render(self) -> NDArray[np.uint8] | str | None:
        """The floor and the ways so far: a picture, shape (480, 480, 3), or lines of text."""
        if self.render_mode is None:
            logger.warn('render needs render_mode="rgb_array" or "ansi" when the view is made')
            return None
        if not self._way:
            raise RuntimeError("render was called before reset")
        rate = np.zeros(self.world.robots) if self._outcome is None else self._outcome.rate[0]
        title = (
            f"slot {self.world.slot[0]} of {self.config.motion.max_slots},"
            f" {self.world.driving.sum()} of {self.world.robots} driving,"
            f" {rate.sum():.1f} bit/s/Hz"
        )
        ways_m = self._centres_m[np.stack(self._way)]
        goals_m = self._centres_m[self.world.destinations]
        if self.render_mode == "ansi":
            rows = zip(self.robots, ways_m[-1].tolist(), goals_m.tolist(), rate, strict=True)
            lines = (
                f"{name} at {at} m, to {goal} m, {r:.2f} bit/s/Hz" for name, at, goal, r in rows
            )
            return "\n".join((title, *lines))
        from env.rendering.drawing import Picture  # matplotlib: only where somebody looks

        self._picture = self._picture or Picture(self.world)
        return self._picture.frame(ways_m, goals_m, title)

    def close(self) -> None:
        """Lets the picture go."""
        self._picture = None

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the picture, which is drawn again when it is needed."""
        return {**self.__dict__, "_picture": None}


def parallel_env(**kwargs: Any) -> RISFleetParallelEnv:
    """Makes the environment, under the name that PettingZoo's tools look for."""
    return RISFleetParallelEnv(**kwargs)
