"""The ServerApp: hosts the world, the access point's agent and the coordinator of a run."""

from __future__ import annotations

import dataclasses
import shlex
import time
from pathlib import Path

from flwr.app import Context
from flwr.serverapp import Grid, ServerApp

from conf import Config, ConfigError, fingerprint, flower_clients, has_rooms
from lockstep import LinkServer
from lockstep.tls import server_context
from server_app.buildings import train_building
from server_app.certificates import run_certificate
from server_app.clients import Clients
from server_app.nodes import RoundError, wait_for_nodes
from server_app.recovery import RecoveringTrainer
from training import resume
from training.addresses import check_address, uses_tls
from training.checkpoint import Checkpoint
from training.engine_limits import default_concurrency
from training.partition import step_layout
from training.preflight import check_trackers, checked, checked_yaml
from training.run_folder import RunFolder

NODES_PATIENCE_S = 2.0

app = ServerApp()


@app.main()
def main(grid: Grid, context: Context) -> None:
    """Runs one training run on the clients that the federation has."""
    given = shlex.split(str(context.run_config.get("overrides", "")))
    config, resumed = _asked(given)
    place = Path(config.run.dir or f"runs/{time.strftime('%Y-%m-%d_%H-%M-%S')}")
    folder = RunFolder(place.absolute())
    if resumed is None and folder.metrics_file.exists():
        raise ConfigError.of([("run.dir", folder, "a folder that holds no run yet")])
    print(f"run folder: {folder}", flush=True)
    try:
        _train(grid, config, folder, resumed)
    except Exception as error:
        folder.report_failure(error)
        raise


def _train(grid: Grid, config: Config, folder: RunFolder, resumed: Checkpoint | None) -> None:
    """Deals the robots, or the rooms, to the federation's nodes and trains with them."""
    config = resume.identified(config, folder.path)
    if has_rooms(config):
        try:
            wait_for_nodes(grid, flower_clients(config), config.runtime.start_timeout_s)
        except RoundError:
            if config.federation.on_loss != "miss":
                raise
        return train_building(grid, config, folder, resumed)
    check_address(config)
    where = config.federation.link
    certificate, key = run_certificate(where.host) if uses_tls(config) else ("", "")
    link = LinkServer(
        where.host,
        where.port,
        fingerprint=fingerprint(config.env),
        timeout_s=where.timeout_s,
        server_context=server_context(certificate, key) if certificate else None,
        layout=step_layout(config),
    )
    try:
        nodes = _nodes(grid, config)
        federation = dataclasses.replace(config.federation, clients=len(nodes))
        config = dataclasses.replace(config, federation=federation)
        clients = Clients(config, grid, link, nodes, certificate)
        RecoveringTrainer(config, folder, link, clients).train(resumed)
    finally:
        link.close("the run has ended")


def _asked(given: list[str]) -> tuple[Config, Checkpoint | None]:
    """The run that is asked for, and where it goes on, if it does not begin.

    It is given as Hydra overrides, as a whole configuration in YAML, or as ``resume=RUN``. The
    runtime is Flower's, whatever ``config.yaml`` has as its default.
    """
    resumed = None
    if resume.asked(given):
        config, resumed = resume.read(given)
    elif len(given) == 1 and "\n" in given[0]:
        config = checked_yaml(given[0])
    else:
        config = checked(["runtime=simulation", *given])
    if config.runtime.name == "local":
        raise ConfigError("runtime=local: allowed on Flower are simulation and deployment.")
    check_trackers(config)
    return config, resumed


def _nodes(grid: Grid, config: Config) -> list[int]:
    """The nodes to use: as many as ``federation.clients`` says, else what the federation can run.

    A federation's nodes join one after the other, so those there after a short patience count, at
    most one a robot, and no more than Flower's engine runs at once by its own default.
    """
    wanted = config.federation.clients
    if wanted is None and config.runtime.name == "deployment":
        wanted = config.env.robots
    if wanted is not None:
        return wait_for_nodes(grid, wanted, config.runtime.start_timeout_s)
    most = min(config.env.robots, default_concurrency())
    wait_for_nodes(grid, 1, config.runtime.start_timeout_s)
    deadline = time.monotonic() + NODES_PATIENCE_S
    while time.monotonic() < deadline and len(list(grid.get_node_ids())) < most:
        time.sleep(0.1)
    return sorted(grid.get_node_ids())[:most]
