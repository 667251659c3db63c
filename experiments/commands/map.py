"""``risfleet map``: what the RIS gains on a radio map, without training."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from agent import single_threaded
from conf import ConfigError
from conf.user_paths import user_path
from env.config import EnvConfig
from env.geometry.floor import Floor
from env.radio.channel_file import write_channels
from env.radio.codebook import Panel, factors
from env.radio.propagation import phase_settings, phases
from env.radio.radio_map import RadioMap, build_radio_map
from env.rendering.drawing import best_gain_db, draw_floor
from env.seeding import Stream, stream
from experiments.console.arguments import check_place
from experiments.console.display import table
from storage.atomic import write_atomically
from storage.strict_json import to_json
from training.preflight import checked

DRAWS = 16
"""Draws of a random phase for each element."""

Gains = dict[str, NDArray[np.float64]]
"""From a way of setting the phases to its gain over no RIS in dB, shape (cells,)."""


def main(arguments: Sequence[str]) -> int:
    """Runs the command; returns the exit status."""
    given = _parser().parse_intermixed_args(arguments)
    config = checked(given.overrides).env
    check_place("--json", given.json)
    for option, file, ending in (
        ("--out", given.out, ".png"),
        ("--channels", given.channels, ".npz"),
    ):
        check_place(option, file)
        if file and file.suffix != ending:
            raise ConfigError(f"{option} {file}: allowed is a file that ends in {ending}.")
    if given.channels and config.ris.action == "codebook":
        say = "phases with --channels: a file holds channels of sub-surfaces, and not of beams"
        raise ConfigError.of([("env.ris.action", config.ris.action, say)])
    single_threaded()
    radio_map = build_radio_map(config)
    gains, reached = gains_db(config, radio_map), Floor.from_config(config).drivable()
    measures = means(gains, radio_map.direct_los, reached)
    Console().print(_table(config, measures))
    if given.json:
        write_atomically(given.json, to_json(measures))
    if given.out:
        map_figure(config, radio_map).savefig(given.out, dpi=120)
    if given.channels:
        write_channels(given.channels, config, radio_map.direct, radio_map.reflected)
    return 0


def gains_db(config: EnvConfig, radio_map: RadioMap) -> Gains:
    """What each way of setting the phases gains over no RIS.

    Returns:
        Gains in dB: of the best phase that all elements share (the paper's N = 1); of a random
        phase for each element, the mean over ``DRAWS`` draws; of the configured actions, the best;
        and the bound |hbar| + M |h| |g| of continuous phases. The response ``rayleigh`` and a file
        of channels have no elements to set, and so neither random phases nor a bound.
    """
    ris = config.ris
    direct_db = 20.0 * np.log10(np.abs(radio_map.direct))
    gains = {"one phase for all (N = 1)": best_gain_db(_mirror(config, radio_map)) - direct_db}
    has_elements = ris.response != "rayleigh" and config.channel.model != "file"
    if has_elements:
        each = _one_element(config)
        gains["random phases"] = _random_db(config, radio_map, each) - direct_db
    if ris.action == "codebook" or ris.subsurfaces > 1:
        name = "beams of the codebook" if ris.action == "codebook" else "phase settings"
        gains[f"{len(radio_map.settings)} {name}"] = best_gain_db(radio_map) - direct_db
    if has_elements:
        bound = np.abs(radio_map.direct) + ris.side**2 * np.abs(each)
        gains["continuous phases, a bound"] = 20.0 * np.log10(bound) - direct_db
    return gains


def _mirror(config: EnvConfig, radio_map: RadioMap) -> RadioMap:
    """The map of a surface whose elements all share a phase."""
    if config.channel.model == "file":  # which holds the channels of one N alone
        together = radio_map.reflected.sum(axis=1, keepdims=True)
        settings = phase_settings(config.ris.bits, 1)
        return dataclasses.replace(radio_map, reflected=together, settings=settings)
    common = dataclasses.replace(config.ris, action="phases", subsurfaces=1)
    return build_radio_map(dataclasses.replace(config, ris=common))


def _one_element(config: EnvConfig) -> NDArray[np.complex128]:
    """H g of the panel's centre at each cell, shape (cells,)."""
    alone = dataclasses.replace(
        config.ris, side=1, subsurfaces=1, response="coherent", action="phases"
    )
    return build_radio_map(dataclasses.replace(config, ris=alone)).reflected[:, 0]


def _random_db(
    config: EnvConfig, radio_map: RadioMap, each: NDArray[np.complex128]
) -> NDArray[np.float64]:
    """|h|^2 in dB with a random phase for each element, mean over draws, shape (cells,)."""
    ris = config.ris
    generator = stream(config.map_seed, Stream.RADIO_MAP, 2)
    index = generator.integers(2**ris.bits, size=(DRAWS, ris.side**2))
    if ris.response == "coherent" or not ris.side:
        factor = np.exp(1j * phases(ris.bits))[index].sum(axis=1)[None]
    else:
        centres = Floor.from_config(config).centres()
        height = np.full(len(centres), config.motion.antenna_height_m)
        points_m = np.column_stack([centres, height]) - np.asarray(config.ris.position_m)
        factor = factors(Panel.from_config(config), points_m, index, ris.bits)
    channel = radio_map.direct[:, None] + each[:, None] * factor
    return np.asarray(20.0 * np.log10(np.abs(channel)).mean(axis=1))


def means(
    gains: Gains, los: NDArray[np.bool_], reached: NDArray[np.bool_]
) -> dict[str, dict[str, float | None]]:
    """Means in dB over all cells and over those out of the AP's sight (None if there are none).

    Args:
        gains: see ``gains_db``.
        los: whether the AP is in line of sight, shape (cells,).
        reached: whether robots reach the cell, shape (cells,); others do not count.
    """
    shadow = reached & ~los
    return {
        name: {
            "all_db": float(gain[reached].mean()),
            "shadow_db": float(gain[shadow].mean()) if shadow.any() else None,
        }
        for name, gain in gains.items()
    }


def map_figure(config: EnvConfig, radio_map: RadioMap) -> Figure:
    """The gain of the best action at each cell, with walls, AP and RIS."""
    figure = Figure(figsize=(6.4, 5.4), layout="constrained")
    axes = figure.subplots()
    image = draw_floor(axes, config, radio_map)
    figure.colorbar(image, ax=axes, label="channel gain, best action (dB)")
    return figure


def _table(config: EnvConfig, measures: dict[str, dict[str, float | None]]) -> Table:
    ris = config.ris
    response = "from a file" if config.channel.model == "file" else ris.response
    title = f"Mean gain over no RIS in dB\n{response}, M_R = {ris.side}, N_R = {2**ris.bits}"
    rows = (
        (name, _cell(found["all_db"]), _cell(found["shadow_db"]))
        for name, found in measures.items()
    )
    return table(title, ("phases", "all cells", "AP's shadow"), rows)


def _cell(value: float | None) -> str:
    return "-" if value is None or math.isnan(value) else f"{value:.1f}"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("risfleet map", description=__doc__)
    parser.add_argument("overrides", nargs="*", metavar="KEY=VALUE", help="sets a key")
    for option, name, say in (
        ("--out", "FILE.png", "draw the best gain over the floor there"),
        ("--channels", "FILE.npz", "write the map's channels there, for env.channel.model=file"),
        ("--json", "FILE", "write the gains there too"),
    ):
        parser.add_argument(option, type=user_path, metavar=name, help=say)
    return parser
