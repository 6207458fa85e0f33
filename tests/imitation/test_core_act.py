"""`Act` and `GetSpec`: invalid fields are refused by name, and calls are stateless."""

import asyncio
import io
from dataclasses import replace
from typing import Any

import numpy as np
import PIL.Image
import pytest
from tests.faults import control_robot as robots
from tests.faults import faulty_policy as policies

from freerein.errors import FailedPrecondition, InvalidInput, ServiceError
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types.common import Camera, Goal, Image, ModelRef, Observation
from freerein.types.imitation import ActBatchRequest, ActRequest, GetSpecRequest
from freerein.types.learning import ActivateModelRequest
from freerein_imitation.core import ActService, PolicyRunner
from freerein_imitation.core.inputs import parse_frames, parse_goal, parse_robot_state
from freerein_imitation.methods import METHODS


def encoded(image: Image, format_: str = "PNG", mode: str = "RGB") -> Image:
    buffer = io.BytesIO()
    pixels = np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, 3)
    PIL.Image.fromarray(pixels).convert(mode).save(buffer, format_)
    return Image("png", 0, 0, buffer.getvalue())


async def test_the_spec_says_what_a_robot_must_send_and_mean(core: Any) -> None:
    spec = await core.act.get_spec(GetSpecRequest())
    assert (spec.cameras, spec.action, spec.goal_form) == (robots.CAMERAS, robots.ACTION, "images")
    assert (spec.horizon, spec.control_dt_s, spec.model) == (3, 0.02, core.versions[0])


async def test_calls_chained_by_their_states_are_one_history(core: Any) -> None:
    oracle = await robots.Oracle.of(policies.FaultyPolicy(policies.SEEDS[0]), 3, 5)
    state, did, indices = b"", None, []
    for seq, brightness in enumerate((1, 3, 4, 5, 6)):
        reply = await core.act.act(robots.asked(brightness, 3, 5, did=did, state=state))
        expected = await oracle.answer(robots.seen(seq, brightness, did=did))
        np.testing.assert_allclose(reply.actions, expected.actions, atol=1e-5)
        assert reply.in_distribution == expected.in_distribution == pytest.approx(1 / (1 + brightness))
        state, did = reply.state, reply.actions[0] if len(reply.actions) else None
        indices.append((reply.goal_index, reply.goal_reached, len(reply.actions)))
        assert (reply.done, reply.done_by) == (("yes", "policy") if reply.goal_reached else ("no", None))
    assert indices == [(0, False, 3), (1, False, 3), (1, False, 3), (2, True, 0), (2, True, 0)]


@pytest.mark.parametrize("name", ["skills", "default"])
async def test_equal_calls_for_several_robots_have_equal_replies_to_the_bit_whatever_else_is_asked(name: str) -> None:
    store, ref, rng = ModelStore(CLONE_MODELS / "imitation"), ModelRef(name), np.random.default_rng(0)
    models: Any = ModelCache(store, lambda folder: METHODS.load(folder, "cpu"), fit_command="none")
    batcher = Batcher(PolicyRunner().run_batch, queue=64, batch=8, metrics=Metrics())
    act = ActService(models, batcher)
    spec = await act.get_spec(GetSpecRequest(ref))

    def seen() -> tuple[Image, ...]:
        sizes = [(each.name, each.height, each.width, each.channels) for each in spec.cameras]
        return tuple(
            Image(
                "raw_rgb8" if channels == 3 else "raw_gray8",
                height,
                width,
                rng.bytes(height * width * channels),
                camera,
            )
            for camera, height, width, channels in sizes
        )

    state = np.zeros(spec.robot_state_size, np.float32) if spec.robot_state_size else None
    goal = Goal(recipe=spec.skills[:2]) if spec.skills else Goal(seen())
    robots_ask = tuple(ActRequest(Observation(seen(), state), goal, model=ref) for _ in range(20))

    async def answers() -> list[tuple[bytes, bytes]]:
        return [
            (each.actions.tobytes(), each.state)
            for each in (await act.act_batch(ActBatchRequest(robots_ask))).responses
        ]

    first = await answers()
    others = [asyncio.create_task(act.act(each)) for each in robots_ask[:10]]
    assert await answers() == first
    await asyncio.gather(*others)
    batcher.close()


async def test_an_encoded_image_is_the_same_goal_and_the_same_observation(core: Any) -> None:
    request = robots.asked(1, 3, 5)
    first = await core.act.act(request)
    files = replace(
        request,
        observation=Observation((encoded(request.observation.images[0]),)),
        goal=Goal(tuple(map(encoded, request.goal.images))),
        state=first.state,
    )
    second = await core.act.act(files)
    again = await core.act.act(replace(request, state=first.state))
    assert second.state == again.state


async def test_a_goal_image_that_is_sent_again_is_not_encoded_again(core: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    encode, encoded_goals = policies.FaultyPolicy.encode_goals, []

    def counted(policy: Any, goals: Any) -> Any:
        encoded_goals.extend(goals["front"][:, 0, 0, 2].tolist())
        return encode(policy, goals)

    monkeypatch.setattr(policies.FaultyPolicy, "encode_goals", counted)
    for request in (robots.asked(1, 3), robots.asked(2, 3), robots.asked(1, 5)):
        await core.act.act(request)
        files = tuple(map(encoded, request.goal.images))  # the same pixels in another encoding
        await core.act.act(replace(request, goal=Goal(files)))
    assert encoded_goals == [3, 5]


async def test_a_state_of_a_version_that_is_no_longer_active_says_what_to_name(core: Any) -> None:
    first = await core.act.act(robots.asked(1, 3))
    await core.models.activate_model(ActivateModelRequest("default", core.versions[1].version))
    with pytest.raises(FailedPrecondition) as error:
        await core.act.act(robots.asked(1, 3, state=first.state))
    assert first.model.version in error.value.detail
    assert "Name in `model`" in error.value.hint
    went_on = await core.act.act(robots.asked(1, 3, state=first.state, model=first.model))
    assert went_on.model == first.model


SMALL = Image("raw_rgb8", 2, 2, bytes(12), "front")
GRAY = Image("raw_gray8", 4, 4, bytes(16), "front")
RIGHT = Image("raw_rgb8", 4, 4, bytes(48), "front")
LARGE = Image("png", 0, 0, encoded(Image("raw_rgb8", 5, 5, bytes(75))).data)


@pytest.mark.fault("I1")
@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"observation": Observation()}, "observation.images"),
        ({"observation": Observation((RIGHT, RIGHT))}, "observation.images"),
        ({"observation": Observation((replace(RIGHT, camera="left"),))}, "observation.images.0.camera"),
        ({"observation": Observation((SMALL,))}, "observation.images.0"),
        ({"observation": Observation((GRAY,))}, "observation.images.0"),
        ({"observation": Observation((replace(RIGHT, data=b"1"),))}, "observation.images.0"),
        ({"observation": Observation((replace(RIGHT, height=2**32 - 1, width=2**32 - 1),))}, "observation.images.0"),
        ({"observation": Observation((LARGE,))}, "observation.images.0"),
        ({"observation": Observation((encoded(RIGHT, mode="L"),))}, "observation.images.0"),
        ({"observation": Observation((Image("png", 0, 0, b"GIF89a"),))}, "observation.images.0"),
        ({"goal": Goal()}, "goal.images"),
        ({"goal": Goal((RIGHT,), ("reach",))}, "goal.images"),
        ({"goal": Goal((RIGHT,) * 257)}, "goal.images"),
        ({"goal": Goal((RIGHT, SMALL))}, "goal.images.1"),
        ({"executed_actions": np.zeros((1, 2), np.float64)}, "executed_actions"),
        ({"executed_actions": np.zeros((1, 3), np.float32)}, "executed_actions"),
        ({"executed_actions": np.zeros(2, np.float32)}, "executed_actions"),
        ({"executed_actions": np.full((1, 2), np.nan, np.float32)}, "executed_actions"),
        ({"executed_actions": np.full((2, 2), 1.01, np.float32)}, "executed_actions"),
        ({"state": b"x"}, "state"),
    ],
)
async def test_what_is_wrong_is_refused_by_name(core: Any, change: dict[str, Any], field: str) -> None:
    with pytest.raises(ServiceError) as error:
        await core.act.act(replace(robots.asked(1, 3), **change))
    assert error.value.grpc_status == "INVALID_ARGUMENT"
    assert error.value.field == field
    assert error.value.hint


@pytest.mark.parametrize(
    ("state", "detail"),
    [
        (None, r"float32 of shape \(3,\), as in training; got none"),
        (np.zeros(2, np.float32), r"got float32 \(2,\)"),
        (np.zeros((1, 3), np.float32), r"got float32 \(1, 3\)"),
        (np.zeros(3), r"got float64 \(3,\)"),
        (np.array([0, np.inf, 0], np.float32), "must be finite"),
    ],
)
def test_a_model_that_takes_the_robots_state_says_which(state: Any, detail: str) -> None:
    spec = replace(policies.FaultyPolicy.spec, robot_state_size=3)
    with pytest.raises(InvalidInput, match=detail) as error:
        parse_robot_state(spec, Observation(state=state))
    assert error.value.field == "observation.state"
    assert error.value.hint


async def test_a_state_of_the_robot_changes_nothing_where_the_model_takes_none(core: Any) -> None:
    request = robots.asked(1, 3)
    without = await core.act.act(request)
    for state in (np.ones(3, np.float32), np.full((2, 2), np.nan)):
        sent = replace(request, observation=replace(request.observation, state=state))
        assert (await core.act.act(sent)).state == without.state
    assert (await core.act.get_spec(GetSpecRequest())).robot_state_size == 0


async def test_nothing_executed_is_told_from_something(core: Any) -> None:
    none = await core.act.act(robots.asked(1, 3))
    empty = await core.act.act(robots.asked(1, 3, executed_actions=np.zeros((0, 2), np.float32)))
    some = await core.act.act(robots.asked(1, 3, did=(0.5, 0.5)))
    listed = await core.act.act(robots.asked(1, 3, executed_actions=np.empty(0, np.float32)))  # [] in JSON
    assert none.state == empty.state == listed.state != some.state


@pytest.mark.parametrize("measured", [np.array([[1, -1]]), np.array([[1.0000001, -1.0009]], np.float32)])
async def test_executed_actions_may_be_whole_numbers_and_a_hair_outside(core: Any, measured: Any) -> None:
    exact = await core.act.act(robots.asked(1, 3, did=(1.0, -1.0)))
    assert (await core.act.act(robots.asked(1, 3, executed_actions=measured))).state == exact.state


async def test_a_request_may_give_its_goals_less_time(core: Any) -> None:
    first = await core.act.act(robots.asked(1, 3, max_steps_per_goal=1))
    second = await core.act.act(robots.asked(1, 3, max_steps_per_goal=1, state=first.state))
    assert (second.goal_index, second.goal_abandoned, second.goal_reached, len(second.actions)) == (1, True, False, 0)
    assert (second.done, second.done_by) == ("yes", "step_limit")


@pytest.mark.parametrize("recipe", [("reach", "jump"), (), ("reach",) * 257])
async def test_a_recipe_is_of_skills_that_the_model_knows(recipe: tuple[str, ...]) -> None:
    spec = replace(policies.FaultyPolicy.spec, goal_form="recipe", skills=("reach", "grasp"))
    goals = await parse_goal(spec, Goal(recipe=("grasp", "reach")))
    assert [goal.content for goal in goals] == ["grasp", "reach"]
    for wrong in (Goal(recipe=recipe), robots.goal(1)):
        with pytest.raises(InvalidInput):
            await parse_goal(spec, wrong)


FRONT, WRIST = Camera("front", 4, 4, 3), Camera("wrist", 2, 3, 1)


def front(value: int) -> Image:
    return Image("raw_rgb8", 4, 4, bytes([value] * 48), "front")


def wrist(value: int) -> Image:
    return Image("raw_gray8", 2, 3, bytes([value] * 6), "wrist")


@pytest.fixture
def two_cameras() -> Any:
    """The spec of a policy with two cameras of different sizes."""
    return replace(policies.FaultyPolicy.spec, cameras=(FRONT, WRIST))


async def test_an_observation_has_an_image_of_each_camera_in_any_order(two_cameras: Any) -> None:
    for seen in ((front(3), wrist(5)), (wrist(5), front(3))):
        frames = await parse_frames(two_cameras, Observation(seen))
        assert [(name, each.shape, int(each.max())) for name, each in frames.items()] == [
            ("front", (4, 4, 3), 3),
            ("wrist", (2, 3, 1), 5),
        ]


async def test_a_goal_is_a_run_of_one_image_of_each_camera(two_cameras: Any) -> None:
    goals = await parse_goal(two_cameras, Goal((front(1), wrist(2), wrist(4), front(3))))
    seen = [[int(each.max()) for each in goal.content.values()] for goal in goals if isinstance(goal.content, dict)]
    assert seen == [[1, 2], [3, 4]]
    again = await parse_goal(two_cameras, Goal((wrist(2), front(1), front(3), wrist(5))))
    assert [a.digest == b.digest for a, b in zip(goals, again, strict=True)] == [True, False]


@pytest.mark.parametrize(
    ("goal", "field", "detail"),
    [
        ((front(1),), "goal.images", "2 images, one of each camera: front, wrist, for this model"),
        ((front(1), wrist(1)) * 257, "goal.images", "got 514"),
        ((front(1), front(2), wrist(1), wrist(2)), "goal.images.1.camera", "got front again"),
        ((front(1), wrist(1), front(1), replace(wrist(1), camera="")), "goal.images.3.camera", "one of front, wrist"),
        ((front(1), replace(front(1), camera="wrist")), "goal.images.1", r"\(2, 3, 1\)"),
    ],
)
async def test_goal_images_of_wrong_cameras_are_refused_by_name(
    two_cameras: Any, goal: tuple[Image, ...], field: str, detail: str
) -> None:
    with pytest.raises(InvalidInput, match=detail) as error:
        await parse_goal(two_cameras, Goal(goal))
    assert error.value.field == field
