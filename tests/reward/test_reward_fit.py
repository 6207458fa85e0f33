import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.reward import clip_layout

from freerein.data.layout import DatasetSpec
from freerein.data.lookup import open_dataset
from freerein.data.reader import Dataset
from freerein.data.writer import create
from freerein.errors import InvalidInput
from freerein.model_store import ModelStore
from freerein.relations import SpatialRelation
from freerein.types.common import ActionSpec, ModelRef, Trajectory
from freerein_reward.import_model import import_model
from freerein_reward.methods import METHODS, load
from freerein_reward.methods.relation_captions.caption_checks import accuracy_warnings, caption_warnings
from freerein_reward.methods.relation_captions.caption_dataset import CaptionDataset, caption_images
from freerein_reward.methods.relation_captions.config import RewardConfig
from freerein_reward.methods.shared.phrases import check_shown
from freerein_reward.model import DualEncoderModel, GradCamModel, PhraseLocations, load_grounding
from freerein_reward.model.phrase_relations import NO_CAPTION

SHIPPED = Path(__file__).parents[2] / "models" / "reward"
GROUNDING = ModelStore(SHIPPED).folder(ModelRef("grounding", ModelStore(SHIPPED).active_version("grounding")))
PHRASES = ["a red block", "a blue block"]
FAST = {"steps": 2, "batch_size": 4, "evaluate_every": 1, "checkpoint_every": 1, "hidden_size": 16, "phrases": PHRASES}


@pytest.fixture
def data_dir(tmp_path: Path) -> Path:
    """Returns a data directory with a dataset of red and blue squares, `squares`."""
    rng = np.random.default_rng(0)
    action = ActionSpec(size=1, choices=0, names=("x",), unit="m", scale=(1.0,))
    root = tmp_path / "datasets" / "squares"
    root.parent.mkdir()
    with create(root, DatasetSpec(fps=10, cameras={"front": (64, 64, 3)}, action=action, robot_type="none")) as writer:
        for _ in range(4):
            frames = np.full((3, 64, 64, 3), 110, np.uint8)
            for frame in frames:
                red, blue = rng.integers(8, 56, size=2)
                frame[20:28, red - 4 : red + 4] = (220, 25, 20)
                frame[40:48, blue - 4 : blue + 4] = (25, 75, 235)
            writer.append(Trajectory(frames={"front": frames}, actions=np.zeros((3, 1), np.float32), skills=()))
    return tmp_path


def test_a_fit_in_a_process_of_its_own_makes_a_model_from_frames_and_nouns_alone(
    data_dir: Path, run_child: Callable[..., tuple[int, str]]
) -> None:
    folder = data_dir / "work"
    folder.mkdir()
    config = METHODS.resolve(data_dir, "squares", FAST, threads=1, grounding=GROUNDING)
    (folder / "config.json").write_text(json.dumps({"dataset": "squares", "config": config}))
    assert run_child("freerein_reward.fit_child", folder, data_dir, "cpu", GROUNDING) == (0, "")
    model = load(folder / "model", "cpu")
    assert isinstance(model, DualEncoderModel)
    assert not isinstance(model, GradCamModel)
    assert model.cameras == ("front",)
    assert model.grammar.read("The red cube is on the blue one.").text == "a red block on top of a blue block"
    card = json.loads((folder / "model" / "card.json").read_bytes())
    assert (card["method"], card["grounding"]) == ("relation_captions", GROUNDING.name)
    assert """--set 'phrases=["a red block", "a blue block"]' --set hidden_size=16""" in card["command"]
    assert "relation_accuracy" in card["figures"]
    rows = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    assert (rows[0], rows[-1]["step"]) == ({"step": 0, "captioned": 1.0}, 2)


@pytest.mark.parametrize(
    ("phrases", "named"),
    [
        (["a coffee mug", "a red block"], "a coffee mug"),
        (["a ball", "a red block"], "a ball"),
        (["xyzzy", "the sky"], "xyzzy, the sky"),
    ],
)
def test_a_fit_refuses_phrases_that_the_grounding_model_does_not_know(
    data_dir: Path, phrases: list[str], named: str
) -> None:
    with pytest.raises(InvalidInput, match=rf"does not know {named}\.") as refused:
        METHODS.resolve(data_dir, "squares", {"phrases": phrases}, threads=1, grounding=GROUNDING)
    assert refused.value.field == "config.phrases"
    assert "red, orange" in refused.value.hint


@pytest.mark.parametrize(
    ("config", "field", "hint"),
    [
        ({}, "config.initial", "--set initial=scratch --set distillation=10"),
        ({"method": "criterion_captions"}, "", "initial=scratch"),
        ({"initial": "scratch"}, "config.phrases", "Train another grounding model."),  # its weights are random
    ],
    ids=["initial", "criteria", "phrases"],
)
def test_what_a_grounding_model_that_was_trained_elsewhere_cannot_give_is_refused(
    data_dir: Path, trained_elsewhere: Path, config: dict[str, Any], field: str, hint: str
) -> None:
    with pytest.raises(InvalidInput) as refused:
        METHODS.resolve(data_dir, "squares", {**FAST, **config}, threads=1, grounding=trained_elsewhere)
    assert refused.value.field == field
    assert hint in refused.value.hint


@pytest.fixture(scope="module")
def trained_elsewhere(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of an imported grounding model, of random weights."""
    folder = tmp_path_factory.mktemp("imported")
    source = clip_layout.write(folder / "source", clip_layout.random_weights())
    digest = hashlib.sha256((source / "model.safetensors").read_bytes()).hexdigest()
    ref, _ = import_model(source, folder / "m", sha256=digest, place="argmax", images=64, seed=0, device="cpu")
    return ModelStore(folder / "m").folder(ref)


def test_a_phrase_that_no_image_shows_is_refused(data_dir: Path) -> None:
    frames = open_dataset(data_dir, "squares").cached_frames("front").steps
    grounding = load_grounding(GROUNDING, "cpu")
    check_shown(frames, PHRASES, grounding)
    with pytest.raises(InvalidInput, match=r"of 12, none shows a yellow block\."):
        check_shown(frames, (*PHRASES, "a yellow block"), grounding)


def test_captions_of_nearly_one_relation_are_warned_of() -> None:
    def captioned(relations: list[SpatialRelation]) -> CaptionDataset:
        pairs = np.full((len(relations), 2, 2), NO_CAPTION, np.int8)
        pairs[:, 0, 1] = relations
        return CaptionDataset((), ("a red block", "a blue block"), pairs, np.ones(2))

    left, apart = [SpatialRelation.LEFT_OF], [SpatialRelation.APART_FROM]
    (warning,) = caption_warnings(captioned(apart * 19 + left))
    assert warning.startswith("`apart from` makes up 95% of the 20 captions")
    assert caption_warnings(captioned(apart * 18 + left * 2)) == []


def test_a_model_that_is_no_better_than_a_guess_is_warned_of() -> None:
    (warning,) = accuracy_warnings({"relation_accuracy": 0.9, "majority_accuracy": 0.9})
    assert "tells 90% of the relations, and always saying the most frequent one of each pair 90%" in warning
    assert accuracy_warnings({"relation_accuracy": 0.91, "majority_accuracy": 0.9}) == []


def test_captioning_begun_again_reports_its_progress_once(data_dir: Path) -> None:
    cache, grounding = data_dir / "captions.safetensors", load_grounding(GROUNDING, "cpu")
    dataset, config = open_dataset(data_dir, "squares"), RewardConfig(cameras=("front",), phrases=tuple(PHRASES))
    for _ in range(2):
        caption_images(dataset, grounding, config, cache, size=64)
        cache.unlink()  # as if the fit had been killed before the captions were saved
    rows = (data_dir / "metrics.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in rows] == [{"step": 0, "captioned": 1.0}]


class Stacked:
    """Finds two cubes, one 3 pixels to the left of the other and on top of it, in images of 720 x 1280 pixels."""

    image_size = 64

    def ground(self, images: np.ndarray, phrases: tuple[str, ...]) -> PhraseLocations:
        """Returns the same places in all images."""
        every, heatmaps = np.ones((len(images), 2)), np.zeros((len(images), 2, 4, 4), np.float32)
        x, y = np.array([640, 643]) / 1280, np.array([296, 360]) / 720
        return PhraseLocations(heatmaps, every * x, every * y, 4 * every, np.ones(2, np.float32))


def test_in_wide_frames_stacked_objects_are_captioned_as_such(tmp_path: Path) -> None:
    root, (on_top, below) = tmp_path / "wide", (SpatialRelation.ON_TOP_OF, SpatialRelation.BELOW)
    spec = DatasetSpec(fps=10, cameras={"front": (72, 128, 3)}, action=ActionSpec(0, 0, ()), robot_type="none")
    with create(root, spec) as writer:
        writer.append(Trajectory({"front": np.zeros((2, 72, 128, 3), np.uint8)}, np.empty((2, 0), np.float32), ()))
    config = RewardConfig(cameras=("front",), phrases=tuple(PHRASES), epsilon=64 / 1280)
    captioned = caption_images(Dataset(root), Stacked(), config, tmp_path / "captions.safetensors", size=64)
    assert captioned.relations.tolist() == [[[NO_CAPTION, on_top], [below, NO_CAPTION]]] * 2


def test_a_fit_without_phrases_is_told_what_to_give(data_dir: Path) -> None:
    with pytest.raises(InvalidInput, match="2 to 16 distinct noun phrases") as refused:
        METHODS.resolve(data_dir, "squares", {}, threads=1, grounding=GROUNDING)
    assert refused.value.field == "config.phrases"
    assert "--set 'phrases=" in refused.value.hint


def test_the_shipped_model_whose_card_has_its_phrases_in_the_configuration_reads_goal_texts() -> None:
    store = ModelStore(SHIPPED)
    model = load(store.folder(ModelRef("default", store.active_version("default"))), "cpu")
    assert model.grammar.read("put the yellow one under the green one").text == "a yellow block below a green block"


def test_captions_are_not_made_by_a_reward_model() -> None:
    store = ModelStore(SHIPPED)
    folder = store.folder(ModelRef("default", store.active_version("default")))
    assert not isinstance(load(folder, "cpu"), GradCamModel)
    with pytest.raises(InvalidInput, match="grounding model"):
        load_grounding(folder, "cpu")


@pytest.mark.parametrize(
    "phrases",
    [
        ["a red block"],
        ["a red block", "a red block"],
        ["a red block", "the RED block"],
        ["a red block", " "],
        ["a red block", "!?"],
        ["a red block", "a hat on a stick"],
    ],
)
def test_phrases_must_be_different_and_name_things_only(data_dir: Path, phrases: list[str]) -> None:
    with pytest.raises(InvalidInput, match="phrases"):
        METHODS.resolve(data_dir, "squares", {"phrases": phrases}, threads=1, grounding=GROUNDING)
