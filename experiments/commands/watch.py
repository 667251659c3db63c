"""``risfleet watch``: a page on this machine that follows a run, going on or ended."""

from __future__ import annotations

import argparse
import webbrowser
from collections.abc import Sequence

from rich.console import Console

from agent import single_threaded
from conf import ConfigError
from conf.user_paths import user_path
from experiments.console.arguments import port
from experiments.viewer.follower import Follower
from experiments.viewer.server import HOST, WatchServer
from training.run_folder import RunFolder


def main(arguments: Sequence[str]) -> int:
    """Runs the command until Ctrl-C; returns the exit status."""
    given = _parser().parse_args(arguments)
    follower = Follower(RunFolder(user_path(given.run)))
    try:
        server = WatchServer(follower, given.port)
    except OSError as error:
        allowed = f"one that is free on {HOST}, or 0 for any"
        say = f"--port {given.port}: allowed is {allowed} ({error.strerror})."
        raise ConfigError(say) from error
    single_threaded()
    with server:
        console = Console()
        console.print(f"{follower.folder}: {server.url}  (Ctrl-C ends)", soft_wrap=True)
        if given.open:
            webbrowser.open_new_tab(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            console.print("ended; the run goes on if it was going on", highlight=False)
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet watch", description=__doc__)
    parser.add_argument("run", metavar="RUN", help="the folder of a run that has begun")
    say = f"to listen on at {HOST}; any free one by default"
    parser.add_argument("--port", type=port, default=0, help=say)
    parser.add_argument("--open", action="store_true", help="open the page in the browser")
    return parser
