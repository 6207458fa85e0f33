"""A ppo run's policy as a served model: it acts as the stored one does, for its own goal only."""

import asyncio
import json
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from freerein.errors import FailedPrecondition, InvalidInput, NotFound
from freerein.learning import weights
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.actor_critic.policy_files import save_in_distribution, save_policy
from freerein.model_store import ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types.common import Goal, Image, ModelRef, Observation
from freerein.types.imitation import ActRequest, GetSpecRequest, PublishPolicyRequest
from freerein_imitation.core import ActService, PolicyRunner, PublishService
from freerein_imitation.methods import METHODS
from freerein_orchestrator.rl.network_policy import NetworkPolicy
from freerein_orchestrator.rl.visited_frames import fit_in_distribution

RUN = "0" * 32
SIZE = (12, 12, 3)
FRAMES = np.random.default_rng(0).integers(256, size=(9, *SIZE), dtype=np.uint8)
VIEWS = ((3, "left"), (0, "front"))
"""In any order: the first channel of each camera, and its name."""

GOAL = "a red block on top of a yellow block"
CARD: dict[str, Any] = {
    "task": "blocks.red-on-top-of-yellow",
    "goal_text": GOAL,
    "camera": "front",
    "action": {"size": 3, "choices": 0, "names": ["x", "y", "z"], "unit": "m", "scale": [0.1, 0.1, 0.1]},
    "control_dt_s": 0.04,
    "max_episode_steps": 50,
    "supervision": "goal text",
    "privileged": False,
}


def make(**changes: Any) -> ActorCritic:
    """Returns a network with random weights."""
    values: dict[str, Any] = {"action_size": 3, "feature_size": 8, "hidden_size": 8, "recurrent": True, **changes}
    network = ActorCritic(ActorCriticSpec(height=SIZE[0], width=SIZE[1], channels=SIZE[2], **values))
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    for parameter in network.actor.parameters():
        parameter.data *= 5  # the last layer's are small: actions would differ little
    shape = network.spec.observation_shape
    network.calibrate(torch.from_numpy(np.resize(FRAMES, (len(FRAMES), *shape))))
    return network.eval()


def leave(data_dir: Path, network: ActorCritic, frames: Any = FRAMES, **changes: Any) -> Path:
    """Leaves what a finished run does; returns its folder."""
    artifacts = data_dir / "runs" / RUN / "artifacts"
    artifacts.mkdir(parents=True)
    score = fit_in_distribution(torch.from_numpy(frames), num_envs=1, cameras=network.spec.cameras)
    save_in_distribution(score, artifacts)
    save_policy(network, artifacts, card={**CARD, **changes})
    return artifacts


def names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()]


class Served:
    """The two cores around one store."""

    def __init__(self, data_dir: Path) -> None:
        store = ModelStore(data_dir / "models" / "imitation")
        models = ModelCache(store, lambda folder: METHODS.load(folder, "cpu"), fit_command="none")
        self.batcher = Batcher(PolicyRunner().run_batch, queue=8, batch=8, metrics=Metrics())
        self.acts = ActService(models, self.batcher)
        self.publishes = PublishService(models, data_dir)

    async def publish(self, name: str = "") -> ModelRef:
        return (await self.publishes.publish_policy(PublishPolicyRequest(RUN, name))).model


@pytest.fixture
async def served(tmp_path: Path) -> AsyncIterator[Served]:
    found = Served(tmp_path)
    yield found
    found.batcher.close()


def seen(frame: Any) -> Observation:
    return Observation((Image("raw_rgb8", *SIZE[:2], frame.tobytes(), "front"),))


@pytest.mark.parametrize(("repeat", "recurrent"), [(1, False), (1, True), (2, True), (3, False)])
async def test_the_served_policy_acts_as_the_stored_one(
    served: Served, tmp_path: Path, repeat: int, recurrent: bool
) -> None:
    network = make(recurrent=recurrent, action_repeat=repeat)
    leave(tmp_path, network)
    model, stored = await served.publish("stacking"), NetworkPolicy(network)
    state, executed = b"", None
    for step, frame in enumerate(FRAMES):
        request = ActRequest(seen(frame), Goal(text=GOAL), executed, state, model=model)
        reply = await served.acts.act(request)
        expected = stored.act(frame[None], np.array([step == 0]))
        np.testing.assert_allclose(reply.actions, expected, atol=1e-6)
        state, executed = reply.state, reply.actions
        assert reply.goal_reached is None
        assert 0 <= reply.in_distribution <= 1


@pytest.mark.parametrize(("repeat", "recurrent"), [(1, True), (2, False)])
async def test_a_served_policy_keeps_earlier_frames_of_its_cameras_in_its_state(
    served: Served, tmp_path: Path, repeat: int, recurrent: bool
) -> None:
    network = make(recurrent=recurrent, action_repeat=repeat, cameras=2, frame_stack=3, gray=True)
    frames = np.concatenate([FRAMES, FRAMES[::-1]], axis=-1)
    leave(tmp_path, network, frames, cameras=["front", "left"])
    model, stored = await served.publish("stacking"), NetworkPolicy(network)
    spec = await served.acts.get_spec(GetSpecRequest(model))
    assert [(each.name, each.height, each.channels) for each in spec.cameras] == [("front", 12, 3), ("left", 12, 3)]
    with pytest.raises(InvalidInput, match="each camera: front, left; got 1, none of left"):
        await served.acts.act(ActRequest(seen(FRAMES[0]), Goal(text=GOAL), model=model))
    state, executed = b"", None
    for step, frame in enumerate(frames):
        views = [Image("raw_rgb8", *SIZE[:2], frame[..., at : at + 3].tobytes(), name) for at, name in VIEWS]
        reply = await served.acts.act(
            ActRequest(Observation(tuple(views)), Goal(text=GOAL), executed, state, model=model)
        )
        np.testing.assert_allclose(reply.actions, stored.act(frame[None], np.array([step == 0])), atol=1e-6)
        state, executed = reply.state, reply.actions
    assert len(state) < 2 * 2 * 12 * 12 + 150  # of two earlier frames a byte per pixel


async def test_an_action_is_held_for_as_many_control_steps_whatever_is_observed_of_them(
    served: Served, tmp_path: Path
) -> None:
    network = make(recurrent=False, action_repeat=3)
    leave(tmp_path, network)
    model, state, acted = await served.publish(), b"", []
    for frame, steps in zip(FRAMES, (0, 2, 1, 5, 1), strict=False):
        executed = np.zeros((steps, 3), np.float32)
        reply = await served.acts.act(ActRequest(seen(frame), Goal(text=GOAL), executed, state, model=model))
        state = reply.state
        acted.append(reply.actions)
    chosen = [NetworkPolicy(network).act(frame[None], np.ones(1, np.bool_)) for frame in FRAMES]
    np.testing.assert_allclose(acted, [chosen[at] for at in (0, 0, 2, 3, 3)], atol=1e-6)


async def test_a_model_is_named_after_the_task_and_says_what_it_is(served: Served, tmp_path: Path) -> None:
    leave(tmp_path, make())
    model = await served.publish()
    assert (model.name, await served.publish()) == (CARD["task"], model)
    spec = await served.acts.get_spec(GetSpecRequest(ModelRef(model.name)))
    assert (spec.model, spec.goal_form, spec.goal_texts) == (model, "text", (GOAL,))
    assert (spec.max_steps_per_goal, spec.control_dt_s, spec.action.names) == (50, 0.04, ("x", "y", "z"))
    card = json.loads((tmp_path / "models" / "imitation" / model.name / model.version / "card.json").read_bytes())
    assert (card["data"], card["supervision"], card["privileged"]) == (f"ppo run {RUN}", "goal text", False)


async def test_only_the_texts_that_it_was_trained_for_are_goals(served: Served, tmp_path: Path) -> None:
    leave(tmp_path, make())
    model = await served.publish()
    reply = await served.acts.act(ActRequest(seen(FRAMES[0]), Goal(text=GOAL), model=model))
    for same in (" A red block  on top of a yellow block!", "Please put the red cube onto the yellow one..."):
        await served.acts.act(ActRequest(seen(FRAMES[0]), Goal(text=same), state=reply.state, model=model))
    await served.acts.act(ActRequest(seen(FRAMES[0]), Goal(text=GOAL), state=reply.state, model=model))  # the same goal
    for other in ("a blue block", "do not put the red block on the yellow one", "a yellow block on top of a red block"):
        with pytest.raises(InvalidInput, match=f"what this policy was trained for: {GOAL}; got another text"):
            await served.acts.act(ActRequest(seen(FRAMES[0]), Goal(text=other), model=model))
    with pytest.raises(InvalidInput) as error:
        await served.acts.act(
            ActRequest(seen(FRAMES[0]), Goal(text="a red blok on top of a yellow block"), model=model)
        )
    assert error.value.hint.startswith(f"Hold the robot. Did you mean: {GOAL}?")


async def test_discrete_actions_are_served_too(served: Served, tmp_path: Path) -> None:
    action = {"size": 1, "choices": 4, "names": ["a", "b", "c", "d"], "unit": "", "scale": []}
    network = make(action_size=1, action_choices=4)
    leave(tmp_path, network, action=action, goal_text="")
    model = await served.publish("grid")
    reply = await served.acts.act(ActRequest(seen(FRAMES[0]), Goal(text=CARD["task"]), model=model))
    np.testing.assert_array_equal(reply.actions, NetworkPolicy(network).act(FRAMES[:1], np.ones(1, np.bool_)))
    assert reply.actions.dtype == np.int64


async def test_frames_unlike_the_visited_ones_are_told(served: Served, tmp_path: Path) -> None:
    leave(tmp_path, make())
    request = ActRequest(seen(np.zeros(SIZE, np.uint8)), Goal(text=GOAL), model=await served.publish())
    assert (await served.acts.act(request)).in_distribution < 1e-5


async def test_a_run_without_a_policy_is_refused(served: Served, tmp_path: Path) -> None:
    with pytest.raises(NotFound):
        await served.publish()
    (tmp_path / "runs" / RUN).mkdir(parents=True)
    with pytest.raises(FailedPrecondition, match="must be a ppo run that succeeded"):
        await served.publish()


@pytest.mark.parametrize("lost", ["action", "control_dt_s", "max_episode_steps"])
async def test_a_policy_of_an_earlier_version_is_refused(served: Served, tmp_path: Path, lost: str) -> None:
    leave(tmp_path, make(), **{lost: None})
    with pytest.raises(FailedPrecondition, match="actions and control rate"):
        await served.publish()


async def test_a_policy_without_a_score_is_refused_and_leaves_nothing(served: Served, tmp_path: Path) -> None:
    (leave(tmp_path, make()) / "in_distribution.safetensors").unlink()
    with pytest.raises(FailedPrecondition, match="score"):
        await served.publish()
    assert names(tmp_path) == ["runs"]


async def test_weights_that_were_changed_are_refused(served: Served, tmp_path: Path) -> None:
    artifacts = leave(tmp_path, make())
    data = bytearray((artifacts / "policy.safetensors").read_bytes())
    data[-1] ^= 1
    (artifacts / "policy.safetensors").write_bytes(data)
    with pytest.raises(InvalidInput, match="sha256"):
        await served.publish()


async def test_two_at_once_are_one_model(served: Served, tmp_path: Path) -> None:
    leave(tmp_path, make())
    first, second = await asyncio.gather(served.publish("twice"), served.publish("twice"))
    assert first == second
