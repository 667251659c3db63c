"""The tables of bytes and airtime, from runs of a tiny task."""

import pytest
from reproduce_helpers import rows_of, same_run

from experiments.reproduce.results.runs import Run
from experiments.reproduce.targets import airtime, bytes


@pytest.fixture
def report(tiny_run, tmp_path):
    """What a target says of each measure, the same run in every cell."""

    def values(target):
        target.report(same_run(target, tiny_run), tmp_path, quick=True)
        rows = rows_of(tmp_path / f"{target.name}.csv")
        return {row["measure"]: float(row["value"]) for row in rows}

    return values


def test_bytes_are_those_that_the_run_counted(report, tiny_run):
    found, sent = report(bytes.TARGET), Run(tiny_run).summary["communication"]
    assert found["bytes a window"] == pytest.approx(sent["weights_per_window"])
    assert found["weights over transitions"] == pytest.approx(sent["weights_over_transitions"])


def test_a_narrower_band_leaves_less(report, tiny_run):
    found, account = report(airtime.TARGET), Run(tiny_run).summary["airtime"]
    assert found["slots lost, %"] == pytest.approx(100 * account["share"], rel=1e-5)
    assert found["EE at 1 MHz"] == pytest.approx(account["ee_counted"], rel=1e-5)
    for band, times in (("100 kHz", 10), ("10 kHz", 100)):
        left = (1 - times * account["share"]) * account["driving_joules"]
        left /= account["driving_joules"] + times * account["joules"]
        assert found[f"EE at {band}"] == pytest.approx(left * account["ee"], rel=1e-4)
    assert found["EE at 10 kHz"] < found["EE at 100 kHz"] < account["ee"]
