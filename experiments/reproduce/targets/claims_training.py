"""Claims on training, Fig. 3: how fast, how steady, with how many robots, at what cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from conf.scheme_checks import MOST_JOINT_ACTIONS
from experiments.reproduce.results import cost
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.results.statistics import UNITS, Estimate, Floats, difference, estimate
from experiments.reproduce.results.verdicts import Check, Claim, exact
from experiments.reproduce.targets.comparison import last5
from experiments.reproduce.targets.fig3 import BRANCHING, CENTRALIZED, OURS, RIVALS, reductions
from training.communication import per_tick
from training.recording.history import CONVERGED

FIG3 = "Section IV on Fig. 3"
TWO = {"K": "K = 2"}
SOONER = "how much less until convergence, in %"
EFFICIENCY = "difference in EE from {}, last five evaluations, eps = .05"
HEADS = "one network with a head for each robot"
LAST = 50
"""Episodes at a run's end whose rewards are compared."""

TOO_DEAR = 1000.0
"""Times F-DRL's gradient steps from which on centralized DQN is said not to work: a minute of
F-DRL's is then 17 hours of it. Ours, taken when K = 3 was known to cost some 100 and K = 4 some
2,000 times as much; the paper does not say what it means."""


def training_claims(runs: Runs) -> list[Claim]:
    """What the paper says of training, from the runs of Fig. 3."""
    each = {name: [by_seed[seed] for seed in sorted(by_seed)] for name, by_seed in runs.items()}
    ours = {f[0].config.env.robots: f for name, f in each.items() if name not in RIVALS}
    last = f"of the total rewards of the last {LAST} training episodes"
    ee = {name: last5(each[name], "ee") for name in (OURS, *RIVALS)}
    return [
        Claim(
            "F-DRL converges in at least 86 % less time than centralized DRL at K = 2",
            SOONER,
            _faster(each[OURS], each[CENTRALIZED], 0.86),
            where=f"abstract (i), Section I, {FIG3}",
            paper="≥ 86 %",
            form=".0f",
            scale=100.0,
        ),
        Claim(
            f"F-DRL converges in less time than {HEADS} at K = 2",
            SOONER,
            _faster(each[OURS], each[BRANCHING], 0.0),
            form=".0f",
            scale=100.0,
        ),
        Claim(
            "F-DRL obtains higher rewards than centralized DRL",
            f"difference of the means {last}",
            [Check(TWO, _at_the_end(np.mean, each[OURS], each[CENTRALIZED]))],
            where=FIG3,
        ),
        Claim(
            "F-DRL's rewards fluctuate less than those of centralized DRL",
            f"difference of the standard deviations {last}",
            [Check(TWO, _at_the_end(np.std, each[OURS], each[CENTRALIZED]), above=False)],
            where=FIG3,
        ),
        Claim(
            "F-DRL outperforms benchmarks in energy efficiency",
            EFFICIENCY.format(CENTRALIZED),
            [Check(TWO, difference(ee[OURS], ee[CENTRALIZED]))],
            where="Section I",
            form="+.4f",
        ),
        Claim(
            f"F-DRL has a higher EE than {HEADS}",
            EFFICIENCY.format(BRANCHING),
            [Check(TWO, difference(ee[OURS], ee[BRANCHING]))],
            form="+.4f",
        ),
        Claim(
            "F-DRL is robust to the number of robots",
            f"success, last five evaluations, eps = .05; at least {CONVERGED:g}",
            [
                Check({"K": f"K = {k}"}, estimate(last5(runs, "success")), CONVERGED)
                for k, runs in sorted(ours.items())
            ],
            where=f"abstract (ii), {FIG3}",
            form=".2f",
        ),
        *_costs(each[OURS][0], each[CENTRALIZED][0]),
        _communication(ours),
    ]


def _faster(ours: Sequence[Run], theirs: Sequence[Run], least: float) -> list[Check]:
    found = reductions(ours, theirs)
    return [Check({"unit": UNITS[unit]}, share, least) for unit, share in found.items()]


def _at_the_end(of: Callable[[Floats], Any], *pair: Sequence[Run]) -> Estimate:
    """The difference of ours and theirs in a statistic of the last rewards of training."""
    return difference(*([of(run.metrics()["reward"][-LAST:]) for run in runs] for runs in pair))


def _costs(ours: Run, theirs: Run) -> list[Claim]:
    """What a gradient step of centralized DQN costs, measured in a few seconds."""
    found = cost.ratios(ours.config, theirs.config)
    small, large = cost.MEASURED
    counts = {k: cost.actions(ours.config, k) for k in found}
    told = ", ".join(f"{count:,}" for count in counts.values())
    measure = "processor time of centralized DQN's gradient step over that of all of F-DRL's agents"
    return [
        Claim(
            "F-DRL's gain grows with the number of robots",
            f"{measure}: K = {large} over K = {small}, as a ratio",
            [Check({"K": f"K = {large}"}, estimate(found[large] / found[small]), 1.0)],
            where=FIG3,
        ),
        Claim(
            "centralized DRL cannot work when K > 3",
            f"{measure}; works, by our measure: below {TOO_DEAR:,.0f}. Joint actions: {told};"
            f" more than {MOST_JOINT_ACTIONS:,} are refused, so above K = {large} the time is that"
            f" of K = {large} in proportion to them",
            [
                Check({"K": f"K = {k}"}, estimate(ratio), TOO_DEAR, above=k > large)
                for k, ratio in found.items()
            ],
            where=FIG3,
            paper="K > 3",
            form=",.0f",
        ),
    ]


def _communication(ours: dict[int, list[Run]]) -> Claim:
    sent = {k: per_tick(runs[0].config) for k, runs in sorted(ours.items())}
    some = next(iter(sent.values()))
    every = next(iter(ours.values()))[0].config.federation.every
    return Claim(
        "F-DRL significantly reduces the communication overhead",
        f"bytes of weights over bytes of every transition sent to one learner, N_F = {every};"
        f" below 1 from N_F = {some['break_even_every']:,.0f} on",
        [
            Check({"K": f"K = {k}"}, exact(of["weights_over_transitions"]), 1.0, above=False)
            for k, of in sent.items()
        ],
        where="Section III-C",
    )
