"""A building's frozen weights in its rooms: trained in, held out, and after a short adaptation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from agent import single_threaded
from client_app.rooms import HostedRoom
from conf import Config
from experiments.analysis.frozen import played_by
from training.evaluation import Evaluator
from training.recording.history import MEASURES, mean
from training.rooms import Weights, known_rooms
from training.run_folder import RunFolder

Measures = dict[str, float]


def columns(
    folder: RunFolder,
    config: Config,
    episodes: int | None,
    epsilons: Sequence[float],
    starts_seed: int | None = None,
    personalise: int = 0,
) -> dict[str, Measures]:
    """Plays a building's final weights in all its rooms.

    Args:
        folder: of the building's run.
        config: of the building.
        episodes: held-out episodes in each room; ``config.evaluation.episodes`` if None.
        epsilons: explorations to play with.
        starts_seed: picks the held-out starts and the exploration; each room's seed if None.
        personalise: ticks for which each room goes on to learn by itself from the weights that it
            is given, to be evaluated once more; 0 is none.

    Returns:
        From a column's name to its measures: means over rooms, each counted alike.

    Raises:
        ConfigError: the run has not ended, or its files are damaged.
    """
    rooms = known_rooms(config, folder)
    found: dict[str, list[Measures]] = {}
    for room in rooms:
        kind = "held out" if room.held_out else "trained in"
        config, policies = of_room(folder.room(room.name), personalise)
        evaluator = Evaluator(config, episodes=episodes, starts_seed=starts_seed)
        for end, (model, own_ap) in zip(("", ", personalised"), policies, strict=False):
            name = f"{kind}{end}"
            played = played_by(evaluator, model[None], own_ap, epsilons)
            for epsilon, measures in zip(epsilons, played, strict=True):
                title = f"{name}, eps = {epsilon:g}" if len(epsilons) > 1 else name
                found.setdefault(title, []).append(measures.summary())
    return {
        name: {key: mean([row[key] for row in rows]) for key in (*MEASURES, "reward", "slots")}
        for name, rows in found.items()
    }


def of_room(place: RunFolder, personalise: int) -> tuple[Config, list[tuple[Weights, Weights]]]:
    """A room's configuration, and its policies: the final weights, and personalised ones.

    Each is an online network of the robots, shape (P,), and one of the access point, (P_AP,).
    """
    config = place.read_config()
    robots, ap = place.read_networks(config)
    policies = [(robots[0, 0], ap[0])]
    if personalise:
        policies.append(adapted(config, robots[0], ap, personalise))
    return config, policies


def adapted(config: Config, robots: Weights, ap: Weights, ticks: int) -> tuple[Weights, Weights]:
    """What a room's own robots and access point learn on from the weights that they are given.

    They explore as at the end of training, with fresh replays.

    Args:
        config: of the room.
        robots: online and target, shape (2, P).
        ap: the same of the access point, shape (2, P_AP).
        ticks: at least so many; whole windows are played.

    Returns:
        Online networks, shapes (P,) and (P_AP,).
    """
    agent = config.agent
    epsilon = replace(agent.epsilon, start=agent.epsilon.end)
    rate = agent.learning_rate if agent.learning_rate_end is None else agent.learning_rate_end
    calm = replace(agent, epsilon=epsilon, learning_rate=rate, learning_rate_end=None)
    single_threaded()
    report = HostedRoom(replace(config, agent=calm)).play(
        -(-ticks // config.federation.every), robots, ap
    )
    return report.model[0], report.ap[0]
