"""The clients' side: repeatable draws, and a state that outlives the process and the run."""

from __future__ import annotations

from collections.abc import Iterable
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np
from flwr.app import ConfigRecord, Context, Message, RecordDict
from flwr.clientapp import ClientApp
from flwr.clientapp.typing import ClientAppCallable, Mod

from repeatable.checkpoints import state_folder
from repeatable.isolation import seeded
from repeatable.partitions import KEY
from repeatable.records import digest, packed, unpacked
from storage.checkpoint_files import checkpoints, load_checkpoint, save_checkpoint

_PHASES = 2
"""Messages that a client gets in a round: to train, and to evaluate."""
_KEPT = 3 * _PHASES
"""States that are kept: the server may go back by two rounds."""
_ENTROPY: ContextVar[tuple[int, ...]] = ContextVar("entropy")


def client_app(mods: Iterable[Mod] = ()) -> ClientApp:
    """A ClientApp for a server's ``Repeatable``, to register functions with.

    Before each of its functions runs, global generators are seeded by seed, client and round, and
    ``context.state`` is what the client left in the last round before this one in which it took
    part. It is kept in the node's, else the run's, configured ``state-dir``, an absolute path;
    without one it lives as long as Flower keeps it.

    Args:
        mods: Flower's modifiers, to run within.
    """
    app = ClientApp(mods=[_repeatably, *mods])
    app.query(KEY)(_tell_partition)
    return app


def generator() -> np.random.Generator:
    """A fresh generator for the message in hand, the same in each run of the same seed.

    Raises:
        LookupError: it is called elsewhere than in a function of a ``client_app``.
    """
    return np.random.default_rng([*_ENTROPY.get(), 1])


def _repeatably(message: Message, context: Context, call: ClientAppCallable) -> Message:
    """The modifier."""
    if KEY not in message.content:  # another server's, or our question
        return call(message, context)
    order: Any = message.content.config_records[KEY]
    message.content = RecordDict({k: v for k, v in message.content.items() if k != KEY})
    partition, _ = _partition(context)
    folder = _folder(context, order["run"], partition)
    step = _PHASES * order["round"] + order["phase"]
    entropy = (order["seed"], 1 + partition, order["round"], order["phase"])
    before = _restore(folder, step, context) if folder else ""
    token = _ENTROPY.set(entropy)
    try:
        with seeded(*entropy):
            reply = call(message, context)
    finally:
        _ENTROPY.reset(token)
    if folder:
        _keep(folder, step, context, before)
    return reply


def _tell_partition(message: Message, context: Context) -> Message:
    partition, count = _partition(context)
    answer = ConfigRecord({"partition": partition, "count": count})
    return Message(RecordDict({KEY: answer}), reply_to=message)


def _partition(context: Context) -> tuple[int, int]:
    """A client's partition, and how many there are."""
    try:
        found = (context.node_config[name] for name in ("partition-id", "num-partitions"))
        partition, count = (int(number) for number in found)
    except KeyError as missing:
        raise ValueError(
            f"a node without {missing}: start SuperNodes with"
            " --node-config 'partition-id=0 num-partitions=3'"
        ) from None
    return partition, count


# --- State ----------------------------------------------------------------------------------------


def _folder(context: Context, run: str, partition: int) -> Path | None:
    place = context.node_config.get("state-dir") or context.run_config.get("state-dir")
    folder = state_folder(None if place is None else str(place))
    return folder and folder / "clients" / run / str(partition)


def _restore(folder: Path, step: int, context: Context) -> str:
    """Gives a client the state of the last step before this one; returns the state's digest."""
    earlier = [each for each in checkpoints(folder) if each < step]
    context.state.clear()
    if earlier:
        arrays, meta = load_checkpoint(folder, earlier[-1])
        context.state.update(unpacked(arrays, meta["records"]))
    return _fingerprint(context.state)


def _keep(folder: Path, step: int, context: Context, before: str) -> None:
    """Writes a client's state, unless it is what it was."""
    if _fingerprint(context.state) != before:
        arrays, described = packed(context.state)
        save_checkpoint(folder, step, arrays, {"records": described}, _KEPT)


def _fingerprint(state: RecordDict) -> str:
    arrays, described = packed(state)
    return f"{digest(arrays)} {described}"
