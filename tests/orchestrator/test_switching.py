"""Switching goes on where true states say so, or where a goal's steps are used up; what confidences are about."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from freerein.types.common import Goal, Image, ModelRef, Observation, Timing
from freerein.types.imitation import ActBatchRequest, ActBatchResponse, ActRequest, ActResponse
from freerein_orchestrator.envs.policies import BatchPolicy, PolicyHandle, PolicySession, ServedPolicy
from freerein_orchestrator.envs.switching import IsAt, Switching
from freerein_orchestrator.kinds.evaluate.landmarks import asked_about

PLACES = ((1.0, 2.0, 3.0), (5.0,))
"""Where the goals of two environments are, on a line."""


def image(place: float) -> Image:
    return Image("raw_gray8", 1, 1, bytes([int(place)]))


def is_at(states: npt.NDArray[np.float64], index: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
    there = [places[n] for places, n in zip(PLACES, index.tolist(), strict=True)]
    return np.asarray(states[:, 0] == there)


def pursued(*positions: tuple[float, float], max_steps: int, is_at: IsAt | None = is_at) -> list[list[int]]:
    """Returns how many goals are over before each action, given both positions then."""
    goals = [[Goal((image(place),)) for place in places] for places in PLACES]
    switching = Switching(goals, is_at, max_steps=max_steps)
    over = []
    for each in positions:
        switching.tell(np.array(each)[:, None])
        over.append(switching.index.tolist())
        for places, index, goal in zip(PLACES, switching.index.tolist(), switching.goals, strict=True):
            assert [each.data[0] for each in goal.images] == [places[min(index, len(places) - 1)]] * 2
    return over


def test_the_next_goal_is_given_where_the_present_one_is_truly_reached() -> None:
    positions = [(0, 5), (1, 5), (1, 5), (2, 5), (2, 0)]
    assert pursued(*positions, max_steps=9) == [[0, 1], [1, 1], [1, 1], [2, 1], [2, 1]]


def test_a_goal_is_given_up_after_its_steps() -> None:
    positions = [(0, 0)] * 6
    assert pursued(*positions, max_steps=2) == [[0, 0], [0, 0], [1, 1], [1, 1], [2, 1], [2, 1]]


def test_a_goal_has_its_steps_though_the_robot_is_there_where_steps_alone_count() -> None:
    positions = [(1, 5)] * 4
    assert pursued(*positions, max_steps=1, is_at=None) == [[0, 0], [1, 1], [2, 1], [3, 1]]


def says_what_it_was_asked(request: ActBatchRequest) -> ActBatchResponse:
    """Answers as the imitation service: the confidence is the place of the goal asked about, which it then ends."""
    replies = []
    for each in request.requests:
        index = len(each.state)
        place, goals = each.goal.images[index].data[0], len(each.goal.images)
        actions, state = np.ones((int(index + 1 < goals), 1), np.float32), b"x" * (index + 1)
        replies.append(ActResponse(actions, float(place), index + 1, False, 1.0, state, ModelRef(), Timing()))
    return ActBatchResponse(tuple(replies))


def served_policy() -> PolicyHandle:
    imitation: Any = SimpleNamespace(act_batch=says_what_it_was_asked)

    def start(session: PolicySession) -> ServedPolicy:
        requests = [ActRequest(Observation(), goal) for goal in session.goals]
        return ServedPolicy(imitation, requests, np.zeros((1, 1), np.float32))

    return PolicyHandle(start, {})


def check_asked(acting: BatchPolicy, switching: Switching | None) -> None:
    """Checks that each confidence is the place of the landmark asked about, while the robots go along the line."""
    index, said = [], []
    for t in range(7):
        if switching:
            switching.tell(np.array([[float(t)], [0]]))
        output = acting.act({"front": np.zeros((2, 4, 4, 3), np.uint8)}, np.full(2, t == 0))
        index.append(output.goal_index)
        said.append(output.goal_confidence)
    for env, places in enumerate(PLACES):
        asked = asked_about(np.array(index)[:, env], is_switched=switching is not None)
        active = asked < len(places)
        assert not active[-1]
        assert np.array(said)[active, env].tolist() == [places[n] for n in asked[active]]


@pytest.mark.parametrize("judge", [is_at, None])
def test_a_confidence_is_about_the_landmark_that_a_switched_policy_is_given(judge: IsAt | None) -> None:
    switching = Switching([[Goal((image(place),)) for place in places] for places in PLACES], judge, max_steps=2)
    policy = switching.switch(served_policy())
    check_asked(policy.start(PolicySession("", 0, switching.goals)), switching)


def test_a_confidence_is_about_the_landmark_before_the_policy_itself_goes_on() -> None:
    goals = [Goal(tuple(image(place) for place in places)) for places in PLACES]
    check_asked(served_policy().start(PolicySession("", 0, goals)), None)
