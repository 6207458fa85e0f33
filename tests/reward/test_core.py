"""The core of the reward service around a model of colours: what it answers, and what it refuses."""

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from freerein import images
from freerein.errors import InvalidInput, ModelFault, OutputNotFinite, ServiceError, TooLarge
from freerein.goal_text import Grammar
from freerein.model_store import ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein.types.reward import EmbedGoalRequest, RewardRequest
from freerein_reward.core import GoalCache, Inference, RewardCore
from freerein_reward.model import ImageEmbeddings, ImportedGrounding, load_built_in
from freerein_reward.model.imported_grounding import Calibration
from freerein_reward.model.vision_language import BuiltIn

COLOURS = ("red", "green", "blue")
CACHE_BYTES = 2**20


class Colours:
    """Sees the colour of a frame, the mean over its cameras; reads the names of colours. Every call is written down."""

    def __init__(self, *cameras: str) -> None:
        self.cameras = cameras
        self.aspects: dict[str, float] = {}
        self.grammar = Grammar(("a red block", "a blue block"), (*COLOURS, "a block on top of apart", "nan", "short"))
        self.frames_per_call: list[int] = []
        self.read: list[str] = []

    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        return np.broadcast_to(image.mean(axis=(0, 1)).astype(np.uint8), (2, 2, 3))

    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> ImageEmbeddings:
        colours = np.mean([views[camera].mean(axis=(1, 2)) for camera in self.cameras], axis=0) + 1e-3
        self.frames_per_call.append(len(colours))
        vectors = np.float32(colours / np.linalg.norm(colours, axis=1, keepdims=True))
        return ImageEmbeddings(vectors, np.arange(len(vectors), dtype=np.float32))

    def similarities(self, images: npt.NDArray[np.float32], texts: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return (images @ texts.T).clip(-1, 1)

    def in_distribution(
        self, distances: npt.NDArray[np.float32], similarities: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        return np.float32(1 / (1 + distances) / similarities.shape[1])

    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        self.read += texts
        counts = np.array([[text.split().count(colour) + 1e-3 for colour in COLOURS] for text in texts])
        vectors = np.float32(counts / np.linalg.norm(counts, axis=1, keepdims=True))
        vectors[["nan" in text.split() for text in texts]] = np.nan
        return vectors[: -1 if "short" in texts else None], np.array([len(text) > 20 for text in texts])


Start = Callable[[Any], Awaitable[RewardCore]]


@pytest.fixture
async def start(tmp_path: Path) -> AsyncIterator[Start]:
    """A function that returns the core around a model."""
    batchers: list[Batcher[Any, Any]] = []

    async def begin(model: Any) -> RewardCore:
        store, folder = ModelStore(tmp_path / "models"), tmp_path / "unpublished"
        folder.mkdir()
        (folder / "card.json").write_text(json.dumps({}))
        store.activate(store.publish("", folder))
        models = ModelCache(store, lambda _folder: model, fit_command="freerein fit reward X")
        await models.start()
        goals = GoalCache(CACHE_BYTES)
        batchers.append(Batcher(Inference(goals).run, queue=64, batch=8, metrics=Metrics()))
        return RewardCore(models, batchers[-1], goals)

    yield begin
    for batcher in batchers:
        batcher.close()


def frames(*colours: str, side: int = 3) -> npt.NDArray[np.uint8]:
    """Returns a frame of each colour, uint8 (N, side, side, 3)."""
    pure = np.array([[255 * (colour == known) for known in COLOURS] for colour in colours], np.uint8)
    return np.broadcast_to(pure[:, None, None], (len(colours), side, side, 3)).copy()


TOP_RED = {"top": frames("red")}


async def test_a_frame_is_rewarded_where_the_goal_text_beats_every_rival(start: Start) -> None:
    rewarder = await start(Colours("top"))
    request = RewardRequest("red", {"top": frames("red", "green", "blue")}, rivals=("green", "blue"))

    answer = await rewarder.reward(request)

    np.testing.assert_array_equal(answer.rewards, np.float32([1, 0, 0]))
    np.testing.assert_array_equal(answer.winners, [0, 1, 2])
    np.testing.assert_allclose(answer.similarities, [1, 0, 0], atol=0.01)
    assert answer.texts == ("red", "green", "blue")


async def test_a_tie_is_no_win_so_that_a_goal_that_says_nothing_is_never_reached(start: Start) -> None:
    rewarder = await start(Colours("top"))

    answer = await rewarder.reward(RewardRequest("a thing", {"top": frames("red")}, rivals=("a block",)))

    assert (answer.rewards[0], answer.winners[0]) == (0.0, 1)


async def test_rivals_are_the_other_relations_where_none_are_sent(start: Start) -> None:
    rewarder = await start(Colours("top"))

    answer = await rewarder.reward(RewardRequest("red on top of blue", {"top": frames("red")}))

    assert answer.texts[0] == "a red block on top of a blue block"
    assert "a red block below a blue block" in answer.texts[1:]


async def test_every_way_to_say_a_goal_is_rewarded_and_embedded_as_its_caption(start: Start) -> None:
    model = Colours("top")
    rewarder = await start(model)
    request = RewardRequest("Put the red cube on the blue one.", {"top": frames("red")}, rivals=("red is below blue",))

    answer = await rewarder.reward(request)
    await rewarder.embed_goal(EmbedGoalRequest("a red block above a blue block"))

    captions = ("a red block on top of a blue block", "a red block below a blue block")
    assert answer.texts == tuple(model.read) == captions
    assert answer.unknown == ()


async def test_a_rival_that_says_the_same_in_other_words_is_refused(start: Start) -> None:
    rewarder = await start(Colours("top"))
    with pytest.raises(InvalidInput, match="rival 1 says the same"):
        await rewarder.reward(RewardRequest("red on blue", TOP_RED, rivals=("red below blue", "Red above blue.")))


async def test_a_goal_text_with_unknown_words_wins_nothing_and_its_similarity_stays(start: Start) -> None:
    rewarder = await start(Colours("top"))
    answers = [
        await rewarder.reward(RewardRequest("a red zeppelin", TOP_RED, rivals=("blue",), mode=mode))
        for mode in ("binary", "raw")
    ]

    assert [answer.unknown for answer in answers] == [("zeppelin",)] * 2
    assert [answer.winners.tolist() for answer in answers] == [[1], [1]]
    assert answers[0].rewards.tolist() == [0]
    assert answers[1].rewards.tolist() == answers[1].similarities.tolist() == answers[0].similarities.tolist()
    assert answers[1].rewards[0] > 0.9
    assert [answer.in_distribution.tolist() for answer in answers] == [[0], [0]]


async def test_a_rival_with_unknown_words_is_refused_by_its_index(start: Start) -> None:
    rewarder, goal = await start(Colours("top")), "a red block on top of a blue block"
    rivals = ("blue", "a red blok below a blue block")
    for mode in ("binary", "raw"):
        with pytest.raises(InvalidInput, match=r"every word of `rivals.1`; it does not know blok\.") as caught:
            await rewarder.reward(RewardRequest(goal, TOP_RED, rivals=rivals, mode=mode))
        assert caught.value.field == "rivals.1"
        assert caught.value.hint == "Did you mean: a red block below a blue block?"


async def test_a_frame_of_other_proportions_than_those_of_the_fit_is_refused(start: Start) -> None:
    model = Colours("front", "left")
    model.aspects = {"front": 0.75}
    rewarder, left = await start(model), np.zeros((1, 9, 16, 3), np.uint8)
    for size, is_right in (((3, 4), True), ((29, 40), True), ((9, 16), False), ((4, 3), False)):
        request = RewardRequest("red", {"front": np.zeros((1, *size, 3), np.uint8), "left": left}, rivals=("blue",))
        if is_right:
            assert len((await rewarder.reward(request)).rewards) == 1
        else:
            with pytest.raises(InvalidInput, match=r"0\.75 times as high as it is wide.*got"):
                await rewarder.reward(request)
    sizes = ((9, 16, "left"), (3, 4, "front"), (9, 16, "left"), (4, 3, "front"))
    encoded = tuple(images.encode(np.zeros((*size, 3), np.uint8), camera=camera) for *size, camera in sizes)
    with pytest.raises(InvalidInput, match="4 x 3 pixels") as caught:
        await rewarder.reward(RewardRequest("red", images=encoded, rivals=("blue",)))
    assert caught.value.field == "images.3"


async def test_a_goal_text_without_relation_needs_rivals_or_the_raw_similarity(start: Start) -> None:
    rewarder = await start(Colours("top"))
    with pytest.raises(InvalidInput, match="rivals") as caught:
        await rewarder.reward(RewardRequest("red", {"top": frames("red")}))
    assert "mode raw" in caught.value.hint

    answer = await rewarder.reward(RewardRequest("red", {"top": frames("red", "green")}, mode="raw"))

    np.testing.assert_array_equal(answer.rewards, answer.similarities)
    np.testing.assert_array_equal(answer.winners, [0, 0])
    assert answer.texts == ("red",)


@pytest.mark.parametrize(
    ("text", "unknown"),
    [
        ("den roten Block auf den blauen legen", "den, roten, auf, blauen, legen"),
        ("grab the zeppelin!", "grab, zeppelin"),
    ],
)
async def test_a_goal_text_of_unknown_words_is_refused_by_their_names_rather_than_for_want_of_rivals(
    start: Start, text: str, unknown: str
) -> None:
    rewarder = await start(Colours("top"))
    with pytest.raises(InvalidInput, match=f"does not know {unknown}[.]") as caught:
        await rewarder.reward(RewardRequest(text, {"top": frames("red")}))
    assert caught.value.field == "goal_text"


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("a red block on top of a red block", "Send `rivals`"),
        ("a red block on a blue block on a red block", "Send `rivals`"),
        ("a blue red on top", "Send `rivals`"),
        ("a blue red apart", "Did you mean: a blue block apart from a red block?"),
    ],
)
async def test_a_goal_text_of_known_words_that_states_nothing_is_refused_and_scored_only_against_rivals(
    start: Start, text: str, hint: str
) -> None:
    rewarder = await start(Colours("top"))
    with pytest.raises(InvalidInput, match="states no relation of two different things") as caught:
        await rewarder.reward(RewardRequest(text, TOP_RED))
    assert caught.value.hint.startswith(hint)

    answer = await rewarder.reward(RewardRequest(text, TOP_RED, rivals=("green",)))

    assert (answer.texts, answer.rewards.tolist()) == ((text, "green"), [1])


async def test_the_nearest_statement_is_asked_back_and_not_rewarded(start: Start) -> None:
    rewarder, text = await start(Colours("top")), "a red blok on top of a blue block"

    answer = await rewarder.reward(RewardRequest(text, TOP_RED))
    embedded = await rewarder.embed_goal(EmbedGoalRequest(text))

    assert answer.did_you_mean == embedded.did_you_mean == "a red block on top of a blue block"
    assert (answer.texts[0], answer.unknown, answer.rewards.tolist()) == (text, ("blok",), [0])
    with pytest.raises(InvalidInput, match=r"does not know next\.") as caught:
        await rewarder.reward(RewardRequest("red next to blue", TOP_RED))
    assert caught.value.hint == "Did you mean: a red block to the left of a blue block?"


async def test_cameras_are_told_apart_by_name_whatever_their_sizes_and_order(start: Start) -> None:
    rewarder = await start(Colours("front", "left"))
    views = {"other": frames("blue"), "left": frames("green", side=5), "front": frames("red")}
    encoded = tuple(images.encode(views[camera][0], camera=camera) for camera in ("left", "other", "front"))

    depth = {"depth": np.zeros((1, 2, 2), np.float32)}

    for sent in ({"frames": views | depth}, {"images": encoded}):
        answer = await rewarder.reward(RewardRequest("red green", rivals=("blue",), mode="raw", **sent))
        assert answer.similarities[0] == pytest.approx(1.0, abs=0.01)


async def test_images_of_a_camera_are_in_order_of_time(start: Start) -> None:
    rewarder = await start(Colours("top"))
    shown = frames("red", "green", "red", "blue")
    nameless = tuple(images.encode(frame) for frame in shown)

    answer = await rewarder.reward(RewardRequest("red", images=nameless, rivals=("green", "blue")))

    np.testing.assert_array_equal(answer.rewards, np.float32([1, 0, 1, 0]))


TOP = {"top": frames("red")}
BOTH = {"front": frames("red", "red"), "left": frames("red")}
REFUSED: dict[str, tuple[tuple[str, ...], dict[str, Any], type[ServiceError], str]] = {
    "neither": (("top",), {}, InvalidInput, "neither"),
    "both": (("top",), {"frames": TOP, "images": (images.encode(frames("red")[0]),)}, InvalidInput, "both"),
    "a camera is missing": (("front", "left"), {"frames": {"front": frames("red")}}, InvalidInput, "none is left"),
    "several of any camera": (("",), {"frames": BOTH}, InvalidInput, "of one camera; got `front, left`"),
    "another camera": (("front",), {"frames": {"back": frames("red")}}, InvalidInput, "none is front"),
    "unequal counts": (("front", "left"), {"frames": BOTH}, InvalidInput, "2 of front, 1 of left"),
    "no frames": (("top",), {"frames": {"top": frames("red")[:0]}}, InvalidInput, "N at least 1"),
    "floats": (("top",), {"frames": {"top": np.zeros((1, 2, 2, 3), np.float32)}}, InvalidInput, "float32"),
    "too many": (("top",), {"frames": {"top": np.zeros((20_001, 1, 1, 1), np.uint8)}}, TooLarge, "20000"),
    "an empty goal": (("top",), {"frames": TOP, "goal_text": ""}, InvalidInput, "got none"),
    "a white goal": (("top",), {"frames": TOP, "goal_text": " \u2003\n"}, InvalidInput, "got none"),
    "itself": (("top",), {"frames": TOP, "rivals": ("blue", "red")}, InvalidInput, "the same"),
    "nan": (("top",), {"frames": TOP, "goal_text": "nan", "rivals": ("a",)}, OutputNotFinite, "finite"),
    "wrong shape": (("top",), {"frames": TOP, "goal_text": "short", "rivals": ("a",)}, ModelFault, "failed"),
}


@pytest.mark.parametrize("name", REFUSED)
async def test_what_cannot_be_rewarded_is_refused(start: Start, name: str) -> None:
    cameras, fields, error, words = REFUSED[name]
    rewarder = await start(Colours(*cameras))
    with pytest.raises(error, match=words):
        await rewarder.reward(RewardRequest(**{"goal_text": "red", "rivals": ("blue",), **fields}))


async def test_lone_frames_share_a_batch_and_get_what_they_would_get_alone(start: Start) -> None:
    model = Colours("top")
    rewarder = await start(model)
    colours = ("red", "green", "blue") * 10
    requests = [RewardRequest(c, {"top": frames(c)}, rivals=("apart",), mode="raw") for c in colours]
    alone = [await rewarder.reward(request) for request in requests]
    model.frames_per_call.clear()

    together = await asyncio.gather(*(rewarder.reward(request) for request in requests))

    assert sum(model.frames_per_call) == len(requests)
    assert max(model.frames_per_call) > 1
    assert {answer.timing.batch_size for answer in together} >= {max(model.frames_per_call)}
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_allclose(one.rewards, other.rewards, atol=1e-5)


async def test_a_request_of_several_frames_is_never_merged_and_runs_in_bounded_parts(start: Start) -> None:
    model = Colours("top")
    rewarder = await start(model)
    several = RewardRequest("red", {"top": frames(*["red"] * 100)}, rivals=("blue",))

    answers = await asyncio.gather(*(rewarder.reward(several) for _ in range(4)))

    assert sorted(model.frames_per_call) == [36] * 4 + [64] * 4
    assert all(answer.rewards.shape == (100,) and answer.timing.batch_size == 1 for answer in answers)


async def test_a_poisonous_text_fails_alone_in_its_batch(start: Start) -> None:
    rewarder = await start(Colours("top"))
    texts = ("red", "nan", "green") * 5
    requests = [RewardRequest(text, {"top": frames("red")}, mode="raw") for text in texts]

    answers = await asyncio.gather(*map(rewarder.reward, requests), return_exceptions=True)

    assert [isinstance(answer, OutputNotFinite) for answer in answers] == [text == "nan" for text in texts]


async def test_a_goal_is_embedded_once_for_both_calls(start: Start) -> None:
    model = Colours("top")
    rewarder = await start(model)

    answers = [await rewarder.embed_goal(EmbedGoalRequest("a long text about red")) for _ in range(3)]
    await rewarder.reward(RewardRequest("a long text about red", {"top": frames("red")}, mode="raw"))

    assert model.read == ["a long text about red"]
    assert [answer.timing.infer_ns > 0 for answer in answers] == [True, False, False]
    assert all(np.linalg.norm(answer.embedding) == pytest.approx(1.0) for answer in answers)
    assert all((answer.truncated, answer.unknown) == (True, ("long", "text", "about")) for answer in answers)


async def test_the_parts_of_a_call_add_up_to_its_time(start: Start) -> None:
    rewarder = await start(Colours("top"))

    timing = (await rewarder.reward(RewardRequest("red", {"top": frames("red")}, mode="raw"))).timing

    parts = (timing.queue_ns, timing.decode_ns, timing.infer_ns, timing.encode_ns)
    assert min(parts) >= 0
    assert sum(parts) == timing.total_ns


async def test_an_imported_model_gives_the_base_reward_for_a_text_as_it_is(start: Start) -> None:
    store = ModelStore(Path(__file__).parents[2] / "models/reward")
    shipped = load_built_in(store.folder(ModelRef("grounding", store.active_version("grounding"))), "cpu")
    calibration = Calibration(shipped.known_phrases, shipped.presence_heat)
    rewarder = await start(ImportedGrounding(BuiltIn(shipped.network), calibration, place="centroid"))
    text = "Not a red mug to the left of a blue block"

    answer = await rewarder.reward(RewardRequest(text, {"any": frames("red", "blue")}, mode="raw"))

    assert (answer.texts, answer.unknown, answer.rewards.shape) == ((text,), (), (2,))
    with pytest.raises(InvalidInput, match="must name a reward model"):
        await rewarder.reward(RewardRequest(text, TOP_RED))


async def test_a_model_of_the_other_kind_is_refused(start: Start) -> None:
    class Grounding:
        grammar = Grammar((), ())

        def preprocess(self, _image: object) -> None: ...

        def ground(self, _images: object, _phrases: object) -> None: ...

    rewarder = await start(Grounding())
    with pytest.raises(InvalidInput, match=r"must name a reward model; default \w+ is a grounding model"):
        await rewarder.embed_goal(EmbedGoalRequest("red", ModelRef("default")))
