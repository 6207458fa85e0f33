import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import model_files, weights
from freerein.types.common import ActionSpec
from freerein_imitation import model
from freerein_imitation.model import Handshake, SkillsNetwork, SkillsPolicy, SkillsSpec
from freerein_imitation.model.codebook import ColourCodebook, moved

CONTINUOUS = SkillsSpec(skills=("pick", "push"), camera="front", height=24, width=20, action_size=2, colours=4)
DISCRETE = replace(CONTINUOUS, channels=1, action_size=1, action_choices=4, colours=3)
SPECS = pytest.mark.parametrize("spec", [CONTINUOUS, DISCRETE], ids=["continuous", "discrete"])


def handshake(spec: SkillsSpec) -> Handshake:
    return Handshake(ActionSpec(spec.action_size, spec.action_choices, ("dy", "dz")[: spec.action_size]), 0.04, 0.5, 40)


def network(spec: SkillsSpec) -> SkillsNetwork:
    made, generator = SkillsNetwork(spec), torch.Generator().manual_seed(0)
    weights.initialise(made, generator=generator)
    frames = torch.from_numpy(images(spec, 8))
    made.image.calibrate(frames, generator=generator)
    made.calibrate(made.image(frames), generator=generator)
    return made


def images(spec: SkillsSpec, count: int, *, seed: int = 0) -> npt.NDArray[np.uint8]:
    shape = (count, spec.height, spec.width, spec.channels)
    return np.random.default_rng(seed).integers(0, 256, shape, np.uint8)


def nothing_executed(spec: SkillsSpec, count: int) -> npt.NDArray[np.float32] | npt.NDArray[np.int64]:
    return np.full((count, 1), -1, np.int64) if spec.action_choices else np.zeros((count, 2), np.float32)


def picture(*blobs: tuple[int, int, tuple[int, int, int]]) -> torch.Tensor:
    """Returns a dark frame, uint8 (1, 21, 41, 3), with a 3 x 3 blob of a colour around each (row, column)."""
    frame = np.full((1, 21, 41, 3), 20, np.uint8)
    for row, column, colour in blobs:
        frame[0, row - 1 : row + 2, column - 1 : column + 2] = colour
    return torch.from_numpy(frame)


RED, BLUE = (220, 30, 30), (30, 30, 220)


@pytest.fixture
def codebook() -> ColourCodebook:
    """A codebook that knows red and blue."""
    made = ColourCodebook(height=21, width=41, channels=3, colours=2)
    frames = [picture((4, 3 * i + 2, RED), (15, 38 - 3 * i, BLUE)) for i in range(12)]
    made.calibrate(torch.cat(frames), generator=torch.Generator().manual_seed(0))
    return made


def test_a_codebook_finds_the_colours_before_the_background_and_where_they_are(codebook: ColourCodebook) -> None:
    assert {tuple(colour) for colour in codebook.colours.round().int().tolist()} == {RED, BLUE}
    red = int(codebook.colours[:, 0].argmax())
    places = codebook(picture((5, 30, RED)))[0]
    expected = np.array([30 / 20 - 1, 5 / 10 - 1]) * 9 / 9.5  # drawn to the middle by half a pixel in nine
    np.testing.assert_allclose(places[red, 1:3], expected, atol=1e-3)
    np.testing.assert_allclose(places[1 - red], 0, atol=1e-3)


def test_what_is_moved_is_where_it_would_be_seen(codebook: ColourCodebook) -> None:
    here, there = codebook(picture((5, 12, RED), (9, 20, BLUE))), codebook(picture((5, 18, RED), (9, 26, BLUE)))
    np.testing.assert_allclose(moved(here, torch.tensor([6 / 20])), there, atol=2e-3)


def test_a_codebook_of_frames_without_anything_in_them_is_no_error() -> None:
    made = ColourCodebook(height=21, width=41, channels=3, colours=4)
    made.calibrate(torch.cat([picture()] * 3), generator=torch.Generator().manual_seed(0))
    assert torch.equal(made(picture()), torch.zeros(1, 4, 5))


@SPECS
def test_a_step_alone_is_the_same_as_in_a_batch(spec: SkillsSpec) -> None:
    policy, rng = SkillsPolicy(network(spec), handshake(spec)), np.random.default_rng(1)
    memory = rng.standard_normal((5, policy.memory_size)).astype(np.float32)
    frames, previous = images(spec, 5, seed=2), nothing_executed(spec, 5)
    goals = policy.encode_goals(["pick", "push", "pick", "push", "push"])
    together = policy.step(frames, goals, previous, memory)
    for one in (slice(i, i + 1) for i in range(5)):
        alone = policy.step(frames[one], goals[one], previous[one], memory[one])
        np.testing.assert_allclose(alone.actions, together.actions[one], atol=1e-5)
        np.testing.assert_allclose(alone.reached, together.reached[one], atol=1e-5)
        np.testing.assert_allclose(alone.memory, together.memory[one], atol=1e-5)


@SPECS
def test_actions_are_what_the_spec_says(spec: SkillsSpec) -> None:
    policy = SkillsPolicy(network(spec), handshake(spec))
    memory = np.zeros((3, policy.memory_size), np.float32)
    step = policy.step(images(spec, 3), policy.encode_goals(["pick"] * 3), nothing_executed(spec, 3), memory)
    assert step.actions.shape == (3, policy.horizon, policy.action_size)
    assert step.actions.dtype == (np.int64 if spec.action_choices else np.float32)
    assert step.actions.min() >= (0 if spec.action_choices else -1)
    assert step.actions.max() <= (3 if spec.action_choices else 1)
    assert step.memory.shape == memory.shape
    assert ((step.reached >= 0) & (step.reached <= 1)).all()


def test_what_was_executed_what_is_remembered_and_the_skill_all_count() -> None:
    policy = SkillsPolicy(network(CONTINUOUS), handshake(CONTINUOUS))
    frame, goals = images(CONTINUOUS, 1), policy.encode_goals(["pick", "push"])
    still, memory = np.zeros((1, 2), np.float32), np.zeros((1, policy.memory_size), np.float32)
    plain = policy.step(frame, goals[:1], still, memory)
    for other in (
        policy.step(frame, goals[1:], still, memory),
        policy.step(frame, goals[:1], still + 1, memory),
        policy.step(frame, goals[:1], still, memory + 1),
    ):
        assert not np.allclose(plain.actions, other.actions, atol=1e-6)


def test_a_skill_that_was_not_learned_is_refused() -> None:
    policy = SkillsPolicy(network(CONTINUOUS), handshake(CONTINUOUS))
    with pytest.raises(InvalidInput, match="pick, push; 1 of 2"):
        policy.encode_goals(["pick", "fly"])


@SPECS
def test_a_model_on_disk_acts_as_it_did(spec: SkillsSpec, tmp_path: Path) -> None:
    trained = network(spec)
    model_files.save_model(trained, tmp_path, card={"kind": "skills", **handshake(spec).to_card()})
    before, after = SkillsPolicy(trained, handshake(spec)), model.load(tmp_path, "cpu")
    assert isinstance(after, SkillsPolicy)
    assert (after.skills, after.reached_threshold, after.max_steps_per_goal) == (("pick", "push"), 0.5, 40)
    memory, goals = np.zeros((2, before.memory_size), np.float32), before.encode_goals(["pick", "push"])
    steps = [each.step(images(spec, 2), goals, nothing_executed(spec, 2), memory) for each in (before, after)]
    np.testing.assert_array_equal(steps[0].actions, steps[1].actions)
    np.testing.assert_array_equal(steps[0].reached, steps[1].reached)


@pytest.mark.parametrize(
    "spec", [{}, {"skills": [], "camera": "front"}, {"skills": ["a"], "camera": "", "channels": 2}]
)
def test_a_card_that_says_something_else_is_refused(spec: dict[str, object], tmp_path: Path) -> None:
    model_files.save_model(network(CONTINUOUS), tmp_path, card={"kind": "skills", **handshake(CONTINUOUS).to_card()})
    card = tmp_path / model_files.CARD
    card.write_text(json.dumps({**json.loads(card.read_text()), "spec": spec}))
    with pytest.raises(InvalidInput):
        model.load(tmp_path, "cpu")
