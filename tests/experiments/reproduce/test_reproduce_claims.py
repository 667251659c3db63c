"""``risfleet reproduce claims``: the rule of its verdicts, and what it judges."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from reproduce_helpers import measure_shortly

from conf import overridden
from experiments.reproduce.results import cost
from experiments.reproduce.results.statistics import Estimate
from experiments.reproduce.results.verdicts import Check, Claim, ClaimResult, exact
from experiments.reproduce.targets import claims, fig3, fig4, fig5
from experiments.reproduce.targets.claims_radio import fig4_claims, fig5_claims
from experiments.reproduce.targets.fig4_points import LEARNED, PLANNED, PointOutcome


def check(
    low: float, high: float, *, above: bool = True, threshold: float = 0.0, **at: str
) -> Check:
    number = Estimate((low + high) / 2, low, high, 3)
    return Check(at or {"K": "K = 2"}, number, threshold, above)


def claim(*checks: Check) -> Claim:
    return Claim("says", "measure", checks)


HOLDS, FAILS, OPEN = (0.1, 0.3), (-0.3, -0.1), (-0.1, 0.3)


def test_an_interval_on_the_claimed_side_holds() -> None:
    assert check(*HOLDS).result is ClaimResult.HOLDS
    assert check(*FAILS).result is ClaimResult.FAILS
    assert check(*OPEN).result is ClaimResult.OPEN
    assert check(0.0, 0.0).result is ClaimResult.OPEN  # no difference at all is not a larger one


def test_what_ought_to_be_smaller_holds_below_the_threshold() -> None:
    assert check(*HOLDS, above=False).result is ClaimResult.FAILS
    assert check(*FAILS, above=False).result is ClaimResult.HOLDS
    assert check(0.1, 0.3, above=False, threshold=0.5).result is ClaimResult.HOLDS
    assert check(0.1, 0.3, threshold=0.2).result is ClaimResult.OPEN


def test_a_number_without_an_interval_is_judged_by_what_is_sure() -> None:
    def result(value: float, bound: str = "") -> ClaimResult:
        return Check({}, Estimate(value, np.nan, np.nan, 1, bound)).result

    assert [result(1.0), result(-1.0)] == [ClaimResult.HOLDS, ClaimResult.FAILS]
    assert [result(1.0, "≥"), result(-1.0, "≥")] == [ClaimResult.HOLDS, ClaimResult.OPEN]
    assert [result(1.0, "≤"), result(-1.0, "≤")] == [ClaimResult.OPEN, ClaimResult.FAILS]
    assert result(1.0, "?") is result(np.nan) is ClaimResult.OPEN
    assert Check({}, exact(75.1), 1.0, above=False).result is ClaimResult.FAILS


def test_a_claim_holds_if_it_does_everywhere() -> None:
    everywhere = claim(check(*HOLDS, K="2"), check(*HOLDS, K="3"))
    assert (everywhere.verdict, everywhere.detail) == ("holds", "")
    assert claim(check(*FAILS, K="2"), check(*OPEN, K="3")).verdict == "does not hold"
    assert claim(check(*OPEN, K="2"), check(*OPEN, K="3")).verdict == "not shown"


def test_a_claim_depends_on_the_axis_that_settles_it() -> None:
    both = claim(*(check(*(HOLDS if k == "3" else FAILS), M_R=m, K=k) for m in "02" for k in "34"))
    assert both.verdict == "depends on K"
    assert both.detail == "holds: 3; fails: 4"
    mixed = claim(
        *(
            check(*(HOLDS if m == "0" and k == "3" else OPEN), M_R=m, K=k)
            for m in "02"
            for k in "34"
        )
    )
    assert mixed.verdict == "depends on M_R, K"
    assert mixed.detail == "holds in 1, open in 3 of 4 settings"


def test_a_claim_shows_each_number_or_one_for_all() -> None:
    each = claim(check(0.25, 0.75, K="2"), check(1.5, 2.5, K="3"))
    assert each.ours == "2: 0.5 (0.2 to 0.8); 3: 2.0 (1.5 to 2.5)"
    pooled = Claim("", "", each.checks, pooled=Estimate(0.12, 0.1, 0.2, 3), form=".0f", scale=100.0)
    assert pooled.ours == "12 (10 to 20)"


def outcomes(ee: Any, curves: Sequence[str] = (LEARNED,)) -> list[PointOutcome]:
    """Outcomes of two seeds at K = 3, with EE as a function of M_R, P_max and access."""
    return [
        PointOutcome(
            3, side, power, access, curve, seed, ee(side, power, access) + seed, 1.0, 1.0, 1.0
        )
        for curve in curves
        for side in (0, 20, 30)
        for power in (10, 20)
        for access in ("noma", "oma")
        for seed in (0, 1)
    ]


def verdicts(claims: Sequence[Claim]) -> dict[str, str]:
    return {claim.says: claim.verdict for claim in claims}


def test_claims_on_efficiency_follow_from_the_points() -> None:
    def ee(side: int, power: int, access: str) -> float:
        better = 10 if power == 20 else -10
        return 100 + side + (better if access == "noma" else 0)

    found = verdicts(fig4_claims(outcomes(ee)))
    assert found["NOMA has a higher EE than OMA"] == "depends on P_max"
    assert found["EE grows with P_max"] == "depends on access"
    assert found["the RIS raises EE"] == found["EE grows with M_R at K = 3"] == "holds"
    flatter = "at K = 3 EE improves less for M_R above 20 than below"
    assert found[f"{flatter}, in all"] == "holds"  # 10 after 20
    assert found[f"{flatter}, for each row of elements that is added"] == "not shown"  # as steep
    assert not any("K = 4" in says for says in found)  # nothing is known of it


def test_planned_policies_are_judged_by_themselves() -> None:
    found = fig4_claims(outcomes(lambda *_: 100.0, (LEARNED, PLANNED)))
    assert [claim.says for claim in found].count("the RIS raises EE") == 2
    assert {claim.verdict for claim in found} == {"not shown"}


def test_claims_on_qoe_follow_from_the_measures() -> None:
    rows = [
        fig5.Fig5Measures(
            side=side,
            metric=metric,
            policy=LEARNED,
            starts=fig5.HELD_OUT,
            seed=seed,
            ee=1.2 if metric == "qos" else 1.0 + seed / 10,
            sum_rate=5.0,
            min_rate=3.0 if metric == "qoe" else 2.0,
            success=1.0,
            path_ratio=1.0,
            gain_db=-90 + side / 10 + (1 if metric == "qos" and side > 20 else 0),
        )
        for metric in ("qos", "qoe")
        for side in (0, 20, 30)
        for seed in (0, 1)
    ]
    found = verdicts(fig5_claims([*rows, *(row._replace(policy=PLANNED) for row in rows)]))
    assert found["QoS has a higher EE than QoE"] == "holds"
    assert found["with QoE the worst robot has a higher rate than with QoS"] == "holds"
    channels = "QoS keeps better channels than QoE"
    assert found[channels] == "depends on M_R"
    assert found[f"{channels}, the more so for M_R > 20"] == "holds"
    assert found["the RIS enhances the channels"] == "holds"


def test_a_centralized_step_is_dearer_in_proportion_to_the_joint_actions(
    tiny: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure_shortly(monkeypatch)
    ours = tiny()
    theirs = overridden(ours, ["scheme.agents=centralized", "strategy.name=none"])
    found = cost.ratios(ours, theirs)
    assert set(found) == {2, 3, 4, 5, 6}
    assert all(ratio.shape == (cost.BLOCKS,) and (ratio > 0).all() for ratio in found.values())
    assert cost.actions(ours, 4) == 24 * cost.actions(ours, 3) == 1_327_104


def test_claims_need_no_run_that_a_figure_does_not() -> None:
    for quick in (True, False):
        cells = claims.TARGET.cells(quick)
        of_figures = [cell for f in (fig3, fig4, fig5) for cell in f.TARGET.cells(quick)]
        assert cells == of_figures
        assert len({cell.name for cell in cells}) == len(cells)
