"""The schema of what happens to weights on their way (``training/exchange``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Interval


@dataclass(frozen=True)
class PrivacyConfig:
    """Differential privacy of what robots upload: clipped steps, and Gaussian noise."""

    name: Annotated[
        str,
        Literal["none", "central", "adaptive", "local"],
        "who adds noise: the server to the mean, with a fixed or adaptive clip, or each robot",
    ] = "none"
    clip: Annotated[
        float, Interval(gt=0, le=1e6), "C: largest norm of a window's step; adaptive: its first"
    ] = 0.1
    noise: Annotated[
        float, Interval(ge=0, le=1e6), "z: deviation z C, of the sum of the steps or of each"
    ] = 0.0
    delta: Annotated[float, Interval(gt=0, lt=1), "at which epsilon is reported"] = 1e-5
    quantile: Annotated[
        float, Interval(gt=0, lt=1), "adaptive: share of the steps that stay as they are"
    ] = 0.5
    clip_rate: Annotated[
        float, Interval(gt=0, le=10), "adaptive: how fast the logarithm of the clip moves"
    ] = 0.2


@dataclass(frozen=True)
class AttackConfig:
    """What hostile robots, the last ones, upload; they drive and learn as the others do."""

    name: Annotated[
        str, Literal["none", "noise", "flip", "scale", "stale"], "see training/exchange/attacks.py"
    ] = "none"
    robots: Annotated[int, Ge(0), "how many are hostile: robots K - robots to K - 1"] = 0
    scale: Annotated[
        float,
        Interval(gt=0, le=1000),
        "noise, flip, scale: length of the false step, in honest ones",
    ] = 1.0


@dataclass(frozen=True)
class CompressionConfig:
    """Fewer bytes for weights on their way, as packed differences with error feedback."""

    up: Annotated[
        str, Literal["none", "q8", "q4", "q1", "topk"], "robots' uploads: so many bits a number"
    ] = "none"
    down: Annotated[str, Literal["none", "q8", "q4", "q1", "topk"], "the global model"] = "none"
    keep: Annotated[float, Interval(gt=0, le=1), "topk: share of the numbers that are sent"] = 0.01
    targets: Annotated[
        str, Literal["averaged", "copied"], "target networks: sent too, or copied from online ones"
    ] = "averaged"


@dataclass(frozen=True)
class AirtimeConfig:
    """What weights take of the channel; an account in ``summary.json``, which changes no run."""

    bandwidth_hz: Annotated[
        float, Interval(gt=0, le=1e12), "of weights, in Hz; rates in bit/s/Hz are the channel's"
    ] = 1e6


@dataclass(frozen=True)
class LossesConfig:
    """Uploads that do not come, or late; all robots go on driving, learning and hearing."""

    probability: Annotated[
        float, Interval(ge=0, le=1), "that an upload is lost, each by itself"
    ] = 0.0
    outage_db: Annotated[
        float | None, "10 lg|h|^2 at a window's end below which a robot's upload is lost"
    ] = None
    late: Annotated[
        float, Interval(ge=0, le=1), "probability that one comes a window late, of those not lost"
    ] = 0.0
