"""Fits of `criterion_captions` as the service starts them, and the core around a model of three cameras."""

import json
import shutil
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from freerein.data.layout import DatasetSpec
from freerein.data.writer import create
from freerein.errors import InvalidInput
from freerein.model_store import ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ActionSpec, Image, ModelRef, Trajectory
from freerein.types.reward import EmbedGoalRequest, GroundRequest, RewardRequest
from freerein_reward.core import GoalCache, GroundingCore, Inference, RewardCore
from freerein_reward.methods import METHODS, load
from freerein_reward.methods.criterion_captions.criterion_model import CriterionModel

SHIPPED = Path(__file__).parents[2] / "models" / "reward"
GROUNDING = ModelStore(SHIPPED).folder(ModelRef("grounding", ModelStore(SHIPPED).active_version("grounding")))
PHRASES = ["a red block", "a blue block", "a yellow block"]
COLOURS = ((220, 25, 20), (25, 75, 235), (235, 205, 30))
CAMERAS = ["front", "left", "tilt"]
FAST = {"method": "criterion_captions", "phrases": PHRASES, "cameras": CAMERAS, "object_widths": [0.125]}
SMALL = {"steps": 2, "batch_size": 4, "evaluate_every": 1, "checkpoint_every": 1, "hidden_size": 16}


def squares(rng: np.random.Generator, count: int) -> npt.NDArray[np.uint8]:
    """Returns frames, uint8 (count, 64, 64, 3), of three squares side by side."""
    frames = np.full((count, 64, 64, 3), 110, np.uint8)
    for frame in frames:
        for row, (column, colour) in enumerate(zip(rng.integers(8, 56, size=3), COLOURS, strict=True)):
            frame[8 + 18 * row : 16 + 18 * row, column - 4 : column + 4] = colour
    return frames


@pytest.fixture(scope="module")
def data_dir(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a data directory with a dataset of three cameras, `boxes`."""
    folder, rng = tmp_path_factory.mktemp("data"), np.random.default_rng(0)
    root = folder / "datasets" / "boxes"
    root.parent.mkdir()
    action = ActionSpec(size=0, choices=0, names=())
    cameras = dict.fromkeys(CAMERAS, (64, 64, 3)) | {"wide": (32, 64, 3)}
    with create(root, DatasetSpec(fps=10, cameras=cameras, action=action, robot_type="none")) as writer:
        for _ in range(4):
            frames = {name: squares(rng, 3) for name in CAMERAS} | {"wide": np.zeros((3, 32, 64, 3), np.uint8)}
            writer.append(Trajectory(frames=frames, actions=np.zeros((3, 0), np.float32), skills=()))
    return folder


@pytest.fixture(scope="module")
def model_folder(data_dir: Path, run_child: Callable[..., tuple[int, str]]) -> Path:
    """Returns the model of a fit in a process of its own."""
    folder = data_dir / "work"
    folder.mkdir()
    config = METHODS.resolve(data_dir, "boxes", FAST | SMALL, threads=1, grounding=GROUNDING)
    (folder / "config.json").write_text(json.dumps({"dataset": "boxes", "config": config}))
    code, printed = run_child("freerein_reward.fit_child", folder, data_dir, "cpu", GROUNDING)
    assert code == 0, printed
    return folder / "model"


@pytest.fixture
async def cores(model_folder: Path, tmp_path: Path) -> AsyncIterator[tuple[RewardCore, GroundingCore]]:
    """Returns the cores of the service around the fitted model."""
    store = ModelStore(tmp_path / "models")
    store.activate(store.publish("default", shutil.copytree(model_folder, tmp_path / "model")))
    models: ModelCache[Any] = ModelCache(store, lambda folder: load(folder, "cpu"), fit_command="freerein fit reward X")
    await models.start()
    goals = GoalCache(2**20)
    batcher: Batcher[Any, Any] = Batcher(Inference(goals).run, queue=64, batch=8, metrics=Metrics())
    yield RewardCore(models, batcher, goals), GroundingCore(models, batcher)
    batcher.close()


def test_a_fit_makes_a_model_and_a_card_that_names_its_criteria_and_what_was_not_learned(model_folder: Path) -> None:
    model = load(model_folder, "cpu")
    assert isinstance(model, CriterionModel)
    assert model.cameras == ("front", "left", "tilt")
    card = json.loads((model_folder / "card.json").read_bytes())
    assert (card["method"], card["grounding"], len(card["criteria"])) == ("criterion_captions", GROUNDING.name, 9)
    assert "--set method=criterion_captions" in card["command"]
    assert any("`inside_of`" in each for each in card["warnings"])
    rows = [json.loads(line) for line in (model_folder.parent / "metrics.jsonl").read_text().splitlines()]
    assert (rows[0]["step"], rows[2], rows[-1]["step"]) == (0, {"step": 0, "captioned": 1.0}, 2)


def test_views_are_the_cameras_in_order_and_one_camera_may_be_two_views(data_dir: Path) -> None:
    def views(**given: object) -> tuple[str, ...]:
        return tuple(METHODS.resolve(data_dir, "boxes", FAST | given, threads=1, grounding=GROUNDING)["views"])

    assert views() == ("front", "left", "tilt")
    assert views(cameras=["front"]) == ("front", "", "")
    assert views(cameras=["front"], views=["front", "", "front"]) == ("front", "", "front")


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ({"phrases": ["a red block"]}, "config.phrases"),
        ({"phrases": ["a red block", "a coffee mug"]}, "config.phrases"),
        ({"views": ["left", "front"]}, "config.views"),
        ({"views": ["front", "left", "top"]}, "config.views"),
        ({"object_widths": [0.1, 0.2]}, "config.object_widths"),
        ({"object_widths": [0.0]}, "config.object_widths"),
        (
            {"cameras": ["front", "left"], "views": ["front", "left", "front"], "object_widths": [0.1, 0.1, 0.2]},
            "config.object_widths",
        ),
        ({"cameras": ["front", "wide"]}, "config.cameras"),
    ],
)
def test_a_configuration_that_no_fit_can_use_is_refused(data_dir: Path, given: dict[str, object], field: str) -> None:
    with pytest.raises(InvalidInput) as refused:
        METHODS.resolve(data_dir, "boxes", FAST | given, threads=1, grounding=GROUNDING)
    assert refused.value.field == field
    assert refused.value.hint


async def test_frames_of_three_cameras_are_rewarded_for_criteria_of_two_and_three_nouns(
    cores: tuple[RewardCore, GroundingCore],
) -> None:
    rng, (rewarder, _) = np.random.default_rng(1), cores
    frames = {name: squares(rng, 5) for name in CAMERAS}
    answer = await rewarder.reward(RewardRequest("put the red one behind the blue one", frames))
    assert answer.texts == (
        "a red block behind a blue block",
        "a red block in front of a blue block",
        "a red block not behind a blue block",
        "a red block or a blue block missing",
    )
    assert (answer.rewards.shape, answer.in_distribution.shape, answer.unknown) == ((5,), (5,), ())
    assert np.abs(answer.similarities).max() <= 1
    between = await rewarder.reward(RewardRequest("red in between blue and yellow", frames))
    assert len(between.texts) == 3
    embedded = await rewarder.embed_goal(EmbedGoalRequest("red in between blue and yellow"))
    assert np.linalg.norm(embedded.embedding) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a red block behind a red block", "named twice"),
        ("a red block behind a blue block and a yellow block", "relates 2 things"),
        ("a red block between a blue block", "relates 3 things"),
        ("a red block behind a zeppelin", "does not know zeppelin"),
        ("a red block", "states no criterion"),
    ],
)
async def test_a_text_that_states_no_criterion_is_refused(
    cores: tuple[RewardCore, GroundingCore], text: str, said: str
) -> None:
    frames = {name: np.zeros((1, 64, 64, 3), np.uint8) for name in CAMERAS}
    with pytest.raises(InvalidInput, match=said) as refused:
        await cores[0].reward(RewardRequest(text, frames))
    assert refused.value.field == "goal_text"
    assert refused.value.hint


async def test_a_missing_camera_is_refused(cores: tuple[RewardCore, GroundingCore]) -> None:
    frames = {name: np.zeros((1, 64, 64, 3), np.uint8) for name in CAMERAS[:2]}
    with pytest.raises(InvalidInput, match="none is tilt"):
        await cores[0].reward(RewardRequest("a red block behind a blue block", frames))


async def test_the_model_locates_phrases_and_says_which_it_does_not_know(
    cores: tuple[RewardCore, GroundingCore],
) -> None:
    frame = squares(np.random.default_rng(2), 1)[0]
    image = Image("raw_rgb8", 64, 64, frame.tobytes(), "left")
    phrases = ("a red block", "a magenta block", "a coffee mug")
    answer = await cores[1].ground(GroundRequest(image, phrases, ModelRef("default")))
    row, column = np.argwhere((frame == COLOURS[0]).all(axis=2)).mean(axis=0)
    found = answer.groundings[0]
    assert np.hypot(found.x - column, found.y - row) < 3
    assert found.heatmap.shape == (64, 64)
    assert [each.phrase for each in answer.unknown_phrases] == ["a coffee mug"]
    assert answer.groundings[2].presence == 0
