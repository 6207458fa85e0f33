from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.encoders import SpatialEncoder
from freerein.learning.fit import fit
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.model.policy import ControlSpec
from freerein_imitation.model.skills import SkillsPolicy
from freerein_imitation.training.skill_segments import (
    SegmentDataset,
    SkillSegment,
    collate,
    find_segments,
    split_segments,
)
from freerein_imitation.training.skills import (
    TERMINATION_THRESHOLD,
    SkillsConfig,
    SkillsLearner,
    encode,
    network_spec,
)

SKILLS = ("to-red", "to-blue")
MORE_SKILLS = ("wave", *SKILLS, "jump")
SIDE, STEP = 24, 2.0
HAND, RED, BLUE = (230, 230, 230), (220, 30, 30), (30, 30, 220)
CPU = torch.device("cpu")
CAMERAS = (Camera("front", 8, SIDE, 3),)
ACTION = ActionSpec(1, 0, ("right",))
FAST = SkillsConfig(
    steps=250,
    batch_size=8,
    lr=5e-3,
    min_segment_steps=2,
    start_jitter=1,
    features=15,
    hidden_size=32,
    recurrent_size=16,
    evaluate_every=125,
)


def picture(hand: float, red: float, blue: float) -> npt.NDArray[np.uint8]:
    """Returns a dark frame with a hand in its upper and two blocks in its lower half: uint8 (8, 24, 3)."""
    frame = np.full((8, SIDE, 3), 20, np.uint8)
    for row, column, colour in ((1, hand, HAND), (5, red, RED), (5, blue, BLUE)):
        share = np.clip(2 - np.abs(np.arange(SIDE) - column), 0, 1)[:, None]
        frame[row : row + 2] = np.round(frame[row : row + 2] * (1 - share) + np.array(colour) * share)
    return frame


def towards(hand: float, goal: float) -> float:
    """Returns the expert's action: how far it moves, 2 pixels at most."""
    return float(np.clip((goal - hand) / STEP, -1, 1))


def demonstrate(count: int, *, seed: int) -> tuple[Trajectories, list[npt.NDArray[np.int64]]]:
    """Returns trajectories in which a hand goes above one block and then above the other, and which skill that is."""
    rng = np.random.default_rng(seed)
    frames, actions, labels = [], [], []
    for _ in range(count):
        hand, red, blue = rng.uniform(2, SIDE - 3), rng.uniform(2, 10), rng.uniform(13, SIDE - 3)
        seen, done, told = [], [], []
        for skill in rng.permutation(2):
            goal = (red, blue)[skill]
            for _ in range(12):
                action = towards(hand, goal)
                seen.append(picture(hand, red, blue))
                done.append([action])
                told.append(skill)
                if abs(action) < 0.05:
                    break
                hand += STEP * action
        frames.append(np.array(seen))
        actions.append(np.array(done, np.float32))
        labels.append(np.array(told, np.int64))
    return Trajectories({"front": frames}, actions), labels


def prepare(
    demonstrations: Trajectories,
    labels: list[npt.NDArray[np.int64]],
    *,
    config: SkillsConfig = FAST,
    cameras: tuple[Camera, ...] = CAMERAS,
    action: ActionSpec = ACTION,
    skills: tuple[str, ...] = SKILLS,
) -> SkillsLearner:
    spec = network_spec(config, cameras=cameras, action=action, skills=skills)
    return SkillsLearner.prepare(config, spec, demonstrations, labels, fingerprint="fingerprint", device=CPU)


def learner(config: SkillsConfig = FAST) -> SkillsLearner:
    demonstrations, labels = demonstrate(60, seed=0)
    return prepare(demonstrations, labels, config=config)


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> SkillsPolicy:
    cloned = learner()
    fitted = fit(cloned, tmp_path_factory.mktemp("fit"))
    assert fitted is not None
    cloned.calibrate(fitted.network)
    return SkillsPolicy(fitted.network, ControlSpec(0.1, TERMINATION_THRESHOLD, cloned.max_steps_per_skill))


def test_recipes_never_demonstrated_are_executed(policy: SkillsPolicy) -> None:
    hand, red, blue = 20.0, 5.0, 17.0
    previous = np.zeros((1, 1), np.float32)
    for skill, goal in (("to-red", red), ("to-blue", blue), ("to-red", red)):
        recurrent, steps, ended = np.zeros((1, policy.spec.recurrent_size), np.float32), 0, False
        while not ended and steps < policy.spec.max_steps_per_goal:
            seen = {"front": picture(hand, red, blue)[None]}
            step = policy.step(seen, policy.encode_goals([skill]), previous, recurrent)
            previous, recurrent = step.actions[:, 0], step.recurrent
            ended = step.reached[0] >= policy.spec.reached_threshold
            hand, steps = hand + STEP * float(previous[0, 0]) * (not ended), steps + 1
        assert ended
        assert abs(hand - goal) < 1.5


def test_held_out_frames_have_every_in_distribution_score_alike_and_noise_has_low_ones(policy: SkillsPolicy) -> None:
    demonstrations, labels = demonstrate(60, seed=1)
    told: list[float] = []
    for item, skills in enumerate(labels):
        frames, actions = demonstrations.frames["front"][item], demonstrations.actions[item]
        before = np.concatenate([np.zeros((1, 1), np.float32), actions[:-1]])
        recurrent = np.zeros((1, policy.spec.recurrent_size), np.float32)
        for t, skill in enumerate(skills):
            if t and skill != skills[t - 1]:
                recurrent = np.zeros_like(recurrent)
            goal = policy.encode_goals([SKILLS[skill]])
            output = policy.step({"front": frames[t : t + 1]}, goal, before[t : t + 1], recurrent)
            recurrent = output.recurrent
            told.append(float(output.in_distribution[0]))
    assert np.abs(np.sort(told) - np.linspace(0, 1, len(told))).max() < 0.2
    noise = {"front": np.random.default_rng(0).integers(0, 256, (100, 8, SIDE, 3), np.uint8)}
    start = np.zeros((100, 1), np.float32), np.zeros((100, policy.spec.recurrent_size), np.float32)
    assert policy.step(noise, policy.encode_goals(["to-red"] * 100), *start).in_distribution.max() < 0.05


@pytest.mark.parametrize("encoder", ["spatial", "convolutional"])
def test_skills_are_learned_by_an_encoder_that_is_trained_with_them(encoder: str, tmp_path: Path) -> None:
    demonstrations, labels = demonstrate(12, seed=0)
    config = replace(FAST, encoder=encoder, features=16, steps=60, lr=3e-3, evaluate_every=60)
    cloned = prepare(demonstrations, labels, config=config)
    before = cloned.init(torch.Generator().manual_seed(0))
    fitted = fit(cloned, tmp_path)
    assert fitted is not None
    assert fitted.network.attention is None
    assert fitted.validation_loss < 0.8 * cloned.evaluate(before)
    assert not torch.equal(*(next(each.encoder.parameters()) for each in (fitted.network, before.network)))


def test_a_frozen_encoder_keeps_the_weights_that_made_the_features(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SpatialEncoder, "is_trained", False)
    demonstrations, labels = demonstrate(6, seed=0)
    cloned = prepare(demonstrations, labels, config=replace(FAST, encoder="spatial", features=16))
    state, _ = cloned.update(cloned.init(torch.Generator().manual_seed(0)), np.arange(4))
    assert cloned.training.features is not None
    assert torch.equal(encode(state.network.encoder, demonstrations, [0])[0], cloned.training.features[0])


@pytest.mark.parametrize("encoder", ["colour_codebook", "spatial"])
def test_two_cameras_of_different_sizes_are_both_learned_from(encoder: str) -> None:
    demonstrations, labels = demonstrate(6, seed=0)
    front = [demonstrations.frames["front"][item] for item in range(6)]
    wrist = [each[:, ::2, :16, :1] for each in front]
    cameras = (*CAMERAS, Camera("wrist", 4, 16, 1))
    both = Trajectories({"front": front, "wrist": wrist}, demonstrations.actions)
    cloned = prepare(both, labels, config=replace(FAST, encoder=encoder, features=17), cameras=cameras)
    state, figures = cloned.update(cloned.init(torch.Generator().manual_seed(0)), np.arange(4))
    assert np.isfinite(list(figures.values())).all()
    assert np.isfinite(cloned.evaluate(state))
    policy = SkillsPolicy(state.network, ControlSpec(0.1, 0.5, 30))
    previous, recurrent = np.zeros((2, 1), np.float32), np.zeros((2, policy.spec.recurrent_size), np.float32)
    frames, goals = {"front": front[0][:2], "wrist": wrist[0][:2]}, policy.encode_goals(["to-red", "to-blue"])
    for camera, seen in frames.items():
        steps = [policy.step(each, goals, previous, recurrent) for each in (frames, frames | {camera: 255 - seen})]
        assert not np.allclose(steps[0].actions, steps[1].actions)


def test_the_same_seed_gives_the_same_weights_and_another_seed_others(tmp_path: Path) -> None:
    def digest(name: str, seed: int) -> str:
        config = replace(FAST, steps=3, seed=seed)
        fitted = fit(learner(config), tmp_path / name)
        assert fitted is not None
        return weights.sha256(fitted.network)

    assert digest("first", 0) == digest("again", 0) != digest("other", 1)


def test_segments_are_runs_of_one_label_that_are_long_enough() -> None:
    labels = [np.array([0, 0, 0, 1, 0, 0]), np.array([1, 1])]
    assert find_segments(labels, min_steps=2) == [
        SkillSegment(0, 0, 3, 0),
        SkillSegment(0, 4, 6, 0),
        SkillSegment(1, 0, 2, 1),
    ]


def segments(*items: SkillSegment) -> SegmentDataset:
    """Returns segments of one trajectory of 6 timesteps in which action t is t / 10."""
    actions = np.arange(6, dtype=np.float32)[:, None] / 10
    frames = np.arange(6, dtype=np.uint8)[:, None, None, None]
    return SegmentDataset(items, Trajectories({"front": [frames]}, [actions]), {0: torch.arange(6.0)[:, None]})


def test_a_segment_is_followed_by_timesteps_that_only_the_end_head_learns_from() -> None:
    some = segments(SkillSegment(0, 1, 4, 1), SkillSegment(0, 4, 6, 0))
    batch = collate(some, some.segments, [2, 4], steps_after=1, device=CPU)
    assert batch.skills.tolist() == [1, 0]
    assert isinstance(batch.images, torch.Tensor)
    assert (batch.images[:, 0].tolist(), batch.lengths) == ([2, 3, 4, 4, 5], [3, 2])
    assert batch.previous[0, :, 0].tolist() == pytest.approx([0.1, 0.2, 0.3])
    assert batch.actions[0, :, 0].tolist() == pytest.approx([0.2, 0.3, 0.4])
    assert batch.inside.tolist() == [[True, True, False], [True, True, False]]
    assert batch.terminates.tolist() == [[False, True, True], [False, True, False]]


def test_before_the_first_timestep_nothing_was_executed() -> None:
    some = segments(SkillSegment(0, 0, 3, 0))
    assert collate(some, some.segments, [0], steps_after=0, device=CPU).previous[0, 0].tolist() == [0]
    chosen = Trajectories(some.trajectories.frames, [np.arange(6)[:, None]])
    discrete = SegmentDataset(some.segments, chosen, some.features)
    assert collate(discrete, some.segments, [0], steps_after=0, device=CPU).previous[0, :, 0].tolist() == [-1, 0, 1]


def test_whole_trajectories_are_for_validation() -> None:
    demonstrations, labels = demonstrate(20, seed=0)
    found = SegmentDataset(find_segments(labels, min_steps=1), demonstrations)
    training, validation = split_segments(found, fraction=0.2, seed=0)
    parts = [{item.trajectory for item in part.segments} for part in (training, validation)]
    assert (len(parts[0]), len(parts[1]), parts[0] & parts[1]) == (16, 4, set())
    with pytest.raises(InvalidInput, match="at least 2 trajectories"):
        split_segments(segments(SkillSegment(0, 0, 3, 0)), fraction=0.2, seed=0)


@pytest.mark.parametrize("seed", range(3))
def test_only_skills_that_were_learned_are_offered(seed: int) -> None:
    demonstrations, labels = demonstrate(6, seed=0)
    told = [each + 1 for each in labels]  # "wave" is never shown
    held_out = set(range(6)) - {
        item.trajectory
        for item in prepare(demonstrations, told, config=replace(FAST, seed=seed), skills=MORE_SKILLS).training.segments
    }
    told[held_out.pop()][:6] = 3  # "jump" is shown once, by the trajectory that is held out
    cloned = prepare(demonstrations, told, config=replace(FAST, seed=seed), skills=MORE_SKILLS)
    assert cloned.spec.skills == SKILLS
    for part in (cloned.training, cloned.validation):
        assert part.segments
        assert all(set(told[item.trajectory][item.start : item.stop]) == {item.skill + 1} for item in part.segments)


def test_skills_held_out_that_nobody_else_shows_are_nothing_to_choose_weights_by() -> None:
    demonstrations, _ = demonstrate(2, seed=0)
    told = [np.full(len(done), skill) for skill, done in enumerate(demonstrations.actions)]
    with pytest.raises(InvalidInput, match="must show a skill"):
        prepare(demonstrations, told, skills=MORE_SKILLS)


def test_discrete_actions_are_learned_too() -> None:
    demonstrations, labels = demonstrate(6, seed=0)
    moves = Trajectories(demonstrations.frames, [np.sign(done).astype(np.int64) + 1 for done in demonstrations.actions])
    discrete = prepare(moves, labels, action=ActionSpec(1, 3, ("left", "hold", "right")))
    state, figures = discrete.update(discrete.init(torch.Generator().manual_seed(0)), np.arange(4))
    assert state.step == 1
    assert np.isfinite(list(figures.values())).all()
    assert np.isfinite(discrete.evaluate(state))


def test_a_configuration_is_read_strictly_from_the_numbers_of_a_struct() -> None:
    assert SkillsConfig.from_mapping({"steps": 20.0, "encoder": "spatial"}) == SkillsConfig(steps=20, encoder="spatial")
    for wrong in ({"labels": True}, {"steps": 0}, {"encoder": "eye"}, {"random_start_fraction": 1.5}):
        with pytest.raises(InvalidInput):
            SkillsConfig.from_mapping(wrong)
