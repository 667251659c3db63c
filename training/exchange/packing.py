"""Weights in fewer bytes: differences from what the receiver holds, packed, with error feedback.

What packing loses of a difference is added to the next one (Seide et al., 2014; Karimireddy et al.,
2019, arXiv:1901.09847), on either side: of their uploads by robots, and of the model by the server.
A robot does not learn whether it was heard: what an upload held that was lost, is lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from conf import Config, robot_network
from training.exchange.own_parts import shared_numbers
from training.exchange.packers import Bytes, Packer, Weights, build_packer

NUMBER = 4
"""Bytes of a float32."""

NETWORKS = 2
"""Online and target."""


class Packing:
    """How a pair of networks is packed: as a difference, of both or of the online ones alone.

    Args:
        packer: of the numbers that are sent.
        parameters: P.
        targets: whether target networks are sent; without, receivers copy the online ones.
    """

    def __init__(self, packer: Packer, parameters: int, *, targets: bool) -> None:
        self.packer, self.targets, self.size = packer, targets, packer.size
        self.numbers = (2 if targets else 1) * parameters

    def difference(self, given: Weights, weights: Weights) -> Weights:
        """What is to be sent of weights whose receiver holds ``given``, shape (numbers,)."""
        return (weights - given).ravel()[: self.numbers]

    def added(self, given: Weights, packed: Bytes) -> Weights:
        """What a receiver that holds ``given`` has then, both of shape (2, P).

        Raises:
            ValueError: no packer makes such bytes. Numbers may still be absurd, or not finite.
        """
        rows = given if self.targets else given[:1]
        with np.errstate(over="ignore", invalid="ignore"):
            found = rows + self.packer.unpack(packed).reshape(rows.shape)
        return np.ascontiguousarray(np.broadcast_to(found, given.shape), np.float32)


class PackedSender:
    """Sends networks packed and remembers what was lost on the way."""

    def __init__(self, packing: Packing) -> None:
        self._packing = packing
        self._lost: Weights = np.zeros(packing.numbers, np.float32)

    def send(self, given: Weights, weights: Weights) -> Bytes:
        """Packs weights for a receiver that holds ``given``, both of shape (2, P)."""
        wanted = self._packing.difference(given, weights) + self._lost
        packed = self._packing.packer.pack(wanted)
        self._lost = wanted - self._packing.packer.unpack(packed)
        return packed

    def state(self) -> dict[str, NDArray[Any]]:
        """What was lost so far."""
        return {"lost": self._lost}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes back what ``state`` gave; nothing is a fresh sender."""
        lost = state.get("lost")
        self._lost = np.zeros_like(self._lost) if lost is None else np.array(lost, np.float32)


def packing(config: Config, parameters: int) -> tuple[Packing | None, Packing | None]:
    """How networks of P parameters are packed, up and down; None: they are sent as they are."""
    chosen = config.federation.compression
    targets = chosen.targets == "averaged"
    layers = robot_network(config).layers  # a block for the weights of each, and one for its biases
    blocks = [count for ins, outs in layers for count in (ins * outs, outs)] * (1 + targets)
    up, down = (
        Packing(build_packer(kind, chosen.keep, blocks), parameters, targets=targets)
        if kind != "none" or not targets
        else None
        for kind in (chosen.up, chosen.down)
    )
    return up, down


def payload_bytes(config: Config) -> tuple[int, int]:
    """Bytes of what one robot sends at a window's end, and of what it is given."""
    network = robot_network(config)
    plain = NETWORKS * NUMBER * int(shared_numbers(network, config.federation.own).sum())
    up, down = packing(config, network.parameters)
    return up.size if up else plain, down.size if down else plain
