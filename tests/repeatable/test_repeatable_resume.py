"""A run that was interrupted anywhere goes on to the bits of one that was not."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flwr.app import (
    Array,
    ArrayRecord,
    ConfigRecord,
    Message,
    MetricRecord,
    RecordDict,
)
from flwr.serverapp import Grid
from flwr.serverapp.strategy import FedAvg, FedAvgM
from hypothesis import given
from hypothesis import strategies as st
from repeatable_helpers import answering, config, digest_of, fedadam, model, play, wrapped

from repeatable import OtherRunError, digest, generator
from repeatable.checkpoints import newest_arrays, newest_round
from repeatable.client import client_app
from repeatable.kept import Kept
from repeatable.records import packed, unpacked
from storage.checkpoint_files import CheckpointError, load_checkpoint, save_checkpoint

ROUNDS = 6


class Killed:
    """A client app whose process dies at a call: nothing is answered or written any more."""

    def __init__(self, app: Any, at: int) -> None:
        self.app, self.left = app, at

    def __call__(self, message: Message, context: Any) -> Message:
        self.left -= 1
        if self.left < 0:
            raise KeyboardInterrupt  # no error of a client's, so nobody answers for it
        answer: Message = self.app(message, context)
        return answer


@pytest.fixture(scope="module")
def whole() -> str:
    return digest_of(wrapped(), ROUNDS)


@pytest.mark.parametrize("at", [0, 4, 7, 9, 12, 20, 33, 45])
def test_a_run_that_was_killed_goes_on_to_the_same_bits(
    at: int, whole: str, tmp_path: Path
) -> None:
    """Moments of FedAdam, momentum of clients that are asked now and then, and all draws."""
    from repeatable_helpers import APP

    with pytest.raises(KeyboardInterrupt):
        play(wrapped(state=tmp_path), ROUNDS, app=Killed(APP.client, at), state=tmp_path)
    assert digest_of(wrapped(state=tmp_path), ROUNDS, state=tmp_path) == whole


def test_a_run_may_be_killed_again_and_again(whole: str, tmp_path: Path) -> None:
    from repeatable_helpers import APP

    for at in (14, 17, 12, 13):
        with pytest.raises(KeyboardInterrupt):
            play(wrapped(state=tmp_path), ROUNDS, app=Killed(APP.client, at), state=tmp_path)
    assert 0 < newest_round(tmp_path) < ROUNDS
    assert digest_of(wrapped(state=tmp_path), ROUNDS, state=tmp_path) == whole


def test_without_the_clients_states_other_bits_would_come_of_it(whole: str, tmp_path: Path) -> None:
    play(wrapped(state=tmp_path), 3)
    assert digest_of(wrapped(state=tmp_path), ROUNDS) != whole


def test_without_the_strategys_state_other_bits_would_come_of_it(
    whole: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    play(wrapped(state=tmp_path), 3, state=tmp_path)
    monkeypatch.setattr(Kept, "restore", lambda self, state: None)
    assert digest_of(wrapped(state=tmp_path), ROUNDS, state=tmp_path) != whole


@pytest.mark.parametrize("cut", [True, False])
def test_a_damaged_checkpoint_costs_a_round(cut: bool, whole: str, tmp_path: Path) -> None:
    play(wrapped(state=tmp_path), 4, state=tmp_path)
    newest = max((tmp_path / "server").iterdir())
    content = newest.read_bytes()
    newest.write_bytes(content[:-40] if cut else content[:-1] + bytes([content[-1] ^ 1]))
    assert digest_of(wrapped(state=tmp_path), ROUNDS, state=tmp_path) == whole


def test_a_folder_with_damaged_checkpoints_alone_is_refused(tmp_path: Path) -> None:
    play(wrapped(state=tmp_path), 2)
    for path in (tmp_path / "server").iterdir():
        path.write_bytes(b"")
    with pytest.raises(CheckpointError, match="cut short or damaged"):
        play(wrapped(state=tmp_path), 2)


def test_a_run_that_has_ended_ends_at_once_and_may_go_further(whole: str, tmp_path: Path) -> None:
    def silent(*arguments: Any) -> Any:
        raise AssertionError

    play(wrapped(state=tmp_path), 4, state=tmp_path)
    result = play(wrapped(state=tmp_path), 4, app=answering(silent), state=tmp_path)
    assert digest(result.arrays) == digest_of(wrapped(), 4)
    assert [*result.train_metrics_clientapp] == [*result.evaluate_metrics_clientapp] == [1, 2, 3, 4]
    assert digest_of(wrapped(state=tmp_path), ROUNDS, state=tmp_path) == whole


def test_another_run_is_not_taken_for_this_one(tmp_path: Path) -> None:
    play(wrapped(state=tmp_path), 1)
    for other, said in (
        (wrapped(1, state=tmp_path), "a run with seed 0, and this one has 1"),
        (wrapped(strategy=FedAvg(), state=tmp_path), "with strategy FedAdam, and this one has Fed"),
    ):
        with pytest.raises(OtherRunError, match=said):
            play(other, 1)
    with pytest.raises(OtherRunError, match="with initial model"):
        play(wrapped(state=tmp_path), 1, initial=model(3))
    with pytest.raises(OtherRunError, match="with configuration"):
        play(wrapped(state=tmp_path), 1, train_config=config(lr=0.1))


def test_clients_of_a_fresh_run_do_not_take_up_an_older_ones_state(tmp_path: Path) -> None:
    """The server's folder was removed, and the clients' are on hosts of their own."""
    fresh = digest_of(wrapped(), 3)
    play(wrapped(state=tmp_path / "one"), 5, state=tmp_path / "nodes")
    assert digest_of(wrapped(state=tmp_path / "two"), 3, state=tmp_path / "nodes") == fresh


class Decaying(FedAvg):
    """Changes the configuration that it is given, as Flower's documentation shows it."""

    def configure_train(
        self, server_round: int, arrays: ArrayRecord, config: ConfigRecord, grid: Grid
    ) -> Iterable[Message]:
        config["lr"] = float(config["lr"]) * 0.5
        return super().configure_train(server_round, arrays, config, grid)


def test_what_a_strategy_makes_of_its_configuration_is_kept(tmp_path: Path) -> None:
    def told(message: Message, context: Any) -> Any:
        return np.array([message.content.config_records["config"]["lr"]])

    def played(rounds: int, state: Path | str) -> ArrayRecord:
        strategy, start = wrapped(strategy=Decaying(), state=state), config(lr=1.0)
        return play(
            strategy, rounds, app=answering(told), initial=model(1), train_config=start
        ).arrays

    played(3, tmp_path)
    assert played(5, tmp_path)["weights"].numpy() == 0.5**5


def test_a_client_keeps_what_it_likes_and_goes_back_with_the_server(tmp_path: Path) -> None:
    seen = []

    def counting(message: Message, context: Any) -> Any:
        kept = context.state.get("kept") or ConfigRecord({"rounds": [], "name": b"\x00\xff"})
        order = message.content.config_records["config"]["server-round"]
        if context.node_config["partition-id"] == 0:
            seen.append((order, list(kept["rounds"]), kept["name"]))
        kept["rounds"] = [*kept["rounds"], int(order)]
        context.state["kept"] = kept
        return generator().normal(size=2)

    app, strategy = answering(counting), FedAvg
    options: Any = {"initial": model(2), "state": tmp_path}
    play(wrapped(strategy=strategy(), state=tmp_path), 2, app=app, **options)
    with pytest.raises(KeyboardInterrupt):  # in round 3, after all clients have written theirs
        play(wrapped(strategy=strategy(), state=tmp_path), 4, app=Killed(app, 5 + 5 + 2), **options)
    play(wrapped(strategy=strategy(), state=tmp_path), 4, app=app, **options)
    due = [(n, [*range(1, n)], b"\x00\xff") for n in (1, 2, 3, 3, 4)]
    assert seen == due


def test_a_client_without_a_state_writes_no_files(tmp_path: Path) -> None:
    plain = answering(lambda message, context: np.zeros(2))
    strategy = wrapped(strategy=FedAvg(), state=tmp_path)
    play(strategy, 2, app=plain, initial=model(2), state=tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["server"]


def test_metrics_that_are_no_numbers_are_kept(tmp_path: Path) -> None:
    app = answering(lambda message, context: np.zeros(2))
    for rounds in (2, 3):
        strategy = wrapped(strategy=FedAvg(), state=tmp_path)
        result = play(strategy, rounds, app=app, initial=model(2))
    losses = [result.evaluate_metrics_clientapp[n]["loss"] for n in (1, 2, 3)]
    assert all(math.isnan(loss) for loss in losses)


def test_lists_of_a_strategy_are_kept_too(tmp_path: Path) -> None:
    def momentum() -> FedAvgM:
        return FedAvgM(server_momentum=0.9, server_learning_rate=0.5)

    play(wrapped(strategy=momentum(), state=tmp_path), 2, state=tmp_path)
    resumed = digest_of(wrapped(strategy=momentum(), state=tmp_path), 4, state=tmp_path)
    assert resumed == digest_of(wrapped(strategy=momentum()), 4)


def test_the_folder_says_what_a_run_has_come_to(whole: str, tmp_path: Path) -> None:
    assert (newest_arrays(tmp_path), newest_round(tmp_path)) == (None, -1)
    play(wrapped(state=tmp_path), ROUNDS, state=tmp_path)
    found = newest_arrays(tmp_path)
    assert found is not None
    assert (found[0], digest(found[1])) == (ROUNDS, whole)


def test_generator_is_for_a_message_in_hand() -> None:
    with pytest.raises(LookupError):
        generator()
    assert client_app() is not client_app()


# --- Records and arrays ---------------------------------------------------------------------------

names = st.text(min_size=1, max_size=8)
plain = st.one_of(st.integers(-(2**63), 2**63 - 1), st.floats(), st.text(), st.binary())
numbers = st.one_of(st.integers(-(2**63), 2**63 - 1), st.floats())
records = st.one_of(
    st.dictionaries(names, plain).map(ConfigRecord),
    st.dictionaries(names, numbers | st.lists(st.floats())).map(MetricRecord),
    st.dictionaries(names, st.sampled_from([(), (0,), (2, 3), (4,)])).map(
        lambda shapes: ArrayRecord(
            {name: Array(np.ones(shape, "f4")) for name, shape in shapes.items()}
        )
    ),
)


@given(st.dictionaries(names, records).map(RecordDict))
def test_records_come_back_as_they_were(found: RecordDict) -> None:
    arrays, described = packed(found)
    again = unpacked(arrays, json.loads(json.dumps(described, allow_nan=False)))
    assert repr(again) == repr(found)
    assert [*map(list, again.values())] == [*map(list, found.values())]


def test_arrays_without_dimensions_stay_so_in_a_file(tmp_path: Path) -> None:
    arrays = {"scalar": np.array(3.5), "turned": np.arange(6.0).reshape(2, 3).T}
    save_checkpoint(tmp_path, 1, arrays, {})
    found, _ = load_checkpoint(tmp_path, 1)
    assert [found[name].shape for name in arrays] == [(), (3, 2)]
    assert digest(found) == digest(arrays)


def test_digests_tell_models_apart() -> None:
    base = {"a": np.zeros(2, "f4"), "b": np.ones((), "f8")}
    assert digest(base) == digest({name: base[name] for name in "ba"})
    others = [
        {**base, "a": np.zeros(2, "f8")},
        {**base, "a": np.zeros((2, 1), "f4")},
        {**base, "a": -np.zeros(2, "f4")},
        {"c": base["a"], "b": base["b"]},
    ]
    assert digest(base) not in {digest(other) for other in others}


def test_a_strategys_texts_and_lists_are_kept() -> None:
    strategy, other = fedadam(), fedadam()
    kept, again = Kept(strategy), Kept(other)
    strategy.note, strategy.losses = "é", [[0.1], {"a": None}]
    other.note = other.losses = None
    again.restore(kept.state())
    assert (other.note, other.losses) == (strategy.note, strategy.losses)
