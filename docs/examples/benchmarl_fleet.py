"""BenchMARL trains the fleet: ``python docs/examples/benchmarl_fleet.py algorithm=qmix seed=1``.

MAPPO, QMIX, VDN, IQL and what else BenchMARL has for discrete actions, on the whole fleet: robots
are one group of agents, the access point another. `docs/marl.md` says what each of them sees.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import hydra
import numpy as np
import torch
from benchmarl.environments import Task, TaskClass
from benchmarl.experiment import Callback, Experiment
from benchmarl.hydra_config import (
    load_algorithm_config_from_hydra,
    load_experiment_config_from_hydra,
    load_model_config_from_hydra,
)
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict
from torchrl.data import Composite
from torchrl.envs import EnvBase, RewardScaling, Transform
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl_worlds import ACCESS_POINT, ROBOTS, FleetWorlds, as_seen

import env
from agent import single_threaded
from conf import Config
from env.apis.fleet_infos import AP
from training.controllers.policies import Decision, Exploration, PolicyWeights
from training.evaluation import Evaluator

EPSILONS = (0.05, 0.0)
NO_WEIGHTS = np.empty((1, 0), dtype=np.float32)
EVALUATIONS = "evaluations.csv"


class FleetClass(TaskClass):
    """BenchMARL's view of the fleet, for configurations ``{"env": {...}, "reward_scale": 0.1}``."""

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """Makes that many fleets at once."""
        return partial(FleetWorlds, self.config["env"], num_envs, seed, device)

    def supports_continuous_actions(self) -> bool:
        """All actions are discrete."""
        return False

    def supports_discrete_actions(self) -> bool:
        """All actions are discrete."""
        return True

    def max_steps(self, env: EnvBase) -> int:
        """T_max."""
        return int(env.world.config.motion.max_slots)

    def has_render(self, env: EnvBase) -> bool:
        """Fleets are not drawn here."""
        return False

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """The robots, and the access point."""
        return {ROBOTS: [f"robot_{k}" for k in range(env.world.robots)], ACCESS_POINT: [AP]}

    def observation_spec(self, env: EnvBase) -> Composite:
        """What each agent sees."""
        return _without(env, "action_mask")

    def action_mask_spec(self, env: EnvBase) -> Composite:
        """Which actions count."""
        return _without(env, "observation")

    def info_spec(self, env: EnvBase) -> None:
        """There are no infos."""

    def state_spec(self, env: EnvBase) -> Composite:
        """s_G: what QMIX's mixer and MAPPO's critic see."""
        return Composite(state=env.full_observation_spec_unbatched["state"].clone())

    def action_spec(self, env: EnvBase) -> Composite:
        """What each agent can do."""
        return env.full_action_spec_unbatched

    def get_env_transforms(self, env: EnvBase) -> list[Transform]:
        """Scales the rewards that are learned from."""
        keys = [(group, "reward") for group in (ROBOTS, ACCESS_POINT)]
        return [RewardScaling(0.0, self.config["reward_scale"], in_keys=keys)]

    @staticmethod
    def env_name() -> str:
        """The environment's name in files."""
        return "risfleet"


def _without(env: EnvBase, key: str) -> Composite:
    """The groups' observations without the state, and without what stands under the key."""
    spec = env.full_observation_spec_unbatched.clone()
    del spec["state"]
    for group in (ROBOTS, ACCESS_POINT):
        del spec[group, key]
    return spec


class FleetTask(Task):
    """The tasks: one, whose configuration says all."""

    FLEET = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        """What makes the environments."""
        return FleetClass


class HeldOut(Callback):
    """Plays frozen policies from the starts of F-DRL's evaluations and writes a row for each.

    Args:
        config: of the F-DRL run whose starts are played.
        folder: where ``evaluations.csv`` goes.
        every: slots of training between two evaluations.
    """

    def __init__(self, config: Config, folder: Path, every: int) -> None:
        super().__init__()
        self._config, self._path, self._every = config, folder / EVALUATIONS, every
        self._path.unlink(missing_ok=True)

    def on_train_end(self, training_td: TensorDict, group: str) -> None:
        """Evaluates once the last group has learned."""
        frames = self.experiment.total_frames
        if group == [*self.experiment.group_map][-1] and frames % self._every == 0:
            evaluator = Evaluator(self._config, policy=self._decide)
            measured = evaluator.play(NO_WEIGHTS, NO_WEIGHTS[0], EPSILONS)
            for epsilon, measures in zip(EPSILONS, measured, strict=True):
                self._write({"tick": frames, "epsilon": epsilon, **measures.summary()})

    def _decide(self, world: env.World, _: PolicyWeights, exploration: Exploration) -> Decision:
        """The policy's choices, a share of them replaced by random ones."""
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            chosen = self.experiment.policy(as_seen(world))
        phase = exploration(chosen[ACCESS_POINT, "action"][:, 0].numpy(), world.phase_actions)
        actions = world.scenario.actions
        picks = exploration(chosen[ROBOTS, "action"].numpy(), actions.count)
        return Decision(phase, *actions.decode(picks))

    def _write(self, row: Mapping[str, float]) -> None:
        new = not self._path.exists()
        with self._path.open("a", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, row.keys())
            if new:
                writer.writeheader()
            writer.writerow(row)


def check(settings: DictConfig) -> None:
    """Refuses what cannot be trained.

    Raises:
        ValueError: it says which key, its value, and what is allowed.
    """
    env.checked_config(OmegaConf.to_container(settings.env))
    on_policy = load_algorithm_config_from_hydra(settings.algorithm).on_policy()
    learning = load_experiment_config_from_hydra(settings.experiment)
    frames = learning.collected_frames_per_batch(on_policy)
    if settings.evaluate_every % frames:
        allowed = f"a multiple of the {frames} slots in a batch"
        raise ValueError(f"evaluate_every={settings.evaluate_every}: allowed is {allowed}")


def train(settings: DictConfig, folder: Path) -> Experiment:
    """Trains as the settings say and leaves ``evaluations.csv`` in the folder."""
    single_threaded()
    check(settings)
    folder.mkdir(parents=True, exist_ok=True)
    config = OmegaConf.to_container(settings.env)
    fleet = env.checked_config(config)
    algorithm, scale = load_algorithm_config_from_hydra(settings.algorithm), settings.reward_scale
    learned = settings.value_learning
    if hasattr(algorithm, "loss_function"):
        algorithm.loss_function, scale = learned.loss_function, learned.reward_scale
    task = FleetTask.FLEET.get_task({"env": config, "reward_scale": scale})
    learning = load_experiment_config_from_hydra(settings.experiment)
    learning.save_folder = str(folder)
    held_out = HeldOut(Config(env=fleet, seed=settings.seed), folder, settings.evaluate_every)
    experiment = Experiment(
        task=task,
        algorithm_config=algorithm,
        model_config=load_model_config_from_hydra(settings.model),
        critic_model_config=load_model_config_from_hydra(settings.critic_model),
        seed=settings.seed,
        config=learning,
        callbacks=[held_out],
    )
    experiment.run()
    return experiment


@hydra.main(version_base=None, config_path=".", config_name="benchmarl_fleet")
def main(settings: DictConfig) -> None:
    """Trains from the command line."""
    try:
        check(settings)
    except ValueError as error:
        raise SystemExit(str(error)) from error
    train(settings, Path(HydraConfig.get().runtime.output_dir))


if __name__ == "__main__":
    main()
