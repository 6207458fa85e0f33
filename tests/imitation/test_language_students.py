"""Students of section 4.3 in their variants: beside the sentence, and by their teachers' object encoder."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.learning import model_files, tensor_files, weights
from freerein.learning.actor_critic.shared_object_encoder import SharedObjectEncoder, SharedObjectEncoderSpec
from freerein.learning.augmentation import resized_crops
from freerein.learning.encoders.clip import ClipImageSpec
from freerein.learning.training_loop import fit
from freerein.learning.trajectories import Trajectories
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import ActionSpec, Camera, ModelRef
from freerein_imitation.methods.language.config import LanguageConfig
from freerein_imitation.methods.language.losses import LanguageLearner
from freerein_imitation.methods.language.network import Conditioning
from freerein_imitation.methods.language.policy import LanguagePolicy
from freerein_imitation.methods.language.texts import reader_fit
from freerein_imitation.methods.language.texts.text_encoder import TextEncoder
from freerein_imitation.model.policy import NEVER_REACHED, ControlSpec

CAMERAS, ACTION = (Camera("front", 64, 64, 3),), ActionSpec(2, 0, ("right", "up"))
CONTROL = ControlSpec(0.1, NEVER_REACHED, 8)
PAINTS = {"red": (219, 23, 18), "green": (31, 168, 41), "yellow": (250, 204, 15), "blue": (26, 77, 235)}
SIDES = {"left": -1.0, "right": 1.0}
COLOURS = ("red", "green", "yellow")
STEPS = 4


@pytest.fixture(autouse=True)
def _quick_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reader_fit, "_TEXTS", 200)
    monkeypatch.setattr(reader_fit, "_STEPS", 20)


@pytest.fixture(scope="module")
def object_encoder() -> SharedObjectEncoder:
    """An object encoder with the encoder of the reward model that ships, and a body that it has not found."""
    store = ModelStore(CLONE_MODELS / "reward")
    folder = store.folder(ModelRef("default", store.active_version("default")))
    card = model_files.read_card(folder)["spec"]
    sizes = {name: card[name] for name in ("width", "depth", "hidden_size", "embedding_dim")}
    phrases = tuple(card["phrases"])
    made = SharedObjectEncoder(
        SharedObjectEncoderSpec(ClipImageSpec(phrases=len(phrases), **sizes), phrases, 64, 64, ACTION.size)
    )
    tensors = tensor_files.parse((folder / model_files.MODEL.weights).read_bytes())
    made.eye.load_objects({name.removeprefix("image."): each for name, each in tensors.items() if "image." in name})
    torch.nn.init.zeros_(made.eye.body.readout.weight)
    torch.nn.init.zeros_(made.eye.body.readout.bias)
    return made


def told(first: str, side: str, second: str) -> str:
    return f"a {first} block to the {side} of a {second} block"


def draw(rng: np.random.Generator, colours: tuple[str, ...]) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """Returns a frame, uint8 (64, 64, 3), with a square of each colour, and how far right the first is, in [-1, 1]."""
    frame = np.full((64, 64, 3), (120, 135, 147), np.uint8)
    columns = rng.permutation([12, 32, 52])[: len(colours)] + rng.integers(-3, 4, size=len(colours))
    for colour, column in zip(colours, columns, strict=True):
        frame[44:52, column - 4 : column + 4] = PAINTS[colour]
    return frame, np.float32(columns[0] / 32 - 1)


def rollouts(count: int) -> Trajectories:
    """What teachers do: they push to the side that they are told, and up by where the first thing is."""
    rng = np.random.default_rng(0)
    pairs = [(first, second) for first in COLOURS for second in COLOURS if first != second]
    texts, frames, actions = [], [], []
    for item in range(count):
        pair, side = pairs[item % len(pairs)], tuple(SIDES)[item // len(pairs) % 2]
        drawn = [draw(rng, pair) for _ in range(STEPS)]
        texts.append(told(pair[0], side, pair[1]))
        frames.append(np.stack([frame for frame, _ in drawn]))
        actions.append(np.array([(SIDES[side], place) for _, place in drawn], np.float32))
    return Trajectories({"front": frames}, actions, goal_texts=texts)


def prepare(
    text_encoder_file: bytes, config: LanguageConfig, *, object_encoder: SharedObjectEncoder | None = None
) -> LanguageLearner:
    return LanguageLearner.prepare(
        config,
        rollouts(48),
        text_encoder_file,
        cameras=CAMERAS,
        action=ACTION,
        fingerprint="rollouts",
        device=torch.device("cpu"),
        object_encoder=object_encoder,
    )


def seeing(conditioning: Conditioning) -> LanguageConfig:
    fusion = "concatenate"
    return LanguageConfig(
        encoder="goal_eye", fusion=fusion, conditioning=conditioning, steps=300, lr=1e-2, cameras=("front",)
    )


def test_a_student_with_an_object_encoder_does_with_a_colour_that_it_never_saw_what_it_does_with_others(
    text_encoder_file: bytes, object_encoder: SharedObjectEncoder, tmp_path: Path
) -> None:
    fitted = fit(prepare(text_encoder_file, seeing("text"), object_encoder=object_encoder), tmp_path)
    assert fitted is not None
    training = (told("red", "left", "green"),)
    policy = LanguagePolicy(fitted.network, TextEncoder(text_encoder_file), CONTROL, training_texts=training)
    rng = np.random.default_rng(1)
    for side, direction in SIDES.items():
        for pair in (("red", "green"), ("blue", "yellow"), ("green", "blue")):
            drawn = [draw(rng, pair) for _ in range(8)]
            text = told(pair[0], side, pair[1])
            assert policy.spec.known_texts.read(text).caption == text
            nothing = np.zeros((8, 2), np.float32), np.zeros((8, 0), np.float32)
            frames = {"front": np.stack([frame for frame, _ in drawn])}
            done = policy.step(frames, policy.encode_goals([text] * 8), *nothing).actions[:, 0]
            np.testing.assert_allclose(done, [(direction, place) for _, place in drawn], atol=0.25)
    assert policy.spec.known_texts.read("a purple block to the left of a red block").caption is None


def test_a_student_of_codes_sees_the_things_of_the_nearest_training_text_and_one_of_nothing_all_things(
    text_encoder_file: bytes, object_encoder: SharedObjectEncoder
) -> None:
    frames = {"front": torch.from_numpy(draw(np.random.default_rng(0), ("red", "green", "blue"))[0])[None]}
    for conditioning, sees_texts in (("code", True), ("none", False)):
        learner = prepare(text_encoder_file, seeing(conditioning), object_encoder=object_encoder)
        network = learner.init(torch.Generator().manual_seed(0)).network
        codes = torch.from_numpy(np.stack(list(learner.training.codes.values())))
        with torch.no_grad():
            told_each = network(dict.fromkeys(frames, frames["front"].expand(len(codes), -1, -1, -1)), codes)
        assert bool((told_each - told_each[0]).abs().max() > 1e-4) is sees_texts  # rows of a batch may be rounded apart


def test_the_dissertations_student_has_the_frame_beside_the_sentence_and_goes_on_to_the_same_bits(
    text_encoder_file: bytes, tmp_path: Path
) -> None:
    config = LanguageConfig(
        fusion="concatenate",
        text_code="sentence",
        resized_crops=True,
        amsgrad=True,
        max_shift=0.0,
        unseen_objects=True,
        steps=20,
        batch_size=16,
        checkpoint_every=8,
    )
    learner, asked = prepare(text_encoder_file, config), iter(range(100))
    whole = fit(learner, tmp_path / "whole")
    assert fit(learner, tmp_path / "parts", stop=lambda: next(asked) == 12) is None
    parts = fit(prepare(text_encoder_file, config), tmp_path / "parts")
    assert whole is not None
    assert parts is not None
    assert weights.sha256(whole.network) == weights.sha256(parts.network)
    plain = fit(prepare(text_encoder_file, replace(config, amsgrad=False)), tmp_path / "plain")
    assert plain is not None
    assert weights.sha256(whole.network) != weights.sha256(plain.network)

    policy = LanguagePolicy(whole.network, TextEncoder(text_encoder_file), CONTROL, training_texts=("a", "b"))
    assert policy.spec.known_texts.read(told("blue", "left", "red")).caption == told("blue", "left", "red")
    embedded = policy.encode_goals([told("red", "left", "green")])[0]
    assert not embedded[: -TextEncoder(text_encoder_file).size].any()  # no part says what stands where


def test_a_crop_is_enlarged_to_the_frames_size_and_hardly_moves_what_it_shows() -> None:
    ramp = torch.arange(64, dtype=torch.uint8)[None, None, :, None].repeat(200, 48, 1, 3)
    crops = resized_crops(ramp, generator=torch.Generator().manual_seed(0))
    assert (crops.shape, crops.dtype) == (ramp.shape, torch.uint8)
    columns = crops[:, 24, :, 0].float()
    shown = (columns[:, -1] - columns[:, 0] + 1) / 64  # widths, as shares of the frame's
    assert 0.95 < shown.min() < 0.98 < shown.max() <= 1
    assert len(columns[:, 0].unique()) > 1
    assert (columns - torch.arange(64)).abs().max() <= 3
