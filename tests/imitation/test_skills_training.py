from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from freerein.errors import InvalidInput
from freerein.learning.inputs import spec_of
from freerein.learning.training_loop import fit
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein.types.segmentation import FLAGGED
from freerein_imitation.methods.shared.skill_segments import (
    SkillSegment,
    find_segments,
    generous_limit,
    match_tags,
    split_segments,
)
from freerein_imitation.methods.skills.config import SkillsConfig
from freerein_imitation.methods.skills.losses import SkillsLearner
from freerein_imitation.methods.skills.network import SkillsSpec
from freerein_imitation.methods.skills.policy import SkillsPolicy
from freerein_imitation.methods.skills.skill_steps import end_at_waypoints, steps_of
from freerein_imitation.methods.skills.waypoints import Waypoints
from freerein_imitation.model.policy import ControlSpec

SKILLS = ("to-red", "to-blue")
MORE_SKILLS = ("wave", *SKILLS, "jump")
SIDE, STEP = 24, 2.0
HAND, RED, BLUE = (230, 230, 230), (220, 30, 30), (30, 30, 220)
CPU = torch.device("cpu")
CAMERAS = (Camera("front", 8, SIDE, 3),)
ACTION = ActionSpec(1, 0, ("right",))
FAST = SkillsConfig(
    steps=1200, batch_size=16, lr=5e-3, min_segment_steps=2, hidden_size=32, evaluate_every=400, augmentation=0.0
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
    spec = spec_of(config, SkillsSpec, cameras=cameras, action=action, skills=skills)
    return SkillsLearner.prepare(config, spec, demonstrations, labels, fingerprint="fingerprint", device=CPU)


def learner(config: SkillsConfig = FAST) -> SkillsLearner:
    demonstrations, labels = demonstrate(60, seed=0)
    return prepare(demonstrations, labels, config=config)


def policy_of(config: SkillsConfig, folder: Path) -> SkillsPolicy:
    cloned = learner(config)
    fitted = fit(cloned, folder)
    assert fitted is not None
    cloned.calibrate(fitted.network)
    return SkillsPolicy(fitted.network, ControlSpec(0.1, 0.5, generous_limit(cloned.segments)))


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> SkillsPolicy:
    return policy_of(replace(FAST, steps=400, lr=1e-2, evaluate_every=200), tmp_path_factory.mktemp("fit"))


def test_each_skill_moves_the_hand_towards_its_own_block(policy: SkillsPolicy) -> None:
    rng, right = np.random.default_rng(2), []
    for _ in range(40):
        hand, red, blue = rng.uniform(2, SIDE - 3), rng.uniform(2, 10), rng.uniform(13, SIDE - 3)
        start = np.zeros((2, 1), np.float32), np.zeros((2, policy.spec.recurrent_size), np.float32)
        step = policy.step(
            {"front": picture(hand, red, blue)[None].repeat(2, axis=0)}, policy.encode_goals(SKILLS), *start
        )
        for moved, goal in zip(step.actions[:, 0, 0], (red, blue), strict=True):
            right += [np.sign(moved) == np.sign(goal - hand)] * (abs(goal - hand) > STEP)
    assert np.mean(right) > 0.85


@pytest.mark.long
def test_recipes_never_demonstrated_are_executed(tmp_path: Path) -> None:
    policy = policy_of(replace(FAST, steps=2000), tmp_path)  # whatever the seed and the processor's rounding
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


def test_the_hand_is_found_by_its_own_motion_alone() -> None:
    cloned = learner(replace(FAST, steps=6000))  # 420 of them for the hand
    state, rng = cloned.init(torch.Generator().manual_seed(0)), np.random.default_rng(0)
    for _ in range(300):
        state, _ = cloned.update(state, rng.integers(0, cloned.size, 32))
    columns = np.linspace(2, SIDE - 3, 12)
    frames = torch.from_numpy(np.stack([picture(column, 6.0, 17.0) for column in columns]))
    with torch.inference_mode():
        places = state.network.hand(state.network.pixels({"front": frames}))[:, 0].numpy()
    assert np.abs(np.polyval(np.polyfit(places, columns, 1), places) - columns).max() < 1.5  # pixels, of 24


def test_where_an_object_goes_is_chosen_once(policy: SkillsPolicy) -> None:
    goal, nothing = policy.encode_goals(["to-red"]), np.zeros((1, 1), np.float32)
    start = np.zeros((1, policy.spec.recurrent_size), np.float32)
    chosen = policy.step({"front": picture(20.0, 5.0, 17.0)[None]}, goal, nothing, start).recurrent
    elsewhere = {"front": picture(3.0, 9.0, 17.0)[None]}
    np.testing.assert_array_equal(policy.step(elsewhere, goal, nothing, chosen).recurrent, chosen)
    assert not np.allclose(policy.step(elsewhere, goal, nothing, start).recurrent, chosen, atol=0.05)


def test_few_frames_like_those_of_the_fit_have_low_in_distribution_scores_and_noise_has(policy: SkillsPolicy) -> None:
    demonstrations, labels = demonstrate(25, seed=1)
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
    assert np.mean(np.array(told) < FLAGGED) <= 0.05
    noise = {"front": np.random.default_rng(0).integers(0, 256, (100, 8, SIDE, 3), np.uint8)}
    start = np.zeros((100, 1), np.float32), np.zeros((100, policy.spec.recurrent_size), np.float32)
    assert policy.step(noise, policy.encode_goals(["to-red"] * 100), *start).in_distribution.max() < FLAGGED


@pytest.mark.parametrize(("augmentation", "steps"), [(0.0, (0, 7, 13)), (1.0, (0, 9, 19))])
def test_each_part_of_a_fit_trains_its_own_layers(augmentation: float, steps: tuple[int, ...]) -> None:
    cloned = learner(replace(FAST, steps=100, augmentation=augmentation))
    state = cloned.init(torch.Generator().manual_seed(0))
    changed = []
    for step in steps:
        before = {name: each.clone() for name, each in state.network.state_dict().items()}
        state, _ = cloned.update(replace(state, step=step), np.arange(32))
        changed.append(
            {name.split(".")[0] for name, each in state.network.state_dict().items() if (each != before[name]).any()}
        )
    assert changed[:2] == [{"hand"}, {"maps"}]
    assert not changed[2] & {"hand", "maps"}
    assert {"input_layer", "waypoint_head", "termination_head"} <= changed[2]


def test_long_demonstrations_are_encoded_in_parts() -> None:
    demonstrations, labels = demonstrate(4, seed=0)
    long = Trajectories(
        {"front": [np.tile(each, (50, 1, 1, 1)) for each in demonstrations.frames["front"]]},
        [np.tile(each, (50, 1)) for each in map(np.asarray, demonstrations.actions)],
    )
    cloned = prepare(long, [np.tile(each, 50) for each in labels])
    state, at_once = cloned.init(torch.Generator().manual_seed(0)), []
    state.network.hand.register_forward_pre_hook(lambda _, args: at_once.append(len(args[0])))
    cloned.update(replace(state, step=FAST.steps - 1), np.arange(16))
    assert max(at_once) <= 256 < min(long.lengths())
    assert sum(at_once) == sum(long.lengths())


@pytest.mark.parametrize(
    ("names", "expected"),
    [(("dy", "Left.Gripper"), (False, True)), (("dy", "dz"), (False, False)), ((), (False, False))],
)
def test_a_gripper_is_known_by_its_name_in_any_case(names: tuple[str, ...], expected: tuple[bool, ...]) -> None:
    spec = spec_of(FAST, SkillsSpec, cameras=CAMERAS, action=ActionSpec(2, 0, names), skills=SKILLS)
    assert spec.is_gripper == expected


# Two skills of a hand, right and gripper by timestep: it goes right, closes, goes left, opens and retreats.
HANDLING = np.repeat(
    np.array([[1, 0], [0, -1], [-1, 0], [0, 1], [1, 0], [-1, 0], [0, -1], [1, 0], [0, 1], [-1, 0]], np.float32),
    [4, 2, 4, 2, 3, 5, 2, 4, 2, 3],
    axis=0,
)
GRIPPER = (False, True)


def handled(labelled_stop: int) -> tuple[list[SkillSegment], Trajectories, list[Waypoints]]:
    """Returns the segments of both skills, the first labelled up to some timestep; truly it ends at 15."""
    frames = np.zeros((len(HANDLING), 4, 4, 1), np.uint8)
    trajectories = Trajectories({"front": [frames]}, [HANDLING])
    segments = [SkillSegment(0, 0, labelled_stop, 0), SkillSegment(0, labelled_stop, len(HANDLING), 1)]
    return segments, trajectories, [Waypoints.of(HANDLING)]


@pytest.mark.parametrize("labelled_stop", [13, 15, 18])
def test_a_skill_ends_at_the_waypoint_after_its_release_whatever_its_label_says(labelled_stop: int) -> None:
    segments, trajectories, waypoints = handled(labelled_stop)
    exact = end_at_waypoints(segments, trajectories, waypoints, is_gripper=GRIPPER)
    assert [(each.start, each.stop) for each in exact] == [(0, 15), (15, 31)]
    untouched = end_at_waypoints(segments, trajectories, waypoints, is_gripper=(False, False))
    assert untouched == segments


def test_an_object_is_where_the_hand_grasps_carries_and_has_released_it() -> None:
    segments, trajectories, waypoints = handled(15)
    steps = steps_of(segments[:1], trajectories, waypoints, is_gripper=GRIPPER, steps_after=2)
    assert steps.object_at.tolist() == [5] * 6 + [6, 7, 8, 9] + [10] * 7
    assert steps.place_at.tolist() == [10] * 17
    assert steps.is_inside.tolist() == [True] * 15 + [False] * 2
    assert steps.terminates.tolist() == [False] * 14 + [True] * 3
    assert steps.previous[:3, 0].tolist() == [0, 1, 1]
    without = steps_of(segments[:1], trajectories, waypoints, is_gripper=(False, False), steps_after=0)
    assert without.object_at.tolist() == without.place_at.tolist() == [14] * 15


def test_waypoints_are_where_a_path_turns_without_noise_or_pauses() -> None:
    rng = np.random.default_rng(0)
    straight = np.repeat([[0.8, 0.0], [0.0, 0.0], [0.0, 0.8]], [6, 3, 5], axis=0)
    noisy = (straight + 0.03 * rng.standard_normal(straight.shape)).astype(np.float32)
    found = Waypoints.of(noisy)
    np.testing.assert_allclose(found.displacement[0], [4.8, 0], atol=0.3)
    np.testing.assert_allclose(found.displacement[3], [2.4, 0], atol=0.3)
    for pause in (6, 7, 8):
        np.testing.assert_allclose(found.displacement[pause], [0, 4], atol=0.3)
    assert len(set(found.upcoming.tolist())) <= 3


def test_whole_trajectories_are_for_validation() -> None:
    found = find_segments(demonstrate(20, seed=0)[1], min_steps=1)
    split = split_segments(found, fraction=0.2, seed=0)
    parts = [{item.trajectory for item in part} for part in (split.training, split.validation)]
    assert (len(parts[0]), len(parts[1]), parts[0] & parts[1]) == (16, 4, set())
    with pytest.raises(InvalidInput, match="at least 2 trajectories"):
        split_segments([SkillSegment(0, 0, 3, 0)], fraction=0.2, seed=0)


def test_skills_that_are_trained_are_numbered_without_gaps() -> None:
    labelled = [SkillSegment(item, 3 * at, 3 * at + 3, skill) for item in range(4) for at, skill in enumerate((4, 1))]
    split = split_segments(labelled, fraction=0.25, seed=0)
    assert (split.skills, len(split.training), len(split.validation)) == ((1, 4), 6, 2)
    assert [each.skill for each in split.training + split.validation] == [1, 0] * 4


def test_a_skill_that_tags_exclude_is_the_tagged_one_that_labels_lack_and_other_differences_are_left_out() -> None:
    shown = [(1, 0), (1, 2), (1, 0, 2), (1, 0), (1,), (1, 0), (3, 0)]
    tags = [{1, 0}, {1, 0}, {1, 0}, {1, 0, 2}, {1, 0}, (), {1, 2}]
    segments = [
        SkillSegment(item, 5 * place, 5 * place + 5, skill)
        for item, skills in enumerate(shown)
        for place, skill in enumerate(skills)
    ]
    kept = match_tags(segments, tags)
    assert [(each.trajectory, each.start, each.skill) for each in kept] == [
        *((0, 0, 1), (0, 5, 0)),  # as tagged
        *((1, 0, 1), (1, 5, 0)),  # one mistaken
        *((5, 0, 1), (5, 5, 0)),  # not tagged at all
    ]


def test_labels_that_take_one_skill_for_another_everywhere_are_mended_by_tags() -> None:
    demonstrations, labels = demonstrate(6, seed=0)
    confused = [np.where(each == 0, 1, 3) for each in labels]  # "to-blue" is taken for "jump"
    tagged = replace(demonstrations, skills=[SKILLS] * len(demonstrations))
    cloned, right = prepare(tagged, confused, skills=MORE_SKILLS), prepare(demonstrations, labels)
    assert cloned.spec.skills == SKILLS
    np.testing.assert_array_equal(cloned.training.skill, right.training.skill)


@pytest.mark.parametrize("seed", range(3))
def test_only_skills_that_were_learned_are_offered(seed: int) -> None:
    demonstrations, labels = demonstrate(6, seed=0)
    told = [each + 1 for each in labels]  # "wave" is never shown
    shown = {
        item.trajectory
        for item in prepare(demonstrations, told, config=replace(FAST, seed=seed), skills=MORE_SKILLS).segments
    }
    told[(set(range(6)) - shown).pop()][:6] = 3  # "jump" is shown once, by the trajectory that is held out
    cloned = prepare(demonstrations, told, config=replace(FAST, seed=seed), skills=MORE_SKILLS)
    assert cloned.spec.skills == SKILLS
    for steps in (cloned.training, cloned.validation):
        assert len(steps)
        inside = steps[steps.is_inside]
        for item, timestep, skill in zip(inside.trajectory, inside.timestep, inside.skill, strict=True):
            assert told[item][timestep] == skill + 1


def test_skills_held_out_that_nobody_else_shows_are_nothing_to_choose_weights_by() -> None:
    demonstrations, _ = demonstrate(2, seed=0)
    told = [np.full(len(done), skill) for skill, done in enumerate(demonstrations.actions)]
    with pytest.raises(InvalidInput, match="must show a skill"):
        prepare(demonstrations, told, skills=MORE_SKILLS)


def test_several_cameras_and_discrete_actions_are_refused() -> None:
    demonstrations, labels = demonstrate(6, seed=0)
    with pytest.raises(InvalidInput, match="1 camera; got 2"):
        prepare(demonstrations, labels, cameras=(*CAMERAS, Camera("wrist", 4, 16, 1)))
    with pytest.raises(InvalidInput, match="3 discrete choices"):
        prepare(demonstrations, labels, action=ActionSpec(1, 3, ("left", "hold", "right")))
