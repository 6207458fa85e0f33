"""A policy's object encoder: it locates a body moved by random actions, what that carried, and the goal's objects."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import model_files, tensor_files, weights
from freerein.learning.actor_critic.body import BodyEncoder, Exploration, fit_body
from freerein.learning.actor_critic.hand_eye import HandEye, by_moving_pixels, robust_regression
from freerein.learning.actor_critic.object_encoder import PHRASES_FILE, ObjectEncoder, ObjectEncoderSpec
from freerein.learning.augmentation import add_distractors
from freerein.learning.model_files import MODEL
from freerein.model_store import CLONE_MODELS, ModelStore
from freerein.types.common import Camera, ModelRef
from freerein_orchestrator.rl.object_encoder import load_reward_encoder
from freerein_reward.methods.criterion_captions.network import CriterionNetwork
from freerein_reward.methods.criterion_captions.spec import CriterionSpec

STEP = 10.0
"""Pixels by which an action of 1 moves the body."""

GRASP = 12
"""Pixels from the body down to what it carries."""

CAPTION = "a yellow block to the left of a green block"
CAMERA = Camera("front", 64, 64, 3)


def draw(body: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Returns a frame, uint8 (64, 64, 3), of a white body, a yellow and a green square at (column, row)."""
    frame = np.full((64, 64, 3), (120, 135, 147), np.uint8)
    for place, colour, half in ((second, (30, 168, 40), 4), (first, (250, 204, 15), 4), (body, (210, 212, 216), 5)):
        column, row = np.rint(place).astype(int)
        frame[max(0, row - half) : row + half, max(0, column - half) : column + half] = colour
    return frame


def explore(rng: np.random.Generator, sequences: int) -> tuple[Exploration, np.ndarray]:
    """Returns explorations, and the body's places (B, T + 1, 2). In half of the sequences it carries the first."""
    frames, actions, places = [], [], []
    for number in range(sequences):
        body = rng.uniform((16, 8), (48, 36))
        first, second = rng.uniform(8, 56, size=(2, 2))
        moves = rng.uniform(-0.5, 0.5, size=(8, 2))
        seen, walked = [], []
        for move in (*moves, np.zeros(2)):
            carried = np.add(body, (0, GRASP)) if number % 2 else first
            seen.append(draw(body, carried, second))
            walked.append(body)
            body = body + STEP * move * (1, -1)  # the second component moves up
        frames.append(np.stack(seen))
        actions.append(moves)
        places.append(np.stack(walked))
    drawn = torch.from_numpy(np.stack(frames)), torch.from_numpy(np.stack(actions)).float()
    return Exploration(*drawn), np.stack(places)


@pytest.fixture(scope="module")
def folder() -> Path:
    store = ModelStore(CLONE_MODELS / "reward")
    return store.folder(ModelRef("default", store.active_version("default")))


def error(body: np.ndarray, places: np.ndarray) -> float:
    """Returns how far a body is from where it was seen, in pixels; guessing is off by 8."""
    off = body * STEP * (1, -1) - places[1::2].reshape(-1, 2)
    return float(np.abs(off - np.median(off, axis=0)).mean())


@pytest.fixture
def _as_a_training() -> None:
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)


@pytest.mark.usefixtures("_as_a_training")
def test_an_object_encoder_finds_its_body_and_where_that_holds_things(folder: Path) -> None:
    encoder = load_reward_encoder(folder, goal_caption=CAPTION, camera=CAMERA)
    assert (encoder.spec.first, encoder.spec.second) == (2, 1)
    encoder_net = ObjectEncoder(encoder.spec, height=64, width=64, action_size=2)
    encoder_net.load_objects(encoder.weights)
    seen, _ = explore(np.random.default_rng(0), 16)
    encoder_net.fit(seen, torch.Generator().manual_seed(0))

    new, places = explore(np.random.default_rng(1), 10)
    features = encoder_net(new.frames[1::2].flatten(end_dim=1))  # of those that carry
    assert error(features[:, :2].numpy() / 2, places) < 5
    held = features[:, 2:4]  # from where it holds things to the first object, in object widths
    assert held.abs().median() < 0.25
    nearness = encoder_net.nearness(
        torch.cat([features, torch.full((len(features), 2), 9.0)], dim=1)
    )  # and a last action
    torch.testing.assert_close(nearness, (4 - held.norm(dim=1)).clamp(min=0))
    assert all(not parameter.requires_grad for parameter in encoder_net.parameters())
    assert not encoder_net.train().training


def test_where_nothing_moved_with_the_body_places_stay_those_in_the_frame(folder: Path) -> None:
    encoder = load_reward_encoder(folder, goal_caption=CAPTION, camera=CAMERA)
    encoder_net = ObjectEncoder(encoder.spec, height=64, width=64, action_size=2)
    encoder_net.load_objects(encoder.weights)
    frame = torch.from_numpy(draw(np.array([32, 10]), np.array([12, 40]), np.array([44, 40])))
    encoder_net.fit(Exploration(frame.expand(2, 3, 64, 64, 3), torch.zeros(2, 2, 2)), torch.Generator().manual_seed(0))

    first_x, first_up, second_x, second_up = (-0.2 * encoder_net(frame[None])[0, 2:6]).tolist()

    assert first_x < -0.3 < 0.3 < second_x
    assert first_up == pytest.approx(second_up, abs=0.05)


@pytest.mark.usefixtures("_as_a_training")
def test_a_body_that_was_fitted_to_augmented_frames_is_found_in_other_lights_and_among_other_things() -> None:
    seen, _ = explore(np.random.default_rng(0), 160)
    half = Exploration(seen.frames[:, :, ::2, ::2].contiguous(), seen.actions)  # of the size: a fit in seconds
    body = BodyEncoder(height=32, width=32, action_size=2)
    fit_body(body, half, torch.Generator().manual_seed(0), augmentation=1.0)

    new, places = explore(np.random.default_rng(1), 20)
    frames = new.frames[1::2, :, ::2, ::2].flatten(end_dim=1)
    dim = (0.7 * frames).to(torch.uint8)
    cluttered = add_distractors(frames, strength=1.0, generator=torch.Generator().manual_seed(1))
    for shown in (frames, dim, cluttered):
        assert error(body(shown).detach().numpy(), places) < 2


@pytest.mark.parametrize("augmentation", [0.0, 1.0])
def test_an_encoder_is_fitted_to_the_same_bits(augmentation: float) -> None:
    seen, _ = explore(np.random.default_rng(0), 2)

    def fitted() -> BodyEncoder:
        body = BodyEncoder(height=64, width=64, action_size=2)
        fit_body(body, seen, torch.Generator().manual_seed(3), augmentation=augmentation)
        return body

    first, again = fitted().state_dict(), fitted().state_dict()
    assert all(torch.equal(first[name], again[name]) for name in first)


def test_where_a_body_holds_things_is_found_to_the_same_bits_whatever_was_in_memory() -> None:
    draws, found = torch.Generator().manual_seed(0), []
    inputs, targets = torch.randn(300, 3, generator=draws), torch.randn(300, 2, generator=draws)
    for number in range(50):
        torch.full((64,), number)  # memory that the next tensors may get
        found.append(robust_regression(inputs, targets)[0])
    assert all(torch.equal(found[0], each) for each in found)


def test_a_hand_that_pushes_is_found_where_frames_change_by_its_foot() -> None:
    seen, places = explore(np.random.default_rng(0), 40)
    still = Exploration(seen.frames[::2], seen.actions[::2])  # nothing is carried
    body = torch.from_numpy(places[::2] / STEP * (1, -1)).float()

    found = by_moving_pixels(body, still.frames)

    assert found is not None
    pixel = 2 / 64
    torch.testing.assert_close(found.coefficients, STEP * pixel * torch.eye(2), atol=0.02, rtol=0)
    middle, foot = ((found.origin - torch.tensor([-1.0, 1.0])) / pixel).tolist()  # of a body at column and row 0
    assert middle == pytest.approx(0, abs=1)
    assert foot == pytest.approx(-5, abs=2)  # its lower edge
    assert by_moving_pixels(body, still.frames[:, :1].expand_as(still.frames)) is None


def test_a_frame_that_foreshortens_ways_is_stretched() -> None:
    turned = torch.tensor([[0.0, -0.15], [0.3, 0.0]])  # the first action goes down, and is seen half as long
    metric = HandEye(turned, torch.zeros(2)).ground_metric()
    torch.testing.assert_close(metric, torch.diag(torch.tensor([1.0, 2.0])))


def test_of_what_is_pushed_an_encoder_tells_where_the_push_begins(folder: Path) -> None:
    image = load_reward_encoder(folder, goal_caption=CAPTION, camera=CAMERA).spec.image
    encoder = ObjectEncoder(ObjectEncoderSpec(image, pushed=True), height=64, width=64, action_size=2)
    encoder.hand_eye.copy_(torch.eye(2))
    encoder.metric.copy_(torch.diag(torch.tensor([1.0, 2.0])))
    keypoints = torch.tensor([[[0.0, 0.0], [0.0, 0.4]]])  # the second is 2 widths above in the frame, 4 on the table
    body = torch.tensor([[0.0, -0.14]])  # 1.4 widths below the first, on the table

    features = encoder.features(body, keypoints, torch.tensor([[0.9, 0.4]]))

    torch.testing.assert_close(features[0, 2:8], torch.tensor([0.0, 0.0, 0.0, -1.4, 0.0, -4.0]))
    assert encoder.nearness(features).item() == 6
    torch.testing.assert_close(encoder.offset(features), torch.tensor([[0.0, -4.0]]))
    ahead = encoder.features(torch.tensor([[0.0, 0.14]]), keypoints, torch.ones(1, 2))
    around = 2 * (1.4**2 - 1.2**2) ** 0.5 + 1.2 * (math.pi - 2 * math.acos(1.2 / 1.4))
    assert encoder.nearness(ahead).item() == pytest.approx(6 - around, abs=1e-4)
    assert not encoder.sees_both(features)


@pytest.mark.parametrize(
    ("caption", "camera", "expected"),
    [
        ("a yellow block", CAMERA, "two objects"),
        (CAPTION, Camera("left", 64, 64, 3), "must see left"),
        (CAPTION, Camera("front", 32, 32, 3), "at 32 x 32"),
    ],
)
def test_a_reward_model_that_an_object_encoder_cannot_use_is_refused(
    folder: Path, caption: str, camera: Camera, expected: str
) -> None:
    with pytest.raises(InvalidInput, match=expected):
        load_reward_encoder(folder, goal_caption=caption, camera=camera)


def test_a_grounding_model_is_no_encoder_of_objects() -> None:
    store = ModelStore(CLONE_MODELS / "reward")
    folder = store.folder(ModelRef("grounding", store.active_version("grounding")))
    with pytest.raises(InvalidInput):
        load_reward_encoder(folder, goal_caption=CAPTION, camera=CAMERA)


def test_a_reward_model_without_keypoints_of_its_own_is_no_encoder_of_objects(folder: Path, tmp_path: Path) -> None:
    copied = Path(shutil.copytree(folder, tmp_path / "criteria"))
    weights = tensor_files.parse((copied / MODEL.weights).read_bytes())
    of_criteria = {name: each for name, each in weights.items() if not name.startswith("image.pool.")}
    (copied / MODEL.weights).write_bytes(tensor_files.dump(of_criteria))
    with pytest.raises(InvalidInput, match="locates its phrases") as refused:
        load_reward_encoder(copied, goal_caption=CAPTION, camera=CAMERA, field="config.eye_model")
    assert refused.value.field == "config.eye_model"


def test_a_fit_of_the_body_is_interrupted() -> None:
    seen, _ = explore(np.random.default_rng(0), 2)
    calls = iter([None])  # the second raises StopIteration

    with pytest.raises(StopIteration):
        fit_body(BodyEncoder(height=64, width=64, action_size=2), seen, torch.Generator(), interrupt=calls.__next__)


def test_of_a_model_of_criteria_the_encoder_finds_phrases_where_the_model_does(folder: Path, tmp_path: Path) -> None:
    phrases = ("a yellow puck", "a green puck", "a blue puck")
    vocabulary = tuple(model_files.read_card(folder)["spec"]["vocabulary"])
    views = {"cameras": ("front",), "views": ("front", "", "front"), "units": (0.1, 0.1)}
    network = CriterionNetwork(CriterionSpec(phrases=phrases, other_phrases=(), vocabulary=vocabulary, **views))
    weights.initialise(network.eval(), generator=torch.Generator().manual_seed(0))
    torch.nn.init.normal_(network.locator.contrast, std=0.1, generator=torch.Generator().manual_seed(1))
    torch.nn.init.constant_(network.locator.nowhere, -1.0)
    model_files.save_model(network, tmp_path, card={"method": "criterion_captions"})
    with torch.no_grad():
        embedded = network.embed_phrases(phrases)
        (tmp_path / PHRASES_FILE).write_bytes(tensor_files.dump({"phrases": embedded}))
        encoder = load_reward_encoder(tmp_path, goal_caption="a blue puck close to a yellow puck", camera=CAMERA)
        eye = ObjectEncoder(encoder.spec, height=64, width=64, action_size=2)
        eye.load_objects(encoder.weights)
        frames = torch.from_numpy(np.random.default_rng(0).integers(0, 256, (4, 64, 64, 3), np.uint8))
        found = network.locate(network.embed_cells(frames[:, None]), embedded)
        keypoints, presence = eye.locate_all(frames)
    assert (encoder.spec.first, encoder.spec.second, encoder.spec.pushed) == (2, 0, True)
    torch.testing.assert_close(presence, found.presence[:, 0], atol=1e-5, rtol=0)
    seen = found.presence[:, 0] > 0.2  # what is seen less is drawn to the middle
    assert seen.any()
    expected = (2 * found.keypoints[:, 0] - 1) * torch.tensor([1.0, -1.0])
    torch.testing.assert_close(keypoints[seen], expected[seen], atol=1e-4, rtol=0)
