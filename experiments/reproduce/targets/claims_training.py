"""Claims on training, Fig. 3: how fast, how steady, with how many robots, at what cost."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from conf.scheme_checks import MOST_JOINT_ACTIONS
from experiments.reproduce.results import cost, statistics
from experiments.reproduce.results.runs import Run, Runs
from experiments.reproduce.results.statistics import UNITS, Floats, difference, estimate
from experiments.reproduce.results.verdicts import Check, Claim, exact
from experiments.reproduce.targets.fig3 import BRANCHING, CENTRALIZED, OURS, RIVALS
from training.communication import per_tick
from training.recording.history import CONVERGED

FIG3 = "Section IV on Fig. 3"
TWO = {"K": "K = 2"}
LESS = 0.86
LAST = 50
"""Episodes at a run's end whose rewards are compared."""

TOO_DEAR = 1000.0
"""Times F-DRL's gradient steps from which on centralized DQN is said not to work: a minute of
F-DRL's is then 17 hours of it. Ours, taken when K = 3 was known to cost some 100 and K = 4 some
2,000 times as much; the paper does not say what it means."""


def training_claims(runs: Runs) -> list[Claim]:
    """What the paper says of training.

    Args:
        runs: Fig. 3's, by the cell's name and by seed.
    """
    each = {name: [by_seed[seed] for seed in sorted(by_seed)] for name, by_seed in runs.items()}
    ours = {f[0].config.env.robots: f for name, f in each.items() if name not in RIVALS}
    return [
        _faster(each, CENTRALIZED, LESS),
        _faster(each, BRANCHING, 0.0),
        *_at_the_end(each),
        _efficient(each, CENTRALIZED),
        _efficient(each, BRANCHING),
        _robust(ours),
        *_costs(each[OURS][0], each[CENTRALIZED][0]),
        _communication(ours),
    ]


def _faster(each: dict[str, list[Run]], rival: str, least: float) -> Claim:
    checks = []
    for unit, name in UNITS.items():
        ours, theirs = (statistics.times(each[cell], unit) for cell in (OURS, rival))
        checks.append(Check({"unit": name}, statistics.reduction(ours, theirs), least))
    paper = rival == CENTRALIZED
    return Claim(
        "F-DRL converges in at least 86 % less time than centralized DRL at K = 2"
        if paper
        else "F-DRL converges in less time than one network with a head for each robot at K = 2",
        f"abstract (i), Section I, {FIG3}" if paper else "",
        "≥ 86 %" if paper else "",
        "how much less until convergence, in %",
        checks,
        form=".0f",
        scale=100.0,
    )


def _at_the_end(each: dict[str, list[Run]]) -> list[Claim]:
    """Rewards at the end of training, and their fluctuations."""
    ours, theirs = ([_last_rewards(run) for run in each[name]] for name in (OURS, CENTRALIZED))
    higher = difference([np.mean(run) for run in ours], [np.mean(run) for run in theirs])
    steadier = difference([np.std(run) for run in ours], [np.std(run) for run in theirs])
    last = f"of the total rewards of the last {LAST} training episodes"
    return [
        Claim(
            "F-DRL obtains higher rewards than centralized DRL",
            FIG3,
            "",
            f"difference of the means {last}",
            [Check(TWO, higher)],
        ),
        Claim(
            "F-DRL's rewards fluctuate less than those of centralized DRL",
            FIG3,
            "",
            f"difference of the standard deviations {last}",
            [Check(TWO, steadier, above=False)],
        ),
    ]


def _efficient(each: dict[str, list[Run]], rival: str) -> Claim:
    paper = rival == CENTRALIZED
    gain = difference(_last5(each[OURS], "ee"), _last5(each[rival], "ee"))
    return Claim(
        "F-DRL outperforms benchmarks in energy efficiency"
        if paper
        else "F-DRL has a higher EE than one network with a head for each robot",
        "Section I" if paper else "",
        "",
        f"difference in EE from {rival}, last five evaluations, eps = .05",
        [Check(TWO, gain)],
        form="+.4f",
    )


def _last_rewards(run: Run) -> Floats:
    return run.metrics()["reward"][-LAST:]


def _last5(runs: Sequence[Run], measure: str) -> Floats:
    return np.array([run.summary["evaluation"]["last5"][measure] for run in runs], float)


def _robust(ours: dict[int, list[Run]]) -> Claim:
    return Claim(
        "F-DRL is robust to the number of robots",
        f"abstract (ii), {FIG3}",
        "",
        f"success, last five evaluations, eps = .05; at least {CONVERGED:g}",
        [
            Check({"K": f"K = {k}"}, estimate(_last5(runs, "success")), CONVERGED)
            for k, runs in sorted(ours.items())
        ],
        form=".2f",
    )


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
            FIG3,
            "",
            f"{measure}: K = {large} over K = {small}, as a ratio",
            [Check({"K": f"K = {large}"}, estimate(found[large] / found[small]), 1.0)],
        ),
        Claim(
            "centralized DRL cannot work when K > 3",
            FIG3,
            "K > 3",
            f"{measure}; works, by our measure: below {TOO_DEAR:,.0f}. Joint actions: {told};"
            f" more than {MOST_JOINT_ACTIONS:,} are refused, so above K = {large} the time is that"
            f" of K = {large} in proportion to them",
            [
                Check({"K": f"K = {k}"}, estimate(ratio), TOO_DEAR, above=k > large)
                for k, ratio in found.items()
            ],
            form=",.0f",
        ),
    ]


def _communication(ours: dict[int, list[Run]]) -> Claim:
    sent = {k: per_tick(runs[0].config) for k, runs in sorted(ours.items())}
    some = next(iter(sent.values()))
    every = next(iter(ours.values()))[0].config.federation.every
    return Claim(
        "F-DRL significantly reduces the communication overhead",
        "Section III-C",
        "",
        f"bytes of weights over bytes of every transition sent to one learner, N_F = {every};"
        f" below 1 from N_F = {some['break_even_every']:,.0f} on",
        [
            Check({"K": f"K = {k}"}, exact(of["weights_over_transitions"]), 1.0, above=False)
            for k, of in sent.items()
        ],
    )
