"""Composing a run's configuration: groups, experiments, and one sentence for each mistake."""

import dataclasses
from typing import Any

import pytest

from conf import Config, ConfigError, compose, from_yaml, overridden, problems, to_yaml
from conf.overrides import FOLDER

MISTAKES = [
    # A wrong key: what was meant, or what there is.
    (["env.robotz=2"], "env.robotz is no key: did you mean env.robots"),
    (["robots=2"], "robots is no key: did you mean env.robots"),
    (["env.ris.qqqqqqq=2"], "env.ris.qqqqqqq is no key: allowed here are env.ris.position_m, "),
    (["env.robots.k=2"], "env.robots.k is no key: did you mean env.robots"),
    (["agent.n_step=3"], "agent.n_step was taken out: the last commit with it is 2a18898."),
    (["agent.priority.alpha=.5"], "agent.priority was taken out: the last commit with it is 2a18"),
    (["zzz=1"], "zzz is no key: allowed here are seed, env, agent"),
    (["env.ris=3"], "env.ris is a group of keys: set one of them, such as env.ris.position_m."),
    # A wrong type.
    (["env.robots=two"], "env.robots=two: allowed is a whole number."),
    (["env.ris.side=2.5"], "env.ris.side=2.5: allowed is a whole number."),
    (["env.robots=null"], "env.robots=null: allowed is a whole number."),
    (["env.reward.goal=much"], "env.reward.goal=much: allowed is a number."),
    (["run.figures=maybe"], "run.figures=maybe: allowed is true or false."),
    (["agent.hidden=64"], "agent.hidden=64: allowed is a list"),
    (["train.max_ticks=soon"], "train.max_ticks=soon: allowed is a whole number, or null."),
    (["env.robots=???"], "env.robots=???: allowed is a whole number."),
    (["federation.link.tls=word"], "federation.link.tls=word: allowed is true or false, or null."),
    (["run.dir=a${nothing}"], "Interpolation key 'nothing' not found"),
    # A wrong choice.
    (["env=warehouse"], "env=warehouse: allowed is one of default."),
    (["strategy=median"], "strategy=median: allowed is one of bulyan, fedadam, "),
    (["runtime=cluster"], "runtime=cluster: allowed is one of "),
    (["experiment=huge"], "experiment=huge: allowed is one of "),
    (["env.power.resolve=ask"], "env.power.resolve=ask: allowed is one of project, residual, zero"),
    # A wrong value.
    (["seed=-1"], "seed=-1: allowed is a number of at least 0."),
    (["train.episodes=0"], "train.episodes=0: allowed is a number of at least 1."),
    (["train.max_ticks=0"], "train.max_ticks=0: allowed is a number of at least 1, or null."),
    (["federation.every=0"], "federation.every=0: allowed is a number from 1 to 1000000."),
    (["federation.windows_per_round=0"], "federation.windows_per_round=0: allowed is a number"),
    (["federation.link.port=70000"], "federation.link.port=70000: allowed is a number from 0 to"),
    (["federation.link.timeout_s=0"], "federation.link.timeout_s=0.0: allowed is a number from"),
    (["runtime.start_timeout_s=0"], "runtime.start_timeout_s=0.0: allowed is a number from 0.1"),
    (["evaluation.every=0"], "evaluation.every=0: allowed is a number of at least 1."),
    (["evaluation.episodes=0"], "evaluation.episodes=0: allowed is a number from 1 to 100000."),
    (["evaluation.epsilon=1.5"], "evaluation.epsilon=1.5: allowed is a number from 0 to 1."),
    (["env.robots=0"], "env.robots=0: allowed is a number from 1 to 64."),
    (["agent.discount.robot=1"], "agent.discount.robot=1.0: allowed is"),
    # A wrong combination.
    (["federation.clients=4"], "federation.clients=4: allowed is a number from 1 to env.robots=3"),
    (["env.robots=4", "env.power.levels=3"], "env.power.levels=3: allowed is at least env.robots"),
    (["env.ris.subsurfaces=7"], "env.ris.subsurfaces=7: allowed is a divisor of the 900 elements"),
    (["agent.batch_size=60000"], "agent.batch_size=60000: allowed is"),
    (["experiment=quick", "federation.clients=3"], "federation.clients=3: allowed is a number"),
    (["scheme.agents=none"], "scheme.agents=none: allowed is one of federated, centralized, "),
    (["scheme.phase=best"], "scheme.phase=best: allowed is one of learned, random, fixed, oracle."),
    (["scheme.robots=still"], "scheme.robots=still: allowed is one of learned, shortest_canonical"),
    (["baseline=branching", "scheme.heads=one"], "scheme.heads=one: allowed is own or shared."),
    (["scheme.heads=shared"], "scheme.heads=shared: allowed is own with scheme.agents=federated"),
    (["scheme.global_share=1"], "scheme.global_share=1.0: allowed is 0.1 here: only "),
    (["baseline=centralized", "scheme.global_share=-1"], "scheme.global_share=-1.0: allowed is a"),
    (["baseline=centralized", "env.robots=4"], "env.robots=4: allowed is fewer with "),
    (["baseline=centralized", "runtime=simulation"], "runtime.name=simulation: allowed is local"),
    (["baseline=branching", "strategy=krum"], "strategy.name=krum: allowed is none with "),
    (["baseline=branching", "scheme.phase=fixed"], "scheme.phase=fixed: allowed is learned with "),
    (
        ["baseline=branching", "env.state.order=gain"],
        "env.state.order=gain: allowed is index with scheme.agents=branching: it acts for robots by"
        " their index",
    ),
    (
        ["baseline=centralized", "env.robots=2", "env.state.order=gain"],
        "env.state.order=gain: allowed is index with scheme.agents=centralized",
    ),
    (["baseline=shortest_best", "runtime=simulation"], "runtime.name=simulation: allowed is local"),
    (["baseline=shortest_best", "scheme.phase=fixed"], "scheme.phase=fixed: allowed is oracle"),
    (["baseline=shortest_canonical", "scheme.phase=learned"], "scheme.phase=learned: allowed is "),
    (["scheme.power=dqn"], "scheme.power=dqn: allowed is one of robots, ap, search."),
    (["baseline=shortest_best", "scheme.power=search"], "scheme.power=search: allowed is robots "),
    (["baseline=shortest_canonical", "scheme.power=ap"], "scheme.power=ap: allowed is robots with"),
    (["baseline=oracle_phase", "scheme.power=ap"], "scheme.phase=oracle: allowed is learned with "),
    (["scheme.power=ap", "env.power.resolve=zero"], "env.power.resolve=zero: allowed is project "),
    (["scheme.power=ap", "env.power.levels=2"], "env.power.levels=2: allowed is at least env.ro"),
    (["scheme.power=ap", "env.power.levels=48", "env.robots=4"], "env.power.levels=48: allowed is"),
    (["scheme.power=search", "env.power.levels=40", "env.robots=5"], "env.power.levels=40: allow"),
    (["baseline=centralized", "scheme.power=ap", "env.power.levels=20"], "env.robots=3: allowed "),
    (["baseline=best"], "baseline=best: allowed is one of branching, "),
    # A wrong form.
    (["env.robots"], "'env.robots' is not of the form key=value."),
    (["+env.extra=1"], "'+env.extra=1': keys can be neither added nor deleted"),
    (["~env.robots"], "'~env.robots': keys can be neither added nor deleted"),
]  # fmt: skip


ALL_TO_ONE_PLACE = ("env.power.resolve=zero", "env.tasks.destination=common")

BASELINES: dict[str, dict[str, Any]] = {
    "none": {},
    "centralized": {"scheme.agents": "centralized", "strategy.name": "none"},
    "branching": {"scheme.agents": "branching", "strategy.name": "none"},
    "oma": {"env.access": "oma"},
    "oma_reallocate": {"env.access": "oma", "env.oma.share": "reallocate"},
    "qoe": {"env.metric": "qoe"},
    "independent": {"strategy.name": "none"},
    "literal_state": {"env.state.destination": "none"},
    "common_destination": {"env.tasks.destination": "common"},
    "no_ris": {"env.ris.side": 0},
    "random_phase": {"scheme.phase": "random"},
    "fixed_phase": {"scheme.phase": "fixed"},
    "oracle_phase": {"scheme.phase": "oracle"},
    "shortest_canonical": {"scheme.phase": "oracle", "scheme.robots": "shortest_canonical"},
    "shortest_best": {"scheme.phase": "oracle", "scheme.robots": "shortest_best"},
}
"""What each choice of the group changes beside the runtime, and all that it changes."""


@pytest.mark.parametrize("name", sorted(path.stem for path in FOLDER.glob("baseline/*.yaml")))
def test_a_baseline_changes_what_it_says_and_nothing_else(name):
    found = dataclasses.replace(compose([f"baseline={name}"]), runtime=Config().runtime)
    assert found == overridden(
        Config(), [f"{key}={value}" for key, value in BASELINES[name].items()]
    )


def test_a_joint_agent_for_too_many_robots_is_refused_with_their_number():
    with pytest.raises(ConfigError, match="1,327,104, and at most 100,000 are taken"):
        compose(["baseline=centralized", "env.robots=4"])
    assert compose(["baseline=centralized", "env.robots=3"]).env.robots == 3
    assert compose(["baseline=branching", "env.robots=64", *ALL_TO_ONE_PLACE])


def test_powers_that_are_too_many_are_refused_with_their_number(composed):
    with pytest.raises(ConfigError, match="170,016, and at most 100,000 are taken"):
        composed(["scheme.power=ap", "env.power.levels=24", "env.robots=5"])
    with pytest.raises(ConfigError, match=r"658,008 combinations .* at most 200,000 are searched"):
        composed(["scheme.power=search", "env.power.levels=40", "env.robots=5"])
    with pytest.raises(ConfigError, match="279,936 combinations"):
        composed(["scheme.power=search", "env.power.resolve=zero", "env.robots=7"])
    oma = ["env.access=oma", "env.power.levels=2", "env.robots=8"]
    central = ["runtime.name=local", "strategy.name=none"]
    for power in ("ap", "search"):
        assert composed([f"scheme.power={power}"]).scheme.power == power
        assert composed([f"scheme.power={power}", *oma])
        for agents, robots in (("centralized", 3), ("branching", 4)):
            given = [f"scheme.agents={agents}", f"env.robots={robots}"]
            assert composed([f"scheme.power={power}", *central, *given])
    assert composed(["scheme.power=search", "env.power.resolve=residual"])


@pytest.mark.parametrize(("overrides", "message"), MISTAKES, ids=lambda x: str(x)[:40])
def test_a_mistake_is_one_sentence_with_the_key_and_what_is_allowed(composed, overrides, message):
    with pytest.raises(ConfigError) as caught:
        composed(overrides)
    text = str(caught.value)
    assert text.startswith(message)
    assert "\n" not in text
    assert text.endswith((".", "?"))


def test_mistakes_of_several_keys_are_a_sentence_each():
    with pytest.raises(ConfigError) as caught:
        compose(["seed=-1", "env.robots=0", "agent.batch_size=0"])
    lines = str(caught.value).splitlines()
    assert [line.split("=")[0] for line in lines] == ["seed", "env.robots", "agent.batch_size"]


def test_the_command_lines_defaults_are_the_schemas_but_for_the_runtime():
    found = compose()
    assert found.runtime.name == "simulation"
    assert dataclasses.replace(found, runtime=Config().runtime) == Config()
    assert problems(found) == []


def test_an_override_changes_its_key_alone():
    found = compose(["env.ris.side=20", "agent.hidden=[32,16]"])
    expected = dataclasses.replace(
        compose(),
        env=dataclasses.replace(Config().env, ris=dataclasses.replace(Config().env.ris, side=20)),
        agent=dataclasses.replace(Config().agent, hidden=[32, 16]),
    )
    assert found == expected


def test_the_last_of_two_overrides_counts():
    assert compose(["env.robots=2", "env.robots=4"]).env.robots == 4


def test_null_lifts_a_limit():
    assert compose(["train.max_ticks=100", "train.max_ticks=null"]).train.max_ticks is None


def test_an_override_wins_over_its_experiment():
    found = compose(["experiment=quick", "env.robots=4"])
    assert found.env.robots == 4
    assert found.train.episodes == 40


@pytest.mark.parametrize("name", sorted(p.stem for p in (FOLDER / "experiment").glob("*.yaml")))
def test_every_experiment_composes_and_all_but_the_default_change_something(name):
    found = compose([f"experiment={name}"])
    assert problems(found) == []
    assert (found == compose()) == (name == "default")


@pytest.mark.parametrize(
    ("group", "name"),
    [
        (group, path.stem)
        for group in ("env", "agent", "strategy", "runtime")
        for path in sorted((FOLDER / group).glob("*.yaml"))
    ],
)
def test_every_choice_of_every_group_composes(group, name):
    needed = ["strategy.target=mine"] if name == "own" else []
    assert problems(compose([f"{group}={name}", *needed])) == []


def test_the_paper_to_the_letter():
    found = compose(["experiment=paper_literal"])
    assert found.env.state.destination == "none"
    assert found.env.power.resolve == "zero"
    assert (found.agent.discount.robot, found.agent.discount.ap) == (0.95, 0.95)
    assert found.agent.reward_scale == 1.0


def test_composing_twice_in_a_process_works_and_leaves_nothing_behind():
    assert compose(["env.robots=2"]) == compose(["env.robots=2"])
    assert compose().env.robots == 3


def test_a_mistake_changes_nothing_for_what_is_composed_after_it():
    own = ["strategy=own", "strategy.target=package:Class"]
    for _ in range(2):
        with pytest.raises(ConfigError, match="allowed is a mapping from words, such as"):
            compose([*own, "strategy.options=[1]"])
        assert compose([*own, "strategy.options={a: 1}"]).strategy.options == {"a": 1}


@pytest.mark.parametrize("group", ["strategy=krum", "strategy/dp=local", "experiment=best"])
def test_a_group_cannot_be_chosen_anew(group):
    with pytest.raises(ConfigError):
        overridden(compose(), [group])


def test_a_configuration_survives_its_yaml():
    found = compose(["experiment=paper_literal", "env.robots=4", "env.walls.segments=[[0,1,2,3]]"])
    assert from_yaml(to_yaml(found)) == found


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("- 1\n- 2\n", "the configuration is no mapping"),
        ("3", "the configuration is no mapping"),
        ("env:\n  robotz: 3\n", "robotz"),
        ("env:\n  robots: many\n", "many"),
        ("agent: ${nope}\n", "Interpolation key 'nope' not found"),
        ("agent: 3\n", "AgentConfig. value: 3"),
        ("env:\n  robots: 0\n", "env.robots=0: allowed is a number from 1 to 64."),
    ],
)
def test_a_file_of_another_schema_is_refused(text, message):
    with pytest.raises(ConfigError, match=message) as caught:
        from_yaml(text)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "stored",
    [
        "dueling: false",
        "n_step: 1",
        "priority: {alpha: 0.0, beta: 0.5}",
        "priority: {beta: 0.4}",
        "factored: false",
    ],
)
def test_a_key_that_was_taken_out_is_passed_over_where_it_was_off(stored):
    text = to_yaml(Config())
    assert from_yaml(text.replace("agent:\n", f"agent:\n  {stored}\n", 1)) == from_yaml(text)


@pytest.mark.parametrize("stored", ["dueling: true", "n_step: 3", "priority: {alpha: 0.6}"])
def test_a_key_that_was_taken_out_is_refused_where_it_was_on(stored):
    text = to_yaml(Config()).replace("agent:\n", f"agent:\n  {stored}\n", 1)
    with pytest.raises(ConfigError, match=r"^agent\.\w+ was taken out: the last commit with it is"):
        from_yaml(text)


def test_a_run_cannot_be_changed_in_place():
    config = compose()
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.seed = 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        config.federation.link.port = 1


@pytest.fixture(scope="module")
def best():
    return compose(["experiment=best"])


@pytest.mark.parametrize("robots", [1, 2, 3, 4, 6, 8, 16])
def test_the_best_is_for_any_number_of_robots(best, robots):
    levels = ["env.power.levels=16"] if robots > 6 else []
    found = overridden(best, [f"env.robots={robots}", *levels])
    assert found.scheme.agents == "federated"
    assert found.scheme.power == "search"
    assert found.strategy.name != "none"
    assert found.train.worlds > 1
    assert found.train.max_ticks
    assert found.agent.epsilon.ticks < found.train.max_ticks
