"""Runs of kind `evaluate`, with the real sim service."""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from freerein.atomic_files import write_atomic
from freerein.errors import InvalidInput, NotFound
from freerein.learning import weights
from freerein.learning.actor_critic.networks import ActorCriticSpec
from freerein.learning.actor_critic.policy_files import save_policy
from freerein.video.reader import open_video
from freerein_orchestrator.kinds import KINDS
from freerein_orchestrator.rl.initial_network import init_network

pytestmark = pytest.mark.e2e
RANDOM = {"task": "grid", "policy": "random", "episodes": 4, "num_envs": 2, "seed": 1}


@pytest.fixture
def evaluation(new_run: Callable[..., Any], tmp_path: Path, mortal_sim: Any) -> Callable[..., Any]:
    """A function that makes a run of a configuration."""
    sim = {"FREEREIN_SIM_ADDRESS": mortal_sim.address}
    return lambda config, **environ: new_run(tmp_path, "evaluate", config, **sim, **environ)


@pytest.fixture(scope="module")
def undisturbed(new_run: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory, mortal_sim: Any) -> Any:
    """A run of random actions."""
    data_dir = tmp_path_factory.mktemp("undisturbed")
    run = new_run(data_dir, "evaluate", RANDOM, FREEREIN_SIM_ADDRESS=mortal_sim.address)
    assert run.do()
    return run


def test_a_result_is_the_oracle_s_with_its_interval_and_says_that_it_is_privileged(undisturbed: Any) -> None:
    run = undisturbed
    result = run.artifact("result.json")
    assert (result["privileged"], result["policy"], result["episodes"]) == (True, "random", 4)
    assert [len(result[name]) for name in ("returns", "lengths", "successes")] == [4, 4, 4]
    assert result["figures"]["return_mean"]["value"] == pytest.approx(np.mean(result["returns"]))
    mean = result["figures"]["return_mean"]
    assert mean["low"] <= mean["value"] <= mean["high"]
    assert [row["step"] for row in run.rows] == [1, 2, 3, 4]
    assert run.rows[-1]["success_rate"] == result["figures"]["success_rate"]["value"]
    with open_video(run.folder / "artifacts" / "policy.mp4") as video:
        assert sum(1 for _ in video) == result["lengths"][0] + 1


@pytest.mark.fault("O2")
def test_an_evaluation_that_is_stopped_and_whose_sim_is_killed_comes_to_the_same_result(
    evaluation: Callable[..., Any], undisturbed: Any, mortal_sim: Any
) -> None:
    run = evaluation(RANDOM)
    replacing, asked = mortal_sim.replaced_at(20, since=lambda: run.rows), itertools.count()  # in the second round
    assert not run.do(stop=lambda: replacing() or (replacing.is_done and next(asked) == 10))
    assert 0 < len(run.rows) < 4
    assert run.do()
    assert run.artifact("result.json") == undisturbed.artifact("result.json")
    assert run.rows == undisturbed.rows


def test_a_policy_of_a_ppo_run_acts_the_same_each_time(evaluation: Callable[..., Any], tmp_path: Path) -> None:
    spec = ActorCriticSpec(
        height=33, width=30, channels=3, action_choices=5, feature_size=8, hidden_size=8, recurrent=True
    )
    generator = torch.Generator().manual_seed(0)
    network = init_network(spec, generator)
    network.calibrate(torch.randint(256, (8, *spec.observation_shape), dtype=torch.uint8, generator=generator))
    save_policy(network, tmp_path / "runs" / "trained" / "artifacts", card={"task": "grid", "camera": "top"})
    runs = [evaluation(RANDOM | {"episodes": 2, "policy": {"run": "trained", "stochastic": True}}) for _ in range(2)]
    for run in runs:
        run.check()
        assert run.do()
    results = [run.artifact("result.json") for run in runs]
    assert results[0] == results[1]
    assert (results[0]["policy"], results[0]["sha256"]) == ("ppo", weights.sha256(network))

    elsewhere = evaluation(RANDOM | {"task": "blocks.red-left-of-green", "policy": {"run": "trained"}})
    with pytest.raises(InvalidInput, match="this task has camera front with 3 channels"):
        elsewhere.do()


@pytest.mark.parametrize(
    "policy",
    [
        "nobody",
        {},
        {"run": "a", "model": "b"},
        {"run": 3},
        {"model": "skills", "goal": "a"},
        {"stored": 1},
    ],
)
def test_an_invalid_policy_is_refused(policy: Any) -> None:
    with pytest.raises(InvalidInput) as error:
        KINDS["evaluate"].parse(RANDOM | {"policy": policy})
    assert error.value.field.startswith("config")


def test_the_expert_s_return_stands_beside_a_policy_s_and_both_are_split_by_how_episodes_began(
    evaluation: Callable[..., Any],
) -> None:
    goal = {"task": "blocks.red-left-of-green", "episodes": 4, "num_envs": 4, "conditions": ["start-unseen"]}
    run = evaluation(RANDOM | goal)
    assert run.do()
    result = run.artifact("result.json")
    figures, in_order = result["figures"], np.array(result["starts"]["start/in-order"])
    assert result["conditions"] == ["start-unseen"]
    assert 0 < in_order.sum() < 4
    assert figures["expert_return_mean"]["value"] == pytest.approx(np.mean(result["expert_returns"]))
    assert figures["expert_return_mean"]["value"] > 60
    for name, values in (("return_mean", result["returns"]), ("expert_return_mean", result["expert_returns"])):
        assert figures[f"{name}.in-order"]["value"] == pytest.approx(np.mean(np.array(values)[in_order]))
        assert figures[f"{name}.not-in-order"]["value"] == pytest.approx(np.mean(np.array(values)[~in_order]))
    assert run.rows[-1]["expert_return_mean.in-order"] == figures["expert_return_mean.in-order"]["value"]


def test_conditions_that_a_task_lacks_end_an_evaluation_with_those_that_it_has(evaluation: Callable[..., Any]) -> None:
    with pytest.raises(InvalidInput) as error:
        evaluation(RANDOM | {"conditions": ["fog"]}).do()
    assert (error.value.field, "blur" in error.value.hint) == ("conditions", True)


def test_a_baseline_runs_the_same_episodes_and_gives_the_gain(evaluation: Callable[..., Any]) -> None:
    config = RANDOM | {"policy": "expert", "episodes": 2}
    run, random = evaluation(config | {"baseline": "random"}), evaluation(config | {"policy": "random"})
    run.check()
    assert run.do()
    assert random.do()
    result = run.artifact("result.json")
    assert result["baseline"] == {"policy": "random"}
    assert result["baseline_returns"] == random.artifact("result.json")["returns"]
    figures = result["figures"]
    assert figures["return_mean"]["baseline"] == figures["baseline_return_mean"]["value"]
    gains = np.subtract(result["returns"], result["baseline_returns"])
    assert figures["gain"]["value"] == pytest.approx(gains.mean())
    assert gains.min() <= figures["gain"]["low"] <= figures["gain"]["high"] <= gains.max()
    assert (figures["gain"]["baseline"], figures["success_rate"]["value"]) == (0, 1)
    assert random.artifact("result.json")["figures"]["success_rate"]["value"] < 1


@pytest.mark.parametrize("baseline", ["nobody", {}, {"run": "a", "model": "b"}])
def test_an_invalid_baseline_is_refused(baseline: Any) -> None:
    with pytest.raises(InvalidInput):
        KINDS["evaluate"].parse(RANDOM | {"baseline": baseline})


def test_a_missing_run_and_one_without_a_policy_are_refused(evaluation: Callable[..., Any]) -> None:
    for name in ("nothing", ".."):
        with pytest.raises(InvalidInput):
            evaluation(RANDOM | {"policy": {"run": name}}).do()
    bare = evaluation(RANDOM)
    with pytest.raises(InvalidInput, match="this one has not"):
        evaluation(RANDOM | {"policy": {"run": bare.folder.name}}).do()
    with pytest.raises(NotFound, match="got `nothing`"):
        evaluation(RANDOM | {"task": "nothing"}).do()


def test_the_model_of_a_run_counts_once_the_run_has_succeeded_and_that_of_a_step_once_its_kind_makes_one(
    evaluation: Callable[..., Any], tmp_path: Path
) -> None:
    folder = tmp_path / "runs" / ("a" * 32)
    write_atomic(folder / "model.json", b'{"name": "inner", "version": ""}')
    chosen = evaluation(RANDOM | {"policy": {"run": folder.name}})
    for state in ("running", "failed"):
        (folder / "events.jsonl").write_text(f'{{"state": "{state}"}}\n')
        with pytest.raises(InvalidInput, match="must have made a policy"):
            chosen.check()
    (folder / "events.jsonl").write_text('{"state": "failed"}\n{"state": "succeeded"}\n')
    chosen.check()

    step = evaluation(RANDOM | {"policy": {"run": "step"}})
    for kind in ("ppo", "fit of imitation", "distill"):
        step.check(step=kind)
    with pytest.raises(InvalidInput, match="ppo or fit of imitation or distill; step is of the kind label"):
        step.check(step="label")


def test_a_stored_policy_can_be_evaluated(evaluation: Callable[..., Any]) -> None:
    task = {"task": "blocks.yellow-left-of-green", "episodes": 1}
    stored = evaluation(task | {"policy": {"stored": "yellow-left-of-green"}})
    stored.check()
    assert stored.do()
    result = stored.artifact("result.json")
    assert result["policy"] == "ppo"
    assert result["model"]["name"] == "yellow-left-of-green"
    assert result["model"]["version"]
    with pytest.raises(InvalidInput):
        evaluation(task | {"policy": {"stored": "nothing"}}).check()
