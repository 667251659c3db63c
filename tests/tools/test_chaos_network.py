"""The lockstep link between two hosts that are far apart, lose packets, or lose each other."""

import subprocess

import pytest

from tools.chaos.hosts import ADDRESSES, TwoHosts, obstacle
from tools.chaos.links import CUT_S, CUTS, DELAYS, IMPATIENT_S, Trial, converse

pytestmark = pytest.mark.chaos


@pytest.fixture(scope="module", autouse=True)
def hosts_can_be_made() -> None:
    if why_not := obstacle():
        pytest.skip(why_not)


def names_in_use() -> set[str]:
    listed = subprocess.run(["ip", "netns"], capture_output=True, text=True, check=True)
    return {line.split()[0] for line in listed.stdout.splitlines()}


@pytest.mark.parametrize(
    "trial", DELAYS, ids=lambda trial: f"{trial.delay_ms}-{trial.loss_percent}"
)
def test_a_conversation_is_the_same_over_a_long_cable_and_takes_a_round_trip_a_tick(
    trial: Trial,
) -> None:
    heard = converse(trial)
    assert heard.server.get("correct"), heard
    assert heard.client["error"] == ""
    assert heard.server["round_trips"] > trial.ticks
    assert heard.server["elapsed_s"] > heard.server["round_trips"] * 2 * trial.delay_ms / 1e3


def test_a_cable_that_is_cut_and_mended_delays_the_conversation_alone() -> None:
    heard = converse(CUTS[0])
    assert heard.server.get("correct"), heard
    assert heard.client["error"] == ""
    assert heard.server["longest_s"] > CUT_S * 0.9


def test_a_cable_that_stays_cut_is_reported_at_both_ends() -> None:
    heard = converse(CUTS[1])
    limit = f"{IMPATIENT_S:g} s"
    assert heard.server["error"] == "LinkTimeout", heard
    assert heard.server["message"].startswith(f"robots 0, 1, 2 did not answer within {limit}")
    assert heard.client["error"] == "LinkTimeout"
    assert heard.client["message"] == f"no word from the server for {limit}"


def test_hosts_are_apart_from_this_one_and_removed_whatever_happens() -> None:
    before = names_in_use()
    with pytest.raises(RuntimeError), TwoHosts() as hosts:  # noqa: PT012
        assert names_in_use() == before | set(hosts.names)
        shown = hosts.start(1, ["ip", "-brief", "address"])
        assert shown.stdout is not None
        seen = shown.stdout.read()
        assert ADDRESSES[1] in seen
        assert len(seen.splitlines()) == 2
        left = hosts.start(0, ["sleep", "1000"])
        raise RuntimeError
    assert names_in_use() == before
    assert left.returncode == -9
