"""Runs of a whole exchange of weights, in one process and over sockets."""

import threading
from contextlib import suppress

from client_app.robots import RobotGroup
from client_app.state import CheckpointedRobots
from conf import robot_network
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World
from lockstep import Expect, InProcessFleet, LinkServer, ServerLost, serve
from training.controllers.access_point import AccessPoint
from training.coordinator import Coordinator
from training.exchange.federation import build_federation
from training.partition import step_layout


class Silent:
    """An observer that lets everything pass."""

    def on_start(self):
        """See ``Observer``."""

    def on_episode(self, progress, measures):
        """See ``Observer``."""

    def on_window(self, progress, robots, ap):
        """See ``Observer``."""


class UploadingFleet:
    """The fleet of a real link; the run's last weights are uploaded like all others."""

    def __init__(self, link):
        self.actions, self.upload, self.download = link.actions, link.upload, link.download
        self._link = link

    def send_step(self, tick, window, expect, updates):
        asked = Expect.WEIGHTS if expect is Expect.END_ROUND else expect
        self._link.send_step(tick, window, asked, updates)


def initial(config):
    return robot_network(config).initial_pair(stream(config.seed, Stream.WEIGHTS))


def end_of(config, fleet):
    """The robots' final weights of a run with this fleet, shape (K, 2, P)."""
    world = World(Scenario.drawn(config.env, config.seed), stream(config.seed, Stream.WORLD))
    ap, federation = AccessPoint(config), build_federation(config)
    return Coordinator(config, world, ap, fleet, federation, Silent()).run(initial(config))


def in_process(config, blocks=((0, 1, 2),)):
    """The weights of a run whose robots are grouped so, within this process."""
    groups = [(block, RobotGroup(config, block)) for block in blocks]
    for _, group in groups:
        group.download(0, initial(config))
    return end_of(config, InProcessFleet(groups, step_layout(config)))


def over_sockets(config, blocks):
    """The weights of a run whose robots are behind sockets, each block on a thread of its own."""
    layout, parameters = step_layout(config), robot_network(config).parameters
    link = LinkServer("127.0.0.1", 0, fingerprint="test", timeout_s=20, layout=layout)

    def client(block):
        robots = CheckpointedRobots(config, block, None)
        options = {"fingerprint": "test", "timeout_s": 20.0, "n_parameters": parameters}
        with suppress(ServerLost):  # the run is over
            serve(link.address, block, [f"{k}" for k in block], robots, layout=layout, **options)

    threads = [threading.Thread(target=client, args=(block,)) for block in blocks]
    try:
        link.admit(blocks, {robot: f"{robot}" for block in blocks for robot in block},
                   (2, parameters))  # fmt: skip
        for thread in threads:
            thread.start()
        link.wait_connected(20)
        link.begin(0, initial(config))
        found = end_of(config, UploadingFleet(link))
    finally:
        link.close()
    for thread in threads:
        thread.join(60)
        assert not thread.is_alive()
    return found
