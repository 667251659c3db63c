"""Energy efficiency with the exchange of weights counted, beside robots that exchange nothing.

An exchange takes as many times as long as its band is narrower, so one run tells of each bandwidth.
Runs of the quick scale are as long as those of the full one.
"""

from __future__ import annotations

from functools import partial

from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets.bytes import packed
from experiments.reproduce.targets.comparison import Column, Comparison, Variant
from experiments.reproduce.targets.plan import THREE_SEEDS
from training.exchange.airtime import left_over

BANDS = {"1 MHz": 1e6, "100 kHz": 1e5, "10 kHz": 1e4}

NOTE = (
    "Means over the last five evaluations in training, eps = .05; the interquartile mean over"
    " seeds, and in brackets the 95 % bootstrap interval. Δ: from robots that exchange nothing,"
    " seed by seed, nothing counted. Slots lost: share of all slots that exchanges take at 1 MHz,"
    " in %. EE at a bandwidth: with slots and joules of the exchange counted; 0 where it takes all."
)


def _scaled(bandwidth_hz: float, run: Run) -> tuple[float, float]:
    """Share of all slots and joules that a run's exchanges take in a band of this width."""
    account = run.summary["airtime"]
    wider = run.config.federation.airtime.bandwidth_hz / bandwidth_hz
    return wider * account["share"], wider * account["joules"]


def _counted(bandwidth_hz: float, run: Run) -> float:
    """EE with the exchange counted, in a band of this width."""
    account = run.summary["airtime"]
    left = left_over(*_scaled(bandwidth_hz, run), account["driving_joules"])
    return float(account["ee"]) * left


VARIANTS = (
    Variant("", "strategy=none", quick=True),
    Variant("plain", "federation.every=5 state.every=100", "N_F = 5", quick=True),
    Variant("plain", "federation.every=25", "N_F = 25", quick=True),
    Variant("plain", "federation.every=100", "N_F = 100", quick=True),
    Variant("plain", "federation.every=400", "N_F = 400"),
    Variant("1 bit", f"{packed('q1')} federation.every=5 state.every=100", "1 bit, N_F = 5"),
    Variant("1 bit", packed("q1"), "1 bit, N_F = 25"),
    Variant("1 bit", f"{packed('q1')} federation.every=100", "1 bit, N_F = 100"),
    Variant("the best channels", "federation.hear=1", "N_F = 25, hear 1", quick=True),
    Variant("the best channels", "federation.hear=2", "N_F = 25, hear 2"),
)

TARGET = Comparison(
    "airtime",
    VARIANTS,
    ("env.robots=3",),
    THREE_SEEDS,
    quick_common=(),
    extra={
        "slots lost, %": Column(lambda run: 100.0 * _scaled(BANDS["1 MHz"], run)[0], ".3f"),
        **{f"EE at {name}": Column(partial(_counted, hz), ".4f") for name, hz in BANDS.items()},
    },
    note=NOTE,
)
