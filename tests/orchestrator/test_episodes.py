"""Episodes of a policy: their seeds, states of simulations that diverged, and experts of episodes that follow."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from freerein.clients import Channel, SimClient, SyncClient
from freerein.clients.tasks import find_task
from freerein.errors import InvalidInput
from freerein.types.common import Goal, ModelRef, Observation, Timing
from freerein.types.imitation import ActBatchRequest, ActBatchResponse, ActRequest, ActResponse
from freerein.types.sim import CreateSessionRequest, DrawRecipesRequest, ExpertActionsRequest, ResetRequest, Truth
from freerein_orchestrator.envs.episodes import derive_seed, finite_truth, open_session
from freerein_orchestrator.envs.policies import PolicySession, ServedPolicy, expert_policy
from freerein_orchestrator.kinds.distill.rollouts import RolloutPlan


def truth(state: list[list[float]]) -> Truth:
    count = len(state)
    return Truth(np.array(state), np.arange(count, dtype=np.float32), np.ones(count, np.bool_))


def test_a_state_that_diverged_is_that_before_it_and_all_else_is_as_the_service_says() -> None:
    before, after = truth([[1, 2], [3, 4], [5, 6]]), truth([[7, np.nan], [8, 9], [np.inf, 0]])

    found = finite_truth(after, before)

    assert found is not None
    assert found.state.tolist() == [[1, 2], [8, 9], [5, 6]]
    np.testing.assert_array_equal(found.reward, after.reward)
    np.testing.assert_array_equal(found.success, after.success)
    assert finite_truth(None, None) is None


def test_rounds_of_all_teachers_and_iterations_have_seeds_of_their_own() -> None:
    rounds = list(RolloutPlan(rollouts=60, num_envs=10, stochastic=False, seed=0, keep="all").rounds(4))
    keys = [(0, each.teacher, each.first, *then) for each in rounds for then in ((), (1,), (2,))]
    assert len({derive_seed(*key) for key in keys}) == len(keys)
    assert derive_seed(0, 1, 2) == derive_seed(0, 1, 2, 0)  # so that no iteration is number 0


@pytest.mark.e2e
def test_an_expert_is_asked_for_its_goal_in_the_first_episode_alone(
    start_module_service: Callable[..., Any], wait_until: Callable[..., float]
) -> None:
    service = start_module_service("freerein_sim", FREEREIN_SIM_WORKERS="1")
    wait_until(service.is_ready, 300)
    request = CreateSessionRequest("blocks", num_envs=2, seed=0, privileged=True, conditions=("blocks-2",))
    drawn = DrawRecipesRequest("blocks", 2, 0, min_skills=2, max_skills=2, conditions=("blocks-2",))
    with SyncClient(SimClient(Channel(service.address))) as sim, open_session(sim, request) as session:
        recipes = sim.draw_recipes(drawn).recipes
        goals = [Goal(recipe=recipe.skills) for recipe in recipes]
        expert = expert_policy(sim, find_task(sim, "blocks")).start(PolicySession(session, 0, goals))
        sim.reset(ResetRequest(session, recipes=recipes))
        expert.act({}, np.ones(2, np.bool_))

        sim.reset(ResetRequest(session, envs=(0,)))  # as where its episode ends: other blocks are on show
        with pytest.raises(InvalidInput, match="is hidden"):
            sim.expert_actions(ExpertActionsRequest(session, recipes))
        output = expert.act({}, np.array([True, False]))
        assert output.goal_index is not None
        assert output.goal_index.tolist() == [0, 0]
        expert.act({}, np.zeros(2, np.bool_))


def test_a_served_policy_is_asked_of_first_episodes_alone() -> None:
    asked: list[bytes] = []

    def act_batch(request: ActBatchRequest) -> ActBatchResponse:
        asked.extend(each.state for each in request.requests)
        reply = ActResponse(np.ones((1, 2), np.float32), 0.5, 0, False, 1.0, b"later", ModelRef(), Timing())
        return ActBatchResponse((reply,) * len(request.requests))

    frames = {"front": np.zeros((2, 4, 4, 3), np.uint8)}
    hold = np.zeros((1, 2), np.float32)
    imitation: Any = SimpleNamespace(act_batch=act_batch)
    policy = ServedPolicy(imitation, 2 * [ActRequest(Observation(), Goal())], hold)
    starts = np.array([[1, 1], [0, 0], [0, 1], [0, 0]], np.bool_)
    actions = [policy.act(frames, each).actions[:, 0].tolist() for each in starts]
    assert actions == [[1, 1], [1, 1], [1, 0], [1, 0]]
    assert asked == [b"", b"", b"later", b"later", b"later", b"later"]
