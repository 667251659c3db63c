"""The paper's claims: content, our number with its interval, and whether it holds.

Needs the runs of Figs. 3, 4 and 5, which lie in the same store, so nothing is trained twice, and
measures on the spot what gradient steps cost (``cost``). Verdicts follow from the numbers alone,
by the rule of ``verdicts``.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from experiments.reproduce.results.output import write_csv, write_table
from experiments.reproduce.results.runs import Runs
from experiments.reproduce.results.verdicts import Claim
from experiments.reproduce.targets import fig3, fig4, fig5
from experiments.reproduce.targets.claims_radio import fig4_claims, fig5_claims
from experiments.reproduce.targets.claims_training import training_claims
from experiments.reproduce.targets.plan import Cell

OURS = "not in the paper"
NOTE = (
    "In brackets 95 % bootstrap intervals over seeds (over blocks of steps where processor time of"
    " gradient steps is measured). A claim is checked in each setting that it speaks of: it holds"
    " in one if the whole interval is on the claimed side, fails if it is on the other, and is open"
    " if it reaches to both. It *holds* if it does in all settings, *depends on* what is named if"
    " it does in some, *does not hold* if it does in none and fails in one, and is *not shown* if"
    " it is open in all. `claims_checks.csv` has every setting."
)


class Claims:
    """The target ``claims``."""

    name = "claims"

    def cells(self, quick: bool) -> list[Cell]:
        """See ``Target``: those of Figs. 3, 4 and 5."""
        return [cell for each in (fig3, fig4, fig5) for cell in each.TARGET.cells(quick)]

    def report(self, runs: Runs, out: Path, *, quick: bool) -> list[Path]:
        """See ``Target``."""
        file = out / "planned.csv"
        of_fig3 = {cell.name: runs[cell.name] for cell in fig3.TARGET.cells(quick)}
        outcomes = fig4.outcomes(runs, fig4.settings(quick), file)
        held_out = fig5.held_out(runs, fig5.settings(quick), file)
        claims = [*training_claims(of_fig3), *fig4_claims(outcomes), *fig5_claims(held_out)]
        return [
            _write_table(out / "claims.md", claims, quick),
            _write_claims(out / "claims.csv", claims),
            _write_checks(out / "claims_checks.csv", claims),
            file,
        ]


TARGET = Claims()


def _write_table(path: Path, claims: Sequence[Claim], quick: bool) -> Path:
    header = ("the paper says", "where", "its number", "ours is", "ours", "verdict")
    rows = []
    for claim in claims:
        verdict = f"**{claim.verdict}**" + (f" ({claim.detail})" if claim.detail else "")
        where = claim.where or OURS
        rows.append((claim.says, where, claim.paper, claim.measure, claim.ours, verdict))
    return write_table(path, header, rows, NOTE, quick=quick)


def _write_claims(path: Path, claims: Sequence[Claim]) -> Path:
    """A row a claim."""
    header = ("claim", "where", "paper", "measure", "ours", "verdict", "detail")
    rows = [
        (c.says, c.where or OURS, c.paper, c.measure, c.ours, c.verdict, c.detail) for c in claims
    ]
    return write_csv(path, header, rows)


def _write_checks(path: Path, claims: Sequence[Claim]) -> Path:
    """A row a setting."""
    header = ("claim", "measure", "setting", "side", "threshold")
    number = ("value", "low", "high", "count", "bound")
    rows = []
    for claim in claims:
        for check in claim.checks:
            setting = ", ".join(check.setting.values())
            side = "above" if check.above else "below"
            of = (claim.says, claim.measure, setting, side, check.threshold)
            rows.append((*of, *check.number, check.result.value))
    return write_csv(path, (*header, *number, "result"), rows)
