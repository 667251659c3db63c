"""Slots with random picks, and what surfaces gain: the numbers (m) of docs/assumptions.md."""

import numpy as np

from env.config import ChannelConfig, EnvConfig, NoiseConfig, PowerConfig, RisConfig
from env.radio.radio_map import build_radio_map
from env.rendering.drawing import best_gain_db
from env.scenario import Scenario
from env.seeding import Stream, stream
from env.world import World


def random_slot(config, worlds=5000):
    """Mean sum rate and least rate, shares of signals that fail and of slots without the margin."""
    world = World(Scenario.drawn(config, 0), stream(0, Stream.WORLD), worlds)
    world.reset()
    draw, shape = np.random.default_rng(0), world.cell.shape
    phase = draw.integers(world.phase_actions, size=worlds)
    picks = draw.integers(1, config.power.levels + 1, size=shape)
    sent = world.step(phase, draw.integers(4, size=shape), picks)
    found = sent.allocation
    means = sent.rate.sum(-1), sent.rate.min(-1), found.sic_failed, found.margin_dropped
    return [round(float(x.mean()), 3) for x in means]


for resolve in ("project", "residual", "zero"):
    print(resolve, random_slot(EnvConfig(power=PowerConfig(resolve=resolve))))
for hertz in (1.0, 1e3, 1e6):
    print(hertz, "Hz", random_slot(EnvConfig(noise=NoiseConfig(bandwidth_hz=hertz))))
for margin in (0.0, 10.0, 100.0):
    print("margin", margin, random_slot(EnvConfig(power=PowerConfig(sic_margin=margin))))
print(
    "faint", random_slot(EnvConfig(robots=4, ris=RisConfig(side=0), power=PowerConfig(max_dbm=0.0)))
)

for robots in (3, 4):
    picks = np.indices([6] * robots) + 1.0
    print("over the budget", robots, (np.exp2(-picks).sum(axis=0) > 1).mean().round(3))
for fading in ("static", "none"):
    radio_map = build_radio_map(EnvConfig(channel=ChannelConfig(fading=fading)))
    gains = [radio_map.gain(np.arange(3600), np.array(action)) for action in range(4)]
    print("gains of their own", fading, [len(np.unique(gain)) for gain in gains])


def surface(label, **config):
    """Gain of the best phases over all cells and in shadow; how often they are a neighbour's."""
    radio_map = build_radio_map(EnvConfig(**config))
    gain_db = best_gain_db(radio_map) - 20 * np.log10(np.abs(radio_map.direct))
    channel = radio_map.direct[:, None] + radio_map.reflected @ radio_map.settings.T
    best = np.abs(channel).argmax(axis=-1).reshape(60, 60)
    shadow_db = gain_db[~radio_map.direct_los]
    same = (best[:, 1:] == best[:, :-1]).mean()
    print(label, gain_db.mean().round(1), shadow_db.mean().round(1), same.round(2))


for response in ("coherent", "far", "near", "rayleigh"):
    for side, parts in ((20, 1), (30, 1), (40, 1), (30, 4)):
        ris = RisConfig(side=side, subsurfaces=parts, response=response)
        surface(f"{response} M_R={side} N={parts}", ris=ris)
for fading in ("static", "none"):
    for phase in ("zero", "distance"):
        channel = ChannelConfig(fading=fading, los_phase=phase)
        surface(f"{fading} {phase}", channel=channel)
