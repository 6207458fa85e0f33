"""Chapter 4 in the demo: the reward of an image against goal text, learned from unlabelled images and noun phrases."""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.cli.demo.context import HELD_OUT_SEED, Context
from freerein.cli.demo.evaluation.relations import true_relations, visible_pairs
from freerein.cli.demo.pictures import RewardExample
from freerein.cli.demo.report import Figure
from freerein.cli.demo.rollout import Rollout, robot_session
from freerein.clients import RewardClient
from freerein.metrics import balanced_accuracy, frame_accuracy, majority_accuracy
from freerein.types.common import ModelRef
from freerein.types.learning import Fit
from freerein.types.reward import GroundRequest, RewardRequest
from freerein.types.sim import DemonstrateRequest

MODEL = "blocks"
"""Name of the reward model."""

_TASK, _DATASET, _CAMERA = "blocks.scatter", "scatter", "front"
_PHRASES = ("a red block", "a green block", "a yellow block", "a blue block")
_TRAJECTORIES = 1000
_SESSIONS, _SCENES, _RANDOM_STEPS = 5, 64, 4
_DRAWN_TWO_BLOCKS = (0, 1, 2, 4)  # indices of the relations in the picture
_DRAWN_FOUR_BLOCKS = (0, 4)


@dataclass(frozen=True, eq=False)
class Scenes:
    """Held-out images and the true states behind them.

    Attributes:
        frames: uint8 (N, H, W, 3).
        states: float64 (N, S).
    """

    frames: npt.NDArray[np.uint8]
    states: npt.NDArray[np.float64]

    @classmethod
    def of_rollout(cls, rollout: Rollout) -> "Scenes":
        """Returns the first and the last frame of each robot whose episode did not end before."""
        whole = rollout.lengths == len(rollout.frames)
        ends = rollout.frames[[0, -1]][:, whole], rollout.states[[0, -1]][:, whole]
        return cls(*(np.concatenate(list(each)) for each in ends))


async def record(context: Context) -> None:
    """Records the training images: two blocks anywhere, a gripper that moves at random, no label."""
    request = DemonstrateRequest(_TASK, "random", count=_TRAJECTORIES, seed=context.seed, cameras=(_CAMERA,))
    await context.record(_DATASET, request)


async def start_fit(context: Context) -> tuple[str, Fit]:
    """Starts to learn the reward model."""
    return await context.start_fit("reward", _DATASET, model_name=MODEL, config={"phrases": list(_PHRASES)})


async def look_at_two_blocks(context: Context) -> Scenes:
    """Returns images of unseen scenes of two blocks, each at its start and after some random actions."""
    rng, scenes = np.random.default_rng(context.seed + HELD_OUT_SEED), []
    async with context.sim() as sim:
        for session in range(_SESSIONS):
            seed = context.seed + HELD_OUT_SEED + session
            async with robot_session(sim, _TASK, camera=_CAMERA, count=_SCENES, seed=seed) as robots:
                rollout = await robots.rollout(robots.random_policy(rng), steps=_RANDOM_STEPS)
                scenes.append(Scenes.of_rollout(rollout))
    return Scenes(np.concatenate([each.frames for each in scenes]), np.concatenate([each.states for each in scenes]))


async def classify(context: Context, name: str, scenes: Scenes) -> tuple[Figure, ...]:
    """Has the reward model choose among five sentences for every image and pair of visible blocks.

    Returns accuracy and balanced accuracy, `reward.<name>.*`.
    """
    winners, relations = [], []
    pairs = visible_pairs(scenes.states)
    async with RewardClient(context.channel("reward")) as client:
        with context.reporter.progress(f"rewards, {name.replace('_', ' ')}", len(pairs)) as advance:
            for done, (pair, indices) in enumerate(pairs.items(), 1):
                goal, *rivals = pair.texts
                frames = {_CAMERA: scenes.frames[indices]}
                answer = await client.reward(RewardRequest(goal, frames, rivals=tuple(rivals), model=ModelRef(MODEL)))
                winners.append(answer.winners)
                relations.append(true_relations(scenes.states[indices], pair))
                advance(done)
    predicted, truth = np.concatenate(winners), np.concatenate(relations)
    plain, balanced = frame_accuracy(predicted, truth), balanced_accuracy(predicted, truth)
    majority, constant = majority_accuracy(truth), 1 / len(np.unique(truth))
    return (
        Figure(f"reward.{name}.accuracy", plain, majority, "majority guess", beats_baseline=True),
        Figure(f"reward.{name}.balanced_accuracy", balanced, constant, "constant guess", beats_baseline=True),
    )


async def examples(context: Context, two_blocks: Scenes, four_blocks: Scenes) -> list[RewardExample]:
    """Returns the examples of the picture: the first image of each relation, from both kinds of scenes."""
    async with RewardClient(context.channel("reward")) as client:
        return [
            await _example(client, scenes, relation)
            for scenes, relations in ((two_blocks, _DRAWN_TWO_BLOCKS), (four_blocks, _DRAWN_FOUR_BLOCKS))
            for relation in relations
        ]


async def _example(client: RewardClient, scenes: Scenes, relation: int) -> RewardExample:
    """Returns the first image in which a relation holds, its groundings, and the similarity of each sentence."""
    for pair, indices in visible_pairs(scenes.states).items():
        truth = true_relations(scenes.states[indices], pair)
        if relation in truth:
            frame = scenes.frames[indices[np.argmax(truth == relation)]]
            break
    raw = RewardRequest(pair.texts[0], {_CAMERA: frame[None]}, mode="raw", model=ModelRef(MODEL))
    similarities = [(await client.reward(replace(raw, goal_text=text))).similarities[0] for text in pair.texts]
    grounded = await client.ground(GroundRequest(images.encode(frame, encoding="raw_rgb8"), pair.phrases))
    return RewardExample(
        image=frame,
        phrases=pair.phrases,
        heatmaps=[each.heatmap for each in grounded.groundings],
        pixels=[(each.x, each.y) for each in grounded.groundings],
        texts=pair.texts,
        similarities=np.array(similarities, np.float32),
        truth=relation,
    )
