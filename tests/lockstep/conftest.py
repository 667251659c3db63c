"""A server for each test, and nothing left of it afterwards."""

import threading

import pytest
from link_helpers import PATIENCE_S, SHAPE, Client, RawClient, Recorder, token

from lockstep.server import LinkServer


class Link:
    """A server with its clients, all closed when the test ends."""

    def __init__(self, **options):
        self.options = {"fingerprint": "v1", "timeout_s": PATIENCE_S} | options
        self.server = LinkServer(**self.options)
        self.opened = []

    def admit(self, *blocks):
        self.blocks = blocks
        tokens = {robot: token(robot) for block in blocks for robot in block}
        self.server.admit(blocks, tokens, SHAPE)
        return self.server

    def client(self, block, fail_at=None, **changes):
        same = {"layout": self.options["layout"]} if "layout" in self.options else {}
        client = Client(self.server, Recorder(block, fail_at), **same | changes)
        self.opened.append(client.join)
        return client

    def raw(self):
        raw = RawClient(self.server)
        self.opened.append(raw.close)
        return raw

    def connected(self, *blocks, fail_at=None):
        """All blocks admitted, with a client each, and connected."""
        self.admit(*blocks)
        clients = [self.client(block, fail_at if block == blocks[0] else None) for block in blocks]
        self.server.wait_connected(PATIENCE_S)
        return clients

    def close(self):
        self.server.close()
        for end in self.opened:
            end()


@pytest.fixture
def in_a_hurry(monkeypatch):
    """Clients do not wait for a server that has nothing more to say."""
    monkeypatch.setattr("lockstep.client.LINGER_S", 0.05)


@pytest.fixture
def make_link():
    before = set(threading.enumerate())
    links = []

    def make(**options):
        links.append(Link(**options))
        return links[-1]

    yield make
    for link in links:
        link.close()
    assert set(threading.enumerate()) == before


@pytest.fixture
def link(make_link):
    return make_link()
