"""The benchmarks that need no further process run in their quick form and report numbers."""

import json
import math

import pytest

from benchmarks.__main__ import known, main


@pytest.mark.parametrize("name", ["engine", "worlds", "parts", "scaling", "central"])
def test_a_benchmark_reports_finite_positive_numbers(name, tmp_path):
    path = tmp_path / "bench.json"
    assert main(["--quick", "--only", name, "--json", str(path)]) == 0
    report = json.loads(path.read_text())
    assert report["failed"] == {}
    assert report["results"]
    for result in report["results"]:
        assert report[result["name"]] == result["value"]
        for number in (result["value"], result["low"], result["high"], *result["details"].values()):
            assert math.isfinite(number)
            assert number > 0


@pytest.mark.parametrize(
    ("result", "benchmark"),
    [("world_step_vs_cartpole_k3", "worlds"), ("link_share", "deployment"), ("runs", "runs")],
)
def test_a_result_chooses_the_benchmark_that_finds_it(result, benchmark):
    assert known(result) == benchmark


def test_an_unknown_name_ends_the_command_with_a_message(capsys):
    with pytest.raises(SystemExit):
        main(["--only", "nothing"])
    assert "'nothing'" in capsys.readouterr().err
