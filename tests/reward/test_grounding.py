from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import model_files
from freerein.learning.model_files import read_card
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein_reward.methods import load
from freerein_reward.model import KNOWN, DualEncoder, DualEncoderSpec, GradCamModel
from freerein_reward.training import synthetic_objects
from freerein_reward.training.config import GroundingConfig
from freerein_reward.training.grounding_learner import GroundingLearner
from freerein_reward.training.known_phrases import evaluate_known_phrases

SHIPPED = Path(__file__).parents[2] / "models" / "reward"
PHRASES = ("a red block", "a blue block", "a yellow block")


@pytest.fixture(scope="module")
def model() -> GradCamModel:
    store = ModelStore(SHIPPED)
    model = load(store.folder(ModelRef("grounding", store.active_version("grounding"))), "cpu")
    assert isinstance(model, GradCamModel)
    return model


def picture(*squares: tuple[int, int, tuple[int, int, int]]) -> npt.NDArray[np.uint8]:
    """Returns a gray picture with squares, 8 pixels wide: x and y of each one's middle, and its colour."""
    frame = np.full((64, 64, 3), 110, np.uint8)
    for x, y, colour in squares:
        frame[y - 4 : y + 4, x - 4 : x + 4] = colour
    return frame


RED, BLUE = (220, 25, 20), (25, 75, 235)


def test_what_is_named_is_found_where_it_is(model: GradCamModel) -> None:
    found = model.ground(picture((15, 40, RED), (45, 20, BLUE))[None], PHRASES)
    assert np.abs(64 * found.x[0, :2] - [15, 45]).max() < 3
    assert np.abs(64 * found.y[0, :2] - [40, 20]).max() < 3


def test_what_is_not_there_is_said_not_to_be(model: GradCamModel) -> None:
    found = model.ground(picture((15, 40, RED), (45, 20, BLUE))[None], PHRASES)
    assert (found.presence[0] >= 0.5).tolist() == [True, True, False]


def test_heat_is_in_0_to_1_and_finite_whatever_is_shown(model: GradCamModel) -> None:
    images = np.stack([picture(), np.zeros((64, 64, 3), np.uint8), np.full((64, 64, 3), 255, np.uint8)])
    for phrases in (PHRASES, ("a red block",)):
        found = model.ground(images, phrases)
        assert found.heatmaps.shape == (3, len(phrases), 16, 16)
        assert found.heatmaps.min() >= 0.0
        assert found.heatmaps.max() <= 1.0
        assert np.isfinite(np.stack([found.x, found.y, found.presence])).all()
        assert ((found.x >= 0) & (found.x <= 1) & (found.y >= 0) & (found.y <= 1)).all()


@pytest.mark.parametrize(
    "phrase", ["a dog", "xyzzy", "the sky", "a red dog", "a thing", "nothing", "a red blue thing", "a ball", "an a an"]
)
def test_what_the_model_does_not_know_is_nowhere_and_leaves_the_others_alone(model: GradCamModel, phrase: str) -> None:
    image = picture((15, 40, RED), (45, 20, BLUE))[None]
    found, without = model.locate(image, (phrase, *PHRASES)), model.locate(image, PHRASES)
    assert found.known[0] < KNOWN
    assert (found.presence[0, 0], found.heatmaps[0, 0].max()) == (0.0, 0.0)
    assert np.array_equal(found.heatmaps[:, 1:], without.heatmaps)
    assert np.array_equal(found.presence[:, 1:], without.presence)


@pytest.mark.parametrize("phrase", ["a red block", "the big red ball", "that red one", "one small red thing"])
def test_what_names_a_colour_is_known_however_it_is_put(model: GradCamModel, phrase: str) -> None:
    found = model.locate(picture((15, 40, RED), (45, 20, BLUE))[None], (phrase,))
    assert found.known[0] >= KNOWN
    assert found.presence[0, 0] > 0.9
    assert abs(64 * found.x[0, 0] - 15) < 3


@pytest.mark.parametrize("phrases", [("a purple block",), ("a yellow block", "a green block")])
def test_what_is_asked_for_without_what_is_there_is_not_found(model: GradCamModel, phrases: tuple[str, ...]) -> None:
    found = model.locate(picture((15, 40, RED), (45, 20, BLUE))[None], phrases)
    assert found.known.min() >= KNOWN
    assert found.presence.max() < 0.5


def test_the_card_says_what_the_model_knows_and_how_well_that_is_told(model: GradCamModel) -> None:
    store = ModelStore(SHIPPED)
    card = read_card(store.folder(ModelRef("grounding", store.active_version("grounding"))))
    assert tuple(card["names"]) == model.names == synthetic_objects.COLOURS
    learner = GroundingLearner(GroundingConfig.from_mapping(card["config"]), torch.device("cpu"))
    figures = evaluate_known_phrases(model.network, learner)
    assert figures == pytest.approx({name: card["figures"][name] for name in figures}, abs=0.01)
    assert figures["known_auroc"] >= 0.95
    assert figures["known_colours"] > 0.99


def test_an_image_alone_or_in_a_batch_is_read_alike(model: GradCamModel) -> None:
    images = np.stack([synthetic_objects.render(np.random.default_rng(seed))[0] for seed in range(70)])
    together, alone = model.ground(images, PHRASES), model.ground(images[-1:], PHRASES)
    assert np.abs(together.heatmaps[-1:] - alone.heatmaps).max() < 1e-4
    assert np.abs(together.x[-1] - alone.x[0]).max() < 1e-4


def test_captions_of_synthetic_objects_mention_no_positions() -> None:
    rng = np.random.default_rng(0)
    said = {
        word for _ in range(500) for word in synthetic_objects.caption(synthetic_objects.render(rng)[1], rng)[0].split()
    }
    assert said <= set(synthetic_objects.VOCABULARY)
    assert len(synthetic_objects.COLOURS) >= 10
    assert {"red", "green", "yellow", "blue"} < set(synthetic_objects.COLOURS)


def test_a_caption_is_true_of_what_it_was_made_from() -> None:
    rng = np.random.default_rng(1)
    shown = synthetic_objects.Attributes("red", "block", "small")
    assert all(
        said is not None and said.describes(shown)
        for _, said in (synthetic_objects.caption(shown, rng) for _ in range(50))
    )
    assert not synthetic_objects.Attributes("blue").describes(shown)


def test_a_card_that_names_no_method_is_refused(tmp_path: Path) -> None:
    model_files.save_model(DualEncoder(DualEncoderSpec(cameras=("",), vocabulary=("a",))), tmp_path, card={})
    with pytest.raises(InvalidInput, match="method"):
        load(tmp_path, "cpu")


def test_as_a_reward_model_it_knows_which_things_are_there(model: GradCamModel) -> None:
    red, blue = (picture((32, 32, colour)) for colour in (RED, BLUE))
    images = model.embed_images({"": np.stack([red, blue])}).vectors
    texts, _ = model.embed_texts(PHRASES[:2])
    assert (images @ texts.T).argmax(axis=1).tolist() == [0, 1]
