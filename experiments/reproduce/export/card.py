"""The model card of the weights in ``results/weights``."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from textwrap import fill

import numpy as np

from conf import ap_network, robot_network
from experiments.reproduce.results.runs import Run
from training.recording.summary import LAST_EVALUATIONS
from training.weights_metadata import widths

WIDTH = 100
"""Of a line of the card."""

TEXT = """# Weights

{opening}

```sh
.venv/bin/risfleet evaluate results/weights/{first}
.venv/bin/risfleet oracle results/weights/{first}      # beside the best that is known
```

## What there is

| folder | robots | seed | episodes | trained by |
|---|---|---|---|---|
{what}

Where several seeds of a configuration were run, the weights are those of the first, not of the
best. They are those after the run's last aggregation: no checkpoint was selected.

## How well they play

Success is the share of robots that arrive, with 5 % random moves and without; the path ratio is
slots driven over the shortest length; EE is in bit/s/Hz/J. Means over the last five evaluations in
training, or of the final weights where there were fewer, from held-out starts; in brackets the
least and the largest of all seeds of the same configuration.

| folder | seeds | success, eps = .05 | success, greedy | path ratio | EE |
|---|---|---|---|---|---|
{how_well}

## Limits

- They were trained for one floor plan, one radio map and the destinations of their seed, which
  `{files.config_file.name}` names. Held-out means other starts, nothing more. For anything else,
  train anew: that takes seconds to minutes. Weights of a building were trained on as many floors
  as it has rooms ([buildings](../../docs/building.md)): `{files.config_file.name}` names a room
  that is not among them, and their numbers are means over all rooms held out.
- A greedy policy may step back and forth between two cells for ever; a few random moves free it.
- The world is a model ([assumptions](../../docs/assumptions.md)): channels are simulated, and no
  real robot was driven with these weights, nor is one meant to be.

## Files

| file | holds |
|---|---|
| `{files.weights_file.name}` | float32: `robots`, shape (K, 2, P), and `ap`, shape (2, P_AP) |
| `{files.config_file.name}` | the whole configuration of the run |
| `{files.summary_file.name}` | versions, digests of the weights, what the run came to |

The file of weights is enough by itself: its `__metadata__` holds format, version, layers, digests,
overrides and the whole configuration, so `risfleet evaluate` plays it without the others. In Python
it is

```python
from safetensors import safe_open

with safe_open("results/weights/{first}/{files.weights_file.name}", framework="np") as file:
    print(file.metadata()["robots_network"], file.metadata()["overrides"])
    robots = file.get_tensor("robots")[:, 0]  # online networks, shape (K, P)
```

Each folder also has a card for a repository of its own on Hugging Face's hub, whose front matter
holds what the final weights alone came to, from `{files.summary_file.name}`.

Of two networks the first is the online one, which plays, and the second the target. A network is a
flat row: of each layer the weights, inputs by outputs, row by row, and the bias as one more row;
ReLU between layers.

| folder | robots' network | P | access point's network | P_AP |
|---|---|---|---|---|
{sizes}

How they were trained and measured: [reproduction](../../docs/reproduction.md). Licence: that of the
repository, Apache-2.0.
"""


@dataclass(frozen=True)
class Player:
    """A run whose weights are kept.

    Attributes:
        name: of its folder.
        overrides: of its cell; none if it is not a target's.
        seeds: all runs of its configuration, itself the first.
    """

    name: str
    overrides: Sequence[str]
    seeds: Sequence[Run]

    @property
    def run(self) -> Run:
        """The first."""
        return self.seeds[0]


def card(players: Sequence[Player]) -> str:
    """The card of the weights of at least one run, numbers included."""
    return TEXT.format(
        opening=_opening(players),
        files=players[0].run.files,
        first=players[0].name,
        what="\n".join(map(_what, players)),
        how_well="\n".join(map(_how_well, players)),
        sizes="\n".join(map(_sizes, players)),
    )


OPENING = (
    "Policies that are ready to be played: of robots, which pick their {own}, and of the access"
    " point, which sets the phase of the reconfigurable intelligent surface."
)
PICKS = {
    "robots": "by the robots themselves",
    "ap": "by the access point's policy, with the phase",
    "search": "by the access point, which searches them in each slot",
}
"""Who picks the powers, by ``scheme.power``."""


def _opening(players: Sequence[Player]) -> str:
    """What the policies decide; who picks the powers, where it is not the robots alone."""
    names: dict[str, list[str]] = {}
    for player in players:
        names.setdefault(player.run.config.scheme.power, []).append(player.name)
    if list(names) == ["robots"]:
        text = OPENING.format(own="moves and powers")
    else:
        told = [f"{PICKS[who]} ({', '.join(of)})" for who, of in names.items()]
        text = f"{OPENING.format(own='moves')} Powers are picked {', or '.join(told)}."
    return fill(text, WIDTH)


def _row(cells: Iterable[object]) -> str:
    return f"| {' | '.join(map(str, cells))} |"


def _what(player: Player) -> str:
    run = player.run
    own = f"its `{run.files.config_file.name}`"
    how = f"`{' '.join(player.overrides)}`" if player.overrides else own
    return _row(
        (player.name, run.config.env.robots, run.summary["seed"], run.summary["episodes"], how)
    )


def _how_well(player: Player) -> str:
    explored, greedy = _evaluations(player.run)
    cells = []
    for evaluation, measure, form in (
        (explored, "success", ".2f"),
        (greedy, "success", ".2f"),
        (explored, "path_ratio", ".3f"),
        (explored, "ee", ".4f"),
    ):
        values = [run.summary["evaluation"][evaluation][measure] for run in player.seeds]
        cells.append(_spread(values, form))
    return _row((player.name, len(player.seeds), *cells))


def _evaluations(run: Run) -> tuple[str, str]:
    """Which evaluations of a summary count, with exploration and greedy."""
    few = len(run.evaluations()["episode"]) < LAST_EVALUATIONS
    return ("eps05", "greedy") if few else ("last5", "last5_greedy")


def _spread(values: Sequence[float | None], form: str) -> str:
    """The first value, and the least and largest of all; a path ratio is None if nobody arrives."""
    if values[0] is None:
        return "-"
    known = [value for value in values if value is not None]
    return f"{values[0]:{form}} ({np.min(known):{form}} to {np.max(known):{form}})"


def _sizes(player: Player) -> str:
    networks = robot_network(player.run.config), ap_network(player.run.config)
    sizes = ((widths(network), f"{network.parameters:,}") for network in networks)
    return _row((player.name, *chain(*sizes)))
