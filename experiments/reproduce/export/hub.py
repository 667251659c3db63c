"""``python -m experiments.reproduce.export.hub``: weights as Hugging Face's hub reads them.

Each folder of weights gets a card of its own, since there a folder is a repository, and the card of
all gets the same front matter: licence, library, tags, and a ``model-index`` with what the final
weights came to, as their ``summary.json`` has it. Weights that were written before they could
describe themselves are written anew, arrays unchanged.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml  # type: ignore[import-untyped]

from conf import ConfigError, ap_network, robot_network
from conf.user_paths import user_path
from experiments.console.mishaps import in_words
from experiments.reproduce.results.runs import Run
from storage.atomic import write_atomically
from storage.checkpoint_files import digest
from training.weights_metadata import widths

CARD = "README.md"
FRONT = re.compile(r"\A---\n.*?\n---\n+", re.DOTALL)
COMMON = {
    "license": "apache-2.0",
    "library_name": "risfleet",
    "pipeline_tag": "reinforcement-learning",
    "tags": [
        "reinforcement-learning",
        "deep-reinforcement-learning",
        "multi-agent",
        "federated-learning",
        "flower",
        "robotics",
        "reconfigurable-intelligent-surface",
        "noma",
    ],
}
MEASURES = {
    "success": "share of robots that arrive",
    "path_ratio": "slots driven over the shortest length",
    "ee": "energy efficiency (5a), bit/s/Hz/J",
    "sum_rate": "sum rate, bit/s/Hz",
}
PLAYED = {"greedy": "greedy", "eps05": "5 % random moves"}

BODY = """# RISFleet weights: {name}

Policies of {robots} robots and of their access point, trained by federated deep reinforcement
learning for {trained_for} that a reconfigurable intelligent surface lights up;
`{files.config_file.name}` says how.

```sh
risfleet evaluate {files.weights_file.name}    # plays them, with RISFleet installed
risfleet oracle {files.weights_file.name}      # beside the best that is known
```

| measure, final weights, {starts} | greedy | 5 % random moves |
|---|---|---|
{measures}

The file describes itself: its `__metadata__` holds the sizes of the layers, digests of the weights
and the whole configuration, so `risfleet evaluate` needs no other file.

| network | layers | in the file |
|---|---|---|
| of a robot | {robots_network} | `robots`, shape (K, 2, P): online, target |
| of the access point | {ap_network} | `ap`, shape (2, P_AP): online, target |

A network is a flat row of float32: of each layer the weights, inputs by outputs, row by row, and
the bias as one more row; ReLU between layers.

They are for simulated robots. {limits}

How they were trained and what their limits are says the card of all weights in RISFleet's
`results/weights`. Licence: Apache-2.0.
"""


ONE_ROOM = {
    "trained_for": "a floor",
    "starts": "{} held-out starts",
    "limits": "Held-out means other starts on the floor, radio map and\ndestinations that they were"
    " trained for, nothing more.",
}
BUILDING = {
    "trained_for": "the rooms of a building",
    "starts": "{} starts in each held-out room",
    "limits": "Held-out rooms are further floors that were drawn as\nthose of the building were.",
}


class Weights(Run):
    """A folder of weights."""

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.folder.name

    @property
    def of_building(self) -> bool:
        """Whether measures are means over held-out rooms: those are of the final weights alone."""
        return "last5" not in self.summary["evaluation"]

    def describe(self) -> None:
        """Writes the file anew, with what it says of itself.

        Raises:
            ConfigError: its arrays are not those that the summary names.
        """
        robots, ap = self.files.read_networks(self.config)
        if {"robots": digest(robots), "ap": digest(ap)} != self.summary["digest"]:
            summary = self.files.summary_file.name
            raise ConfigError(f"{self.files.weights_file}: they are not those of {summary}.")
        self.files.write_weights(robots, ap, self.config)

    def result(self) -> dict[str, Any]:
        """An entry of ``results`` in a ``model-index``."""
        env, seed = self.config.env, self.summary["seed"]
        where = f"floor plan {env.plan}, map seed {env.map_seed}, seed {seed}, held-out starts"
        if self.of_building:
            where = f"held-out rooms of a building, seed {seed}"
        return {
            "task": {"type": "reinforcement-learning", "name": "reinforcement-learning"},
            "dataset": {
                "type": "risfleet",
                "name": f"RISFleet: {env.robots} robots, {where}",
                "config": self.name,
            },
            "metrics": [
                {"type": measure, "name": f"{name}, {how}", "value": value}
                for kind, how in PLAYED.items()
                for measure, name in MEASURES.items()
                if (value := self.summary["evaluation"][kind][measure]) is not None
            ],
        }

    def card(self) -> str:
        """The folder's card."""
        config, kind = self.config, BUILDING if self.of_building else ONE_ROOM
        return front_matter(f"risfleet-{self.name}", [self]) + BODY.format(
            **{**kind, "starts": kind["starts"].format(config.evaluation.episodes)},
            name=self.name,
            robots=config.env.robots,
            files=self.files,
            measures="\n".join(map(self._row, MEASURES)),
            robots_network=widths(robot_network(config)),
            ap_network=widths(ap_network(config)),
        )

    def _row(self, measure: str) -> str:
        values = (self.summary["evaluation"][kind][measure] for kind in PLAYED)
        cells = ["-" if value is None else f"{value:.4f}" for value in values]
        return f"| {MEASURES[measure]} | {' | '.join(cells)} |"


def front_matter(model: str, weights: Sequence[Weights]) -> str:
    """A card's front matter: YAML between two lines of dashes, and a blank line."""
    index = [{"name": model, "results": [each.result() for each in weights]}]
    text = yaml.safe_dump(
        {**COMMON, "model-index": index}, sort_keys=False, allow_unicode=True, width=100
    )
    return f"---\n{text}---\n\n"


def dress(folder: Path) -> list[Path]:
    """Brings a folder with a card and folders of weights into the hub's form; returns its files.

    Raises:
        ConfigError: there are no weights, or a file is damaged.
    """
    found = [Weights(path) for path in sorted(folder.iterdir()) if Weights(path).files.has_ended]
    if not found:
        raise ConfigError(f"{folder}: allowed is a folder with folders of weights.")
    written = [folder / CARD]
    body = FRONT.sub("", written[0].read_text(encoding="utf-8"))
    for weights in found:
        weights.describe()
        write_atomically(weights.folder / CARD, weights.card())
        written += [weights.files.weights_file, weights.folder / CARD]
    write_atomically(written[0], front_matter("risfleet", found) + body)
    return written


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns the exit status."""
    parser = argparse.ArgumentParser("experiments.reproduce.export.hub", description=__doc__)
    parser.add_argument("folder", type=user_path, metavar="WEIGHTS", help="such as results/weights")
    folder = parser.parse_args(arguments).folder
    try:
        files = dress(folder)
    except (ConfigError, OSError) as error:
        print(f"export: {in_words(error)}", file=sys.stderr)
        return 2
    print(f"{len(files)} files in {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
