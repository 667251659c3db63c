"""``risfleet keys``: makes the certificates and keys that a secured Flower fleet needs.

Flower knows its SuperLink by a certificate of the fleet's own authority, and each SuperNode by a
key that is registered with the SuperLink. Nothing here belongs to a run: the link between the
robots and the world makes a certificate for itself whenever a run starts.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from shlex import join

from conf import ConfigError
from conf.user_paths import user_path
from experiments.flower.keys import FleetKeys, NodeKeys, add_nodes, make_keys

PORT = 8000
"""The SuperLink's default."""


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_args(arguments)
    folder = user_path(given.folder)
    if given.add is not None and (given.host or given.nodes is not None):
        raise ConfigError("--add goes with neither --host nor --nodes.")
    if given.add is None and not given.host:
        raise ConfigError("--host is missing: where do the SuperNodes find the SuperLink?")
    if given.add is None and given.nodes is None:
        raise ConfigError("--nodes is missing: how many SuperNodes are there?")
    try:
        if given.add is not None:
            print(_next_steps(FleetKeys(folder), add_nodes(folder, given.add)))
        else:
            keys = make_keys(folder, given.host, given.nodes)
            print(_first_steps(keys))
            print(_next_steps(keys, keys.nodes))
    except OSError as error:
        raise ConfigError(f"{folder} cannot be written: {error.strerror or error}.") from error
    return 0


def _first_steps(keys: FleetKeys) -> str:
    """What to do on the SuperLink's host, and how `flwr` finds it."""
    host = keys.hosts[0]
    superlink = [
        "flower-superlink", "--host", host, "--port", str(PORT), *keys.options(),
        "--disable-runtime-dependency-installation",
    ]  # fmt: skip
    return f"""\
The keys of a fleet of {len(keys.nodes)} are in {keys.folder}. Keep ca.key off every host, and copy
a SuperNode's folder to its own host only.

# On the SuperLink's host:
{join(superlink)}

# In the file config.toml in ~/.flwr of whoever starts runs:
[superlink.risfleet]
address = "{_address(host)}"
root-certificates = {json.dumps(str(keys.authority.resolve()), ensure_ascii=False)}
"""


def _next_steps(keys: FleetKeys, nodes: Sequence[NodeKeys]) -> str:
    """How to register SuperNodes and to start them."""
    superlink, total = _address(keys.hosts[0]), len(keys.nodes)
    lines = ["# Register each SuperNode, once:"]
    lines += [join(["flwr", "supernode", "register", str(n.public), "risfleet"]) for n in nodes]
    for node in nodes:
        place = f"partition-id={node.number} num-partitions={total}"
        command = ["flower-supernode", "--superlink", superlink, *node.options()]
        command += ["--node-config", place]
        lines += ["", f"# On the host of {node.folder.name}:", join(command)]
    return "\n".join(lines)


def _address(host: str) -> str:
    return f"[{host}]:{PORT}" if ":" in host else f"{host}:{PORT}"


def _parser() -> argparse.ArgumentParser:
    say = "Makes the certificates and keys of a secured Flower fleet."
    parser = argparse.ArgumentParser("risfleet keys", description=say)
    parser.add_argument("folder", metavar="DIR", help="folder to make; nothing is overwritten")
    say = "where the SuperNodes find the SuperLink; may be given again"
    parser.add_argument("--host", action="append", default=[], metavar="NAME_OR_IP", help=say)
    parser.add_argument("--nodes", type=int, metavar="N", help="number of SuperNodes")
    parser.add_argument("--add", type=int, metavar="N", help="adds SuperNodes to a fleet in DIR")
    return parser
