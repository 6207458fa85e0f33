"""Distilling: what a sentence says is done, and what was learned of one text is not what was learned of another."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning.training_loop import fit
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods.language.config import LanguageConfig
from freerein_imitation.methods.language.contradictions import contradictions
from freerein_imitation.methods.language.goal_text_dataset import GoalTextDataset, random_shift, split_by_text
from freerein_imitation.methods.language.losses import LanguageLearner
from freerein_imitation.methods.language.network import Conditioning
from freerein_imitation.methods.language.policy import LanguagePolicy
from freerein_imitation.methods.language.recognizer import least_probability
from freerein_imitation.methods.language.texts import reader_fit as goal_text_reader
from freerein_imitation.methods.language.texts.text_encoder import TextEncoder
from freerein_imitation.model.policy import NEVER_REACHED, ControlSpec

CPU = torch.device("cpu")
CAMERAS = (Camera("front", 12, 12, 3),)
ACTION = ActionSpec(2, 0, ("right", "up"))
FAST = LanguageConfig(steps=60, batch_size=32, lr=1e-2, warmup_steps=3, evaluate_every=30, checkpoint_every=25)
TEXTS = ("red left", "left red")  # to the right, and to the left


@pytest.fixture(autouse=True)
def _quick_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader of goal texts that has hardly learned: two texts have two codes all the same."""
    monkeypatch.setattr(goal_text_reader, "_TEXTS", 200)
    monkeypatch.setattr(goal_text_reader, "_STEPS", 20)


def roll_out(count: int, *, texts: Sequence[str] = TEXTS, seed: int = 0) -> Trajectories:
    """Trajectory i is of `TEXTS[i % 2]`: a bright column, moved to the right or to the left."""
    rng = np.random.default_rng(seed)
    frames, actions = [], []
    for item in range(count):
        columns = rng.integers(12, size=8)
        seen = np.zeros((8, 12, 12, 3), np.uint8)
        seen[np.arange(8), :, columns] = 200
        frames.append(seen)
        actions.append(np.stack([np.full(8, 1 - 2 * (item % 2)), columns / 11], axis=1).astype(np.float32))
    return Trajectories({"front": frames}, actions, goal_texts=[texts[item % len(texts)] for item in range(count)])


def prepare(text_encoder_file: bytes, *, count: int = 12, conditioning: Conditioning = "text") -> LanguageLearner:
    return LanguageLearner.prepare(
        replace(FAST, conditioning=conditioning),
        roll_out(count),
        text_encoder_file,
        cameras=CAMERAS,
        action=ACTION,
        fingerprint="fingerprint",
        device=CPU,
    )


def test_the_sentence_decides_what_is_done(text_encoder_file: bytes, tmp_path: Path) -> None:
    learner, blind = prepare(text_encoder_file), prepare(text_encoder_file, conditioning="none")
    told, untold = (fit(each, tmp_path / str(i)) for i, each in enumerate((learner, blind)))
    assert told is not None
    assert untold is not None
    assert told.validation_loss < 0.05 < 0.4 < untold.validation_loss  # the mean of opposites is no use

    frames = {"front": torch.from_numpy(learner.validation.trajectories.frames["front"][0])}
    right, left = (torch.from_numpy(learner.training.codes[text]).expand(8, -1) for text in TEXTS)
    with torch.no_grad():
        assert (told.network(frames, right)[:, 0] > 0.5).all()
        assert (told.network(frames, left)[:, 0] < -0.5).all()
        assert torch.equal(untold.network(frames, left), untold.network(frames, right))


def test_a_policy_of_codes_does_with_a_new_text_what_it_does_with_the_nearest_one(text_encoder_file: bytes) -> None:
    learner = prepare(text_encoder_file, conditioning="code")
    network = learner.init(torch.Generator().manual_seed(0)).network
    frames = {"front": torch.from_numpy(learner.validation.trajectories.frames["front"][0])}

    def actions(code: npt.NDArray[np.float32]) -> Tensor:
        with torch.no_grad():
            return network(frames, torch.from_numpy(code).expand(8, -1))

    right, left = (learner.training.codes[text] for text in TEXTS)
    assert torch.equal(actions(0.6 * right + 0.4 * left), actions(right))
    assert torch.equal(actions(0.4 * right + 0.6 * left), actions(left))
    assert not torch.equal(actions(right), actions(left))


def test_few_held_out_frames_have_low_in_distribution_scores_and_noise_has(text_encoder_file: bytes) -> None:
    learner = prepare(text_encoder_file, count=40)
    network = learner.init(torch.Generator().manual_seed(0)).network
    learner.calibrate(network)
    control = ControlSpec(0.1, NEVER_REACHED, 8)
    policy = LanguagePolicy(network, TextEncoder(text_encoder_file), control, training_texts=TEXTS)

    def scores(frames: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        goals = policy.encode_goals([TEXTS[0]] * len(frames))
        nothing = np.zeros((len(frames), 2), np.float32), np.zeros((len(frames), 0), np.float32)
        return policy.step({"front": frames}, goals, *nothing).in_distribution

    frames = np.concatenate(list(roll_out(40, seed=1).frames["front"]))
    assert (scores(frames) < 0.05).mean() < 0.1
    assert scores(np.random.default_rng(0).integers(0, 256, frames.shape, np.uint8)).max() < 0.05


def test_two_cameras_of_different_sizes_are_both_learned_from(text_encoder_file: bytes) -> None:
    """The front camera is black in all frames: what the hand must do is seen by the wrist camera alone."""
    moves = roll_out(12)
    wrist = [moves.frames["front"][item][:, :8] for item in range(12)]
    black = [np.zeros((8, 12, 12, 3), np.uint8)] * 12
    cameras, config = (*CAMERAS, Camera("wrist", 8, 12, 3)), replace(FAST, encoder="convolutional")
    learner = LanguageLearner.prepare(
        config,
        replace(moves, frames={"front": black, "wrist": wrist}),
        text_encoder_file,
        cameras=cameras,
        action=ACTION,
        fingerprint="fingerprint",
        device=CPU,
    )
    state = learner.init(torch.Generator().manual_seed(0))
    before = learner.evaluate(state)
    for _ in range(40):
        state, _ = learner.update(state, np.arange(learner.size))
    assert learner.evaluate(state) < before / 4


def test_discrete_actions_are_learned_too(text_encoder_file: bytes) -> None:
    moves = roll_out(4)
    choices = replace(moves, actions=[(done[:, :1] > 0).astype(np.int64) for done in moves.actions])
    action = ActionSpec(1, 2, ("left", "right"))
    learner = LanguageLearner.prepare(
        FAST, choices, text_encoder_file, cameras=CAMERAS, action=action, fingerprint="fingerprint", device=CPU
    )
    state = learner.init(torch.Generator().manual_seed(0))
    before = learner.evaluate(state)
    for _ in range(20):
        state, _ = learner.update(state, np.arange(learner.size))
    assert learner.evaluate(state) < before


def numbered(lengths: Sequence[int], texts: Sequence[str]) -> GoalTextDataset:
    """GoalTextDataset whose timesteps say in every number which they are, counted over all."""
    numbers = np.split(np.arange(sum(lengths)), np.cumsum(lengths)[:-1])
    frames = [np.broadcast_to(each[:, None, None, None], (len(each), 4, 4, 1)).astype(np.uint8) for each in numbers]
    actions = [each[:, None].astype(np.float32) for each in numbers]
    codes = {text: np.array([place], np.float32) for place, text in enumerate(sorted(set(texts)))}
    return GoalTextDataset.of(Trajectories({"front": frames}, actions, goal_texts=texts), codes)


def test_a_batch_has_frame_text_and_action_of_each_timestep() -> None:
    dataset = numbered((3, 1, 4), ("b", "a", "b"))
    assert len(dataset) == 8
    batch = dataset.collate(np.array([7, 0, 3, 2, 4]), device=CPU)
    assert batch.frames["front"][:, 0, 0, 0].tolist() == batch.actions[:, 0].tolist() == [7, 0, 3, 2, 4]
    assert batch.texts[:, 0].tolist() == [1, 1, 0, 1, 1]


@pytest.mark.parametrize("seed", range(3))
def test_some_of_every_goal_text_is_for_validation(seed: int) -> None:
    texts = ("a",) * 6 + ("b",) * 2 + ("c",)
    training, validation = split_by_text(numbered((2,) * 9, texts), fraction=0.3, seed=seed)
    assert [list(part.trajectories.goal_texts) for part in (validation, training)] == [["a", "a", "b"], [*"aaaabc"]]
    shown = [int(each[0, 0]) for part in (training, validation) for each in part.trajectories.actions]
    assert sorted(shown) == list(range(0, 18, 2))


def test_without_two_trajectories_of_one_goal_text_there_is_nothing_to_split_by_text() -> None:
    with pytest.raises(InvalidInput, match="2 trajectories of a goal text"):
        split_by_text(numbered((2, 2), ("a", "b")), fraction=0.5, seed=0)


def test_shifted_frames_hold_the_same_pixels_at_the_same_distances_and_repeat_their_edges() -> None:
    frames = torch.arange(20 * 10, dtype=torch.uint8).reshape(1, 20, 10, 1).repeat(200, 1, 1, 1)
    generator = torch.Generator().manual_seed(0)
    assert torch.equal(random_shift(frames, most=0.0, generator=generator), frames)
    shifted = random_shift(frames, most=0.1, generator=generator)[..., 0].int()
    for places, length, reach in ((shifted[:, :, 0] // 10, 20, 2), (shifted[:, 0] % 10, 10, 1)):
        offset = places[:, length // 2] - length // 2
        assert sorted(offset.unique().tolist()) == list(range(-reach, reach + 1))
        assert torch.equal(places, (torch.arange(length) + offset[:, None]).clamp(0, length - 1))


SIDES = ("a red block to the left of a green block", "a red block to the right of a green block")


def reach(count: int, *, seed: int = 0) -> Trajectories:
    """As `roll_out`, of texts that contradict each other; the goal is the half of the frame that the text names."""
    rolled = roll_out(count, texts=SIDES, seed=seed)
    columns = [each.max(axis=(1, 3)).argmax(axis=1) for each in rolled.frames["front"]]  # (T,) each
    reached = [(each < 6) if item % 2 == 0 else (each >= 6) for item, each in enumerate(columns)]
    return replace(rolled, reached=reached)


def test_a_policy_says_whether_a_frame_shows_what_the_text_says_and_not_what_another_says(
    text_encoder_file: bytes, tmp_path: Path
) -> None:
    config = replace(FAST, steps=150, reached_weight=1.0)
    learner = LanguageLearner.prepare(
        config, reach(24), text_encoder_file, cameras=CAMERAS, action=ACTION, fingerprint="f", device=CPU
    )
    fitted = fit(learner, tmp_path)
    assert fitted is not None
    control = ControlSpec(0.1, 0.5, 8)
    policy = LanguagePolicy(fitted.network, TextEncoder(text_encoder_file), control, training_texts=SIDES)
    assert policy.spec.predicts_reached

    frames, asked = np.zeros((12, 12, 12, 3), np.uint8), config.reached_steps - 1
    frames[np.arange(12), :, np.arange(12)] = 200
    previous, first = np.zeros((12, 2), np.float32), np.zeros((12, asked), np.float32)
    for text, is_there in zip(SIDES, (np.arange(12) < 6, np.arange(12) >= 6), strict=True):
        goals = policy.encode_goals([text] * 12)
        said = policy.step({"front": frames}, goals, previous, first)
        assert ((said.reached > 0.5) == is_there).mean() > 0.9
        assert not said.settled.any()  # it may be so for a moment
        later = policy.step({"front": frames}, goals, previous, np.repeat(said.reached[:, None], asked, axis=1))
        assert later.settled.tolist() == (said.reached >= 0.5).tolist()
    logits, _ = learner.held_out_reached(fitted.network)
    assert len(logits) > len(learner.validation)  # frames that show a goal are told the contrary, too
    probabilities, reached = torch.tensor([0.9, 0.75, 0.7, 0.7, 0.6]), torch.tensor([True, True, True, False, True])
    assert least_probability(probabilities, reached) == 0.75
    assert least_probability(torch.tensor([0.9, 0.4]), torch.tensor([False, True])) == 1.0


def test_texts_contradict_each_other_where_they_state_other_relations_of_the_same_two_things() -> None:
    left, right = SIDES
    turned, other = "a green block to the right of a red block", "a blue block on top of a green block"
    assert contradictions([left, right, turned, other, "stack everything"]) == {
        left: (right,),
        right: (left, turned),
        turned: (right,),
        other: (),
        "stack everything": (),
    }
