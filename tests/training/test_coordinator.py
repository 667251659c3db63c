"""The coordinator: the order of a run's events, what robots are told, and when a run ends."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from agent.replay import RowLayout
from client_app.robots import RobotGroup
from client_app.state import CheckpointedRobots
from conf import Config, robot_network
from env.mdp.actions import ActionSpace
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import StepResult, World
from lockstep import Expect, InProcessFleet, LinkServer, ServerLost, serve
from lockstep.messages import Flag
from training.controllers.access_point import AccessPoint
from training.coordinator import Coordinator
from training.exchange.federation import build_federation
from training.partition import step_layout

SHAPE = (2, 7)
Log = list[tuple[Any, ...]]
Tiny = Callable[..., Config]


class SpiedWorld(World):
    """A world that keeps the outcomes, and cells and channels after each slot and reset."""

    def __init__(self, config: Config) -> None:
        scenario = Scenario.drawn(config.env, config.seed)
        super().__init__(scenario, stream(config.seed, Stream.WORLD))
        self.outcomes: list[StepResult] = []
        self.reached: list[NDArray[np.int64]] = []
        self.starts: list[NDArray[np.int64]] = []
        self.phases: list[int] = []
        self.reached_db: list[NDArray[np.float32]] = []
        self.starts_db: list[NDArray[np.float32]] = []

    def reset(self, start: Any = None, fading: Any = None) -> None:
        super().reset(start, fading)
        self.starts.append(self.cell[0])
        self.starts_db.append(self.measured_db[0])

    def restart(self, worlds: Any, start: Any = None, fading: Any = None) -> None:
        super().restart(worlds, start, fading)
        self.starts.append(self.cell[0])
        self.starts_db.append(self.measured_db[0])

    def step(self, phase_action: Any, direction: Any, level: Any) -> StepResult:
        outcome = super().step(phase_action, direction, level)
        self.phases.append(int(phase_action[0]))
        self.outcomes.append(outcome)
        self.reached.append(self.cell[0])
        self.reached_db.append(self.measured_db[0])
        return outcome


@dataclass
class ScriptedFleet:
    """Robots that drive straight home, or never, and remember what they were told."""

    world: SpiedWorld
    log: Log
    homing: bool = True
    told: list[np.ndarray] = field(default_factory=list)

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        self.log.append(("send_step", tick, window, expect))
        self.told.append(updates.copy())

    def actions(self, tick: int) -> NDArray[np.int32]:
        self.log.append(("actions", tick))
        config = self.world.config
        columns = self.world.floor.columns
        here, goal = self.told[-1]["cell"], self.world.destinations
        right, up = goal % columns - here % columns, goal // columns - here // columns
        direction = np.where(right != 0, np.where(right > 0, 2, 3), np.where(up > 0, 0, 1))
        if not self.homing:
            direction[:] = 0
        chosen = ActionSpace.from_config(config).encode(direction, np.full_like(direction, 3))
        driving = (self.told[-1]["flags"] & Flag.DRIVING) != 0
        return np.where(driving, chosen, -1).astype(np.int32)

    def upload(self, window: int) -> NDArray[np.float32]:
        self.log.append(("upload", window))
        robots = np.arange(self.world.robots, dtype=np.float32)[:, None, None]
        return np.broadcast_to(robots + window, (self.world.robots, *SHAPE)).astype(np.float32)

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        self.log.append(("download", window, weights.tolist()))

    def close(self) -> None:
        self.log.append(("close",))


class ScriptedPoint:
    """An access point that remembers what it saw."""

    def __init__(self, log: Log) -> None:
        self.log = log
        self.learned: list[SimpleNamespace] = []

    def act(self, state: NDArray[np.float32], tick: int) -> NDArray[np.int64]:
        self.log.append(("act", tick))
        return np.array([tick % 4])

    def serve(self, world: Any, action: Any, picks: Any) -> Any:
        return action, picks

    def learn(self, state: Any, action: Any, outcome: StepResult, next_observation: Any) -> None:
        self.log.append(("learn", int(action[0])))
        seen = {
            "state": state,
            "next_observation": next_observation,
            "terminal": bool(outcome.terminated[0]),
        }
        self.learned.append(SimpleNamespace(**seen, reward=float(outcome.global_reward[0])))

    def weights(self) -> NDArray[np.float32]:
        return np.zeros(SHAPE, np.float32)


class Observed:
    """Logs what an observer is told."""

    def __init__(self, log: Log) -> None:
        self.log = log
        self.lengths: list[int] = []

    def on_start(self) -> None:
        self.log.append(("start",))

    def on_episode(self, progress: Any, measures: Any) -> None:
        self.log.append(("episode", progress.episodes, progress.tick))
        self.lengths.append(int(measures.slots[0]))

    def on_window(self, progress: Any, robots: Any, ap: Any) -> None:
        self.log.append(("window", progress.window, progress.tick, robots.shape))


class Rig:
    """A coordinator among scripted parts, and all that happened there."""

    def __init__(
        self, config: Config, stop: Callable[[], bool] = lambda: False, homing: bool = True
    ) -> None:
        self.log: Log = []
        self.world = SpiedWorld(config)
        self.fleet = ScriptedFleet(self.world, self.log, homing)
        self.ap, self.observed = ScriptedPoint(self.log), Observed(self.log)
        self.federation = build_federation(config)
        self.run = Coordinator(
            config, self.world, self.ap, self.fleet, self.federation, self.observed, stop
        )
        self.weights = self.run.run(np.zeros(SHAPE, np.float32))

    def named(self, name: str) -> Log:
        return [event for event in self.log if event[0] == name]

    def answers(self) -> list[np.ndarray]:
        """What the robots were told of each outcome."""
        tells = self.named("send_step")
        before = [Expect.WEIGHTS, *(event[3] for event in tells)]
        pairs = zip(before, self.fleet.told, strict=False)
        return [told for expect, told in pairs if expect is Expect.ACTIONS]


# --- The order of events --------------------------------------------------------------------------


def test_a_run_keeps_the_order_of_algorithm_1(tiny: Tiny) -> None:
    rig = Rig(tiny({"federation.every": 2, "train.max_ticks": 4}), homing=False)
    mean = np.full(SHAPE, 2.0).tolist()
    assert rig.log == [
        ("send_step", 0, 1, Expect.ACTIONS),
        ("start",),
        ("act", 0),
        ("actions", 0),
        ("send_step", 1, 1, Expect.ACTIONS),
        ("learn", 0),
        ("act", 1),
        ("actions", 1),
        ("send_step", 2, 1, Expect.WEIGHTS),
        ("learn", 1),
        ("upload", 1),
        ("download", 1, mean),
        ("window", 1, 2, (1, *SHAPE)),
        ("send_step", 2, 2, Expect.ACTIONS),
        ("act", 2),
        ("actions", 2),
        ("send_step", 3, 2, Expect.ACTIONS),
        ("learn", 2),
        ("act", 3),
        ("actions", 3),
        ("send_step", 4, 2, Expect.END_ROUND),
        ("learn", 3),
        ("upload", 2),
        ("window", 2, 4, (1, *SHAPE)),
    ]
    np.testing.assert_array_equal(rig.weights, np.full((3, *SHAPE), 3.0))
    assert rig.world.phases == [0, 1, 2, 3]


def test_without_a_strategy_robots_upload_and_get_nothing_back(tiny: Tiny) -> None:
    rig = Rig(tiny({"strategy.name": "none", "train.max_ticks": 20}))
    assert [event[1] for event in rig.named("upload")] == [1, 2]
    assert rig.named("download") == []
    assert [event[3] for event in rig.named("window")] == [(3, *SHAPE)] * 2
    assert rig.weights[:, 0, 0].tolist() == [2.0, 3.0, 4.0]


# --- What robots are told -------------------------------------------------------------------------


def test_the_first_step_of_a_window_carries_no_outcome(tiny: Tiny) -> None:
    rig = Rig(tiny({"train.max_ticks": 40}))
    firsts = [
        told
        for event, told in zip(rig.named("send_step"), rig.fleet.told, strict=True)
        if event[3] is Expect.ACTIONS and event[1] == 10 * (event[2] - 1)
    ]
    assert len(firsts) == 4
    assert all((told["flags"] & (Flag.OUTCOME | Flag.ARRIVED) == 0).all() for told in firsts)
    assert (firsts[0]["flags"] == Flag.DRIVING).all()


def test_flags_say_who_drove_who_arrived_and_who_drives_on(tiny: Tiny) -> None:
    rig = Rig(tiny({"train.max_ticks": 100}))
    assert rig.run.progress.episodes > 2
    told = rig.answers()
    assert len(told) == len(rig.world.outcomes) == 100
    ended = 0
    for updates, outcome in zip(told, rig.world.outcomes, strict=True):
        flags = updates["flags"]
        np.testing.assert_array_equal((flags & Flag.OUTCOME) != 0, outcome.drove[0])
        np.testing.assert_array_equal((flags & Flag.ARRIVED) != 0, outcome.arrived[0])
        over = bool(outcome.terminated[0] or outcome.truncated[0])
        still = outcome.drove[0] & ~outcome.arrived[0] | over
        np.testing.assert_array_equal((flags & Flag.DRIVING) != 0, still)
        np.testing.assert_array_equal(updates["rate"], outcome.rate[0])
        ended += over
    assert ended == rig.run.progress.episodes


def test_an_arrived_robot_is_neither_told_to_act_nor_of_outcomes_until_the_reset(
    tiny: Tiny,
) -> None:
    rig = Rig(tiny({"train.max_ticks": 100}))
    waiting = np.zeros(3, dtype=bool)
    idle = 0
    for updates, outcome in zip(rig.answers(), rig.world.outcomes, strict=True):
        assert not (updates["flags"][waiting] & (Flag.OUTCOME | Flag.ARRIVED)).any()
        over = bool(outcome.terminated[0])
        waiting = np.zeros(3, dtype=bool) if over else waiting | outcome.arrived[0]
        np.testing.assert_array_equal((updates["flags"] & Flag.DRIVING) == 0, waiting)
        idle += int(waiting.sum())
    assert idle > 0


@pytest.mark.parametrize("fading", ["static", "slot"])
@pytest.mark.parametrize("homing", [True, False])
def test_after_an_episode_robots_see_the_next_start_and_the_outcome_of_the_last(
    tiny: Tiny, homing: bool, fading: str
) -> None:
    rig = Rig(tiny({"train.max_ticks": 100, "env.channel.fading": fading}), homing=homing)
    world = rig.world
    starts = iter(zip(world.starts[1:], world.starts_db[1:], strict=True))
    ends = zip(world.reached, world.reached_db, strict=True)
    for updates, outcome, end in zip(rig.answers(), world.outcomes, ends, strict=True):
        over = bool(outcome.terminated[0] or outcome.truncated[0])
        (reached, reached_db), (now, now_db) = end, next(starts) if over else end
        np.testing.assert_array_equal(updates["outcome_cell"], reached)
        np.testing.assert_array_equal(updates["cell"], now)
        np.testing.assert_array_equal(updates["outcome_channel_db"], reached_db)
        np.testing.assert_array_equal(updates["channel_db"], now_db)
    assert list(starts) == []


def test_the_access_point_learns_from_the_old_episode_and_acts_on_the_new_one(tiny: Tiny) -> None:
    rig = Rig(tiny({"train.max_ticks": 100}))
    learned, outcomes = rig.ap.learned, rig.world.outcomes
    assert [step.terminal for step in learned] == [bool(o.terminated[0]) for o in outcomes]
    assert [step.reward for step in learned] == [float(o.global_reward[0]) for o in outcomes]
    for step, after, outcome in zip(learned, learned[1:], outcomes, strict=False):
        assert np.array_equal(step.next_observation, after.state) != step.terminal
        assert bool((step.next_observation == 0).all()) == bool(outcome.terminated[0])


def test_a_time_out_is_not_terminal_to_the_access_point(tiny: Tiny) -> None:
    rig = Rig(tiny({"train.max_ticks": 50}), homing=False)
    assert rig.observed.lengths == [25, 25]
    assert not any(step.terminal for step in rig.ap.learned)
    end = rig.ap.learned[24]
    assert not np.array_equal(end.next_observation, rig.ap.learned[25].state)


# --- When a run ends ------------------------------------------------------------------------------


@pytest.mark.parametrize(("most", "ticks"), [(1, 10), (10, 10), (11, 20), (35, 40)])
def test_a_run_ends_at_the_first_window_boundary_after_its_last_tick(
    tiny: Tiny, most: int, ticks: int
) -> None:
    rig = Rig(tiny({"train.max_ticks": most}))
    assert (rig.run.progress.tick, rig.run.progress.window) == (ticks, ticks // 10)
    assert not rig.run.stopped


@pytest.mark.parametrize(("every", "ticks"), [(10, 30), (25, 25), (40, 40)])
def test_a_run_ends_at_the_first_window_boundary_after_its_last_episode(
    tiny: Tiny, every: int, ticks: int
) -> None:
    changes = {"train.episodes": 1, "train.max_ticks": 1000, "federation.every": every}
    rig = Rig(tiny(changes), homing=False)
    assert rig.named("episode")[0] == ("episode", 1, 25)
    assert rig.run.progress.tick == ticks


def test_an_episode_goes_on_across_windows(tiny: Tiny) -> None:
    rig = Rig(tiny({"train.max_ticks": 50, "federation.every": 7}), homing=False)
    assert rig.named("episode") == [("episode", 1, 25), ("episode", 2, 50)]
    assert [event[2] for event in rig.named("window")] == [7, 14, 21, 28, 35, 42, 49, 56]


def test_a_stop_is_honoured_at_the_next_window_boundary(tiny: Tiny) -> None:
    calls: list[int] = []

    def stop() -> bool:
        calls.append(1)
        return len(calls) == 2

    rig = Rig(tiny({"train.max_ticks": 1000}), stop)
    assert rig.run.stopped
    assert (rig.run.progress.tick, rig.run.progress.window, len(calls)) == (20, 2, 2)
    assert rig.named("send_step")[-1] == ("send_step", 20, 2, Expect.END_ROUND)
    assert rig.log[-2:] == [("upload", 2), ("window", 2, 20, (1, *SHAPE))]


def test_what_a_robot_raises_ends_the_run_at_once(tiny: Tiny, play: Callable[..., Any]) -> None:
    class Broken(ScriptedFleet):
        def actions(self, tick: int) -> NDArray[np.int32]:
            if tick == 3:
                raise ConnectionError("robot 1 has gone")
            return super().actions(tick)

    config = tiny()
    with pytest.raises(ConnectionError, match="robot 1"):
        play(config, fleet=Broken(SpiedWorld(config), []))


@pytest.mark.parametrize("wild", [-2, 96, 2**31 - 1, -(2**31)])
def test_an_action_that_is_none_ends_the_run_and_names_the_robot(
    tiny: Tiny, play: Callable[..., Any], wild: int
) -> None:
    class Hostile(ScriptedFleet):
        def actions(self, tick: int) -> NDArray[np.int32]:
            chosen = super().actions(tick)
            if tick == 3:
                chosen[1] = wild
            return chosen

    config = tiny({"env.power.levels": 24})
    with pytest.raises(ValueError, match=f"tick 3: action {wild} of robot 1, of -1 to 95"):
        play(config, fleet=Hostile(SpiedWorld(config), []))


# --- The same bits, however robots are grouped ----------------------------------------------------

BLOCKS = ([(0, 1, 2)], [(0, 1), (2,)], [(0,), (1,), (2,)], [(2, 0), (1,)])


@dataclass
class TcpFleet:
    """The fleet of a real link; the run's last weights are uploaded like all others."""

    link: LinkServer

    def send_step(self, tick: int, window: int, expect: Expect, updates: np.ndarray) -> None:
        self.link.send_step(
            tick, window, Expect.WEIGHTS if expect is Expect.END_ROUND else expect, updates
        )

    def actions(self, tick: int) -> NDArray[np.int32]:
        return self.link.actions(tick)

    def upload(self, window: int) -> NDArray[np.float32]:
        return self.link.upload(window)

    def download(self, window: int, weights: NDArray[np.float32]) -> None:
        self.link.download(window, weights)

    def close(self) -> None:
        self.link.close()


def over_tcp(
    config: Config, blocks: list[tuple[int, ...]], play: Callable[..., Any]
) -> tuple[Any, list[BaseException]]:
    """A run whose robots are behind sockets, each block on a thread of its own."""
    shape = (2, robot_network(config).parameters)
    initial = robot_network(config).initial_pair(stream(config.seed, Stream.WEIGHTS))
    layout = step_layout(config)
    link = LinkServer("127.0.0.1", 0, fingerprint="test", timeout_s=20, layout=layout)
    raised: list[BaseException] = []

    def client(block: tuple[int, ...]) -> None:
        robots = CheckpointedRobots(config, block, None)
        robots.begin(0, initial)
        tokens = [f"secret-{robot}" for robot in block]
        options = {"fingerprint": "test", "timeout_s": 20.0, "n_parameters": shape[1]}
        try:
            serve(link.address, block, tokens, robots, layout=layout, **options)
        except ServerLost as error:
            raised.append(error)

    try:
        link.admit(blocks, {robot: f"secret-{robot}" for robot in range(3)}, shape)
        threads = [threading.Thread(target=client, args=(block,)) for block in blocks]
        for thread in threads:
            thread.start()
        link.wait_connected(20)
        played = play(config, fleet=TcpFleet(link))
    finally:
        link.close()
    for thread in threads:
        thread.join(120)
        assert not thread.is_alive()
    return played, raised


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(
    tiny: Tiny, play: Callable[..., Any]
) -> None:
    one, again = play(tiny()), play(tiny())
    assert one.digests == again.digests
    assert one.watcher.episodes == again.watcher.episodes
    other = play(tiny({"seed": 1}))
    assert other.digests[0] != one.digests[0]
    assert other.digests[1] != one.digests[1]
    drifts = np.abs(np.diff([window[0, 0] for window in one.watcher.windows], axis=0)).max(axis=1)
    assert (drifts > 1e-3).all()


SERVING: dict[str, Any] = {
    "env.reward.credit": "difference",
    "env.reward.weights": "objective",
    "env.state.others": 1,
    "env.state.way": "on",
    "env.state.order": "gain",
}


def some_always(names: Iterable[str], *always: str) -> list[Any]:
    """Cases of which some are played always, all in `make test-all`."""
    slow = [pytest.mark.slow]
    return [pytest.param(name, marks=[] if name in always else slow) for name in names]


GROUPED: dict[str, dict[str, Any]] = {
    "fedavg": {},
    "none": {"strategy.name": "none"},
    "worlds": {"train.worlds": 3},
    "credit": SERVING,
    "worlds_credit": {"train.worlds": 3, **SERVING},
}


@pytest.mark.parametrize("variant", some_always(GROUPED, "fedavg", "worlds_credit"))
def test_grouping_changes_no_bit(tiny: Tiny, play: Callable[..., Any], variant: str) -> None:
    config = tiny({"train.max_ticks": 100, **GROUPED[variant]})
    found = {play(config, blocks).digests for blocks in BLOCKS}
    assert len(found) == 1


def test_each_of_the_groupings_trains_to_weights_of_its_own(
    tiny: Tiny, play: Callable[..., Any]
) -> None:
    ends = [play(tiny({"train.max_ticks": 60, **each})).digests for each in GROUPED.values()]
    assert len({robots for robots, _ in ends}) == len(GROUPED)


CARRIED: dict[str, dict[str, Any]] = {
    "robots": {},
    "ap": {"scheme.power": "ap"},
    "search": {"scheme.power": "search"},
    "worlds_search": {"scheme.power": "search", "train.worlds": 3},
    "worlds_credit": {"train.worlds": 3, **SERVING},
}


@pytest.mark.parametrize("variant", some_always(CARRIED, "robots", "worlds_search"))
def test_sockets_change_no_bit(tiny: Tiny, play: Callable[..., Any], variant: str) -> None:
    config = tiny({"train.max_ticks": 100, **CARRIED[variant]})
    expected = play(config).digests
    for blocks in BLOCKS[1:]:
        played, raised = over_tcp(config, blocks, play)
        assert played.digests == expected
        assert len(raised) == len(blocks)
        assert all("the server has closed the link" in str(error) for error in raised)


def test_each_world_plays_its_own_episodes(tiny: Tiny, play: Callable[..., Any]) -> None:
    """Worlds begin anew by themselves, and all that happens in them is learned from."""
    config = tiny({"train.max_ticks": 200, "train.worlds": 3, "env.motion.max_slots": 60})
    played = play(config)
    ends = [tick for _, tick, *_ in played.watcher.episodes]
    assert len(ends) >= 9
    assert ends == sorted(ends)
    assert len({*ends}) > 3


class Slot(NamedTuple):
    """What a world says of a slot: states before and after it, and what was done and came of it."""

    seen: NDArray[np.float32]
    direction: NDArray[np.int64]
    level: NDArray[np.int64]
    outcome: StepResult
    reached: NDArray[np.float32]


class RecordedWorld(World):
    """Worlds that keep what they say of every slot."""

    def __init__(self, config: Config) -> None:
        scenario = Scenario.drawn(config.env, config.seed)
        super().__init__(scenario, stream(config.seed, Stream.WORLD), config.train.worlds)
        self.slots: list[Slot] = []

    def step(self, phase_action: Any, direction: Any, level: Any) -> StepResult:
        seen = self.local_observations().copy()
        outcome = super().step(phase_action, direction, level)
        reached = self.local_observations().copy()
        self.slots.append(Slot(seen, direction.copy(), level.copy(), outcome, reached))
        return outcome


@pytest.mark.parametrize(
    "changes",
    [{}, SERVING, {"env.channel.fading": "slot", **SERVING}],
    ids=["plain", "all", "fading"],
)
def test_robots_learn_from_what_each_world_says(tiny: Tiny, changes: dict[str, Any]) -> None:
    """Their replays hold it, also where one world's episode ends while others go on."""
    many = {"train.worlds": 3, "agent.replay_size": 1000, "env.motion.max_slots": 60}
    config = tiny({"train.max_ticks": 200, **many, **changes})
    initial = robot_network(config).initial_pair(stream(config.seed, Stream.WEIGHTS))
    group, world = RobotGroup(config, (0, 1, 2)), RecordedWorld(config)
    group.download(0, initial)
    handlers: list[Any] = [(group.robots, group)]
    fleet = InProcessFleet(handlers, step_layout(config))
    federation = build_federation(config)
    run = Coordinator(config, world, AccessPoint(config), fleet, federation, Observed([]))
    run.run(initial)
    over = np.array([slot.outcome.terminated | slot.outcome.truncated for slot in world.slots])
    assert over.shape == (200, 3)
    assert (over.any(axis=1) & ~over.all(axis=1)).sum() >= 4
    assert any(slot.outcome.terminated.any() for slot in world.slots)
    layout, space = RowLayout(robot_network(config).inputs), ActionSpace.from_config(config.env)
    for robot in range(3):
        told = [
            (
                slot.seen[each, robot],
                space.encode(slot.direction, slot.level)[each, robot],
                np.float32(config.agent.reward_scale * slot.outcome.local_reward[each, robot]),
                slot.reached[each, robot],
                slot.outcome.arrived[each, robot],
            )
            for slot in world.slots
            for each in np.flatnonzero(slot.outcome.drove[:, robot])
        ]
        stored = layout.unpack(group.agents.agent_state(robot)["replay"])
        assert 300 < len(told) < 600
        for expected, found in zip(zip(*told, strict=True), stored, strict=True):
            np.testing.assert_array_equal(found, np.array(expected))


# --- Strategies -----------------------------------------------------------------------------------

STRATEGIES: dict[str, dict[str, Any]] = {
    "fedavg": {},
    "fedavgm": {"strategy.server_rate": 0.5, "strategy.momentum": 0.5},
    "fedadam": {"strategy.server_rate": 0.01, "strategy.beta_1": 0.9, "strategy.tau": 0.001},
    "fedmedian": {},
    "fedprox": {"strategy.proximal_mu": 1.0},
    "krum": {},
    "none": {},
}


@pytest.mark.parametrize("name", STRATEGIES)
def test_a_strategy_leaves_robots_equal_and_none_leaves_them_different(
    tiny: Tiny, play: Callable[..., Any], name: str
) -> None:
    played = play(tiny({"strategy.name": name, **STRATEGIES[name]}))
    assert played.run.progress.window == 10
    assert np.isfinite(played.robots).all()
    distinct = {robot.tobytes() for robot in played.robots}
    assert len(distinct) == (3 if name == "none" else 1)
    shapes = {window.shape[0] for window in played.watcher.windows}
    assert shapes == ({3} if name == "none" else {1})


def test_strategies_lead_to_weights_of_their_own(tiny: Tiny, play: Callable[..., Any]) -> None:
    ends = [
        play(tiny({"strategy.name": name, "train.max_ticks": 30, **changes})).digests[0]
        for name, changes in STRATEGIES.items()
    ]
    assert len(set(ends)) == len(STRATEGIES)


def test_krum_takes_the_weights_of_one_robot(tiny: Tiny, play: Callable[..., Any]) -> None:
    config = tiny({"strategy.name": "krum", "train.max_ticks": 10})
    alone = play(changed(config, "none"))
    chosen = play(config).robots[0]
    assert chosen.tobytes() in {robot.tobytes() for robot in alone.robots}


def changed(config: Config, strategy: str) -> Config:
    return dataclasses.replace(config, strategy=dataclasses.replace(config.strategy, name=strategy))


def test_the_proximal_term_holds_robots_nearer_to_the_global_model(
    tiny: Tiny, play: Callable[..., Any]
) -> None:
    spreads = []
    for changes in ({}, {"strategy.name": "fedprox", "strategy.proximal_mu": 30.0}):
        first, *_, last = play(tiny({"train.max_ticks": 60, **changes})).watcher.windows
        spreads.append(float(np.abs(last[0, 0] - first[0, 0]).mean()))
    assert spreads[1] < spreads[0]
