"""Success against bytes: weights packed, exchanged more rarely, and of smaller networks.

Beside each stands what every transition, sent to one learner, would take. Runs of the quick scale
are as long as those of the full one, since what counts is success at the end.
"""

from __future__ import annotations

from experiments.reproduce.targets.comparison import NOTE, Column, Comparison, Variant
from experiments.reproduce.targets.plan import THREE_SEEDS

SMALL = "agent.hidden=[32,32]"


def packed(kind: str) -> str:
    """Overrides that pack weights both ways and send no target networks."""
    keys = (f"up={kind}", f"down={kind}", "targets=copied")
    return " ".join(f"federation.compression.{key}" for key in keys)


def _sent(key: str, form: str) -> Column:
    return Column(lambda run: run.summary["communication"][key], form)


VARIANTS = (
    Variant("", quick=True),
    Variant("targets", "federation.compression.targets=copied", "targets copied"),
    Variant("8 bits", packed("q8"), "8 bits"),
    Variant("4 bits", packed("q4"), "4 bits"),
    Variant("1 bit", packed("q1"), "1 bit", quick=True),
    Variant("1 bit", f"{packed('q1')} federation.every=50", "1 bit, N_F = 50", quick=True),
    Variant("1 bit", f"{packed('q1')} federation.every=100", "1 bit, N_F = 100"),
    Variant("largest", packed("topk"), "the largest 1 %", quick=True),
    Variant("small", SMALL, "2 x 32"),
    Variant("small", f"{SMALL} {packed('q1')}", "2 x 32, 1 bit", quick=True),
)
"""All but the first, the second and the small network as it is have no target networks sent."""

TARGET = Comparison(
    "bytes",
    VARIANTS,
    ("env.robots=3",),
    THREE_SEEDS,
    quick_common=(),
    extra={
        "bytes a window": _sent("weights_per_window", ",.0f"),
        "weights over transitions": _sent("weights_over_transitions", ".2f"),
    },
    note=f"{NOTE} Bytes are those of all robots, up and down; packed ones have no target networks.",
)
