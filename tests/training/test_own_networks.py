"""Whole runs in which robots hold networks that differ: the same bits however they are played."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from exchange_helpers import in_process, over_sockets
from resume_helpers import check_goes_on

from conf import Config, robot_network
from experiments.cli import main
from training.exchange.own_parts import shared_numbers
from training.run_folder import RunFolder

BLOCKS = [(0, 2), (1,)]
KINDS = {
    "heads": {"federation.own": "heads"},
    "normalisation": {"federation.own": "normalisation"},
    "input": {"federation.own": "input"},
    "gossip": {"strategy.name": "gossip", "strategy.graph": "random"},
}
RESUMED = {
    "heads": ["federation.own=heads"],
    "normalisation": ["federation.own=normalisation"],
    "gossip": ["strategy=gossip", "strategy.graph=random"],
    "visits": ["strategy=visits"],
}


@pytest.mark.parametrize("kind", KINDS)
def test_own_networks_are_the_same_bits_over_the_link_as_within_a_process(
    tiny: Callable[..., Config], kind: str
) -> None:
    config = tiny({**KINDS[kind], "train.max_ticks": 50})
    here, there = in_process(config), over_sockets(config, BLOCKS)
    assert here.tobytes() == there.tobytes()
    assert not (here[0] == here[1]).all()


def test_robots_differ_in_their_own_layers_alone(tiny: Callable[..., Config]) -> None:
    config = tiny({"federation.own": "heads", "train.max_ticks": 50})
    robots = in_process(config)
    shared = shared_numbers(robot_network(config), "heads")
    assert (robots[:, :, shared] == robots[0][:, shared]).all()
    assert (robots[0][0, ~shared] != robots[1][0, ~shared]).any()


@pytest.mark.parametrize("kind", RESUMED)
def test_a_run_that_died_ends_in_the_same_bits_and_can_be_played(
    kind: str, tiny_overrides: tuple[str, ...], tmp_path: Path
) -> None:
    folder = RunFolder(tmp_path / "whole")
    given = [*tiny_overrides, *RESUMED[kind], "train.max_ticks=70", "state.every=3"]
    assert main(["train", *given, f"run.dir={folder}"]) == 0
    check_goes_on(folder.path, 3)
    robots, _ = folder.read_networks(folder.read_config())
    assert (robots[0] == robots[1]).all() == (kind == "visits")
    assert main(["evaluate", str(folder), "--episodes", "2"]) == 0
