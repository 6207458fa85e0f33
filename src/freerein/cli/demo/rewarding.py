"""Chapter 4 in the demo: unlabelled images and noun phrases, in; the reward of an image against goal text, out."""

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.cli.demo import relations
from freerein.cli.demo.context import HELD_OUT, Context
from freerein.cli.demo.fits import RunningFit, start_fit
from freerein.cli.demo.heatmaps import Judged
from freerein.cli.demo.relations import Pair
from freerein.clients import RewardClient, SimClient
from freerein.types.common import ModelRef
from freerein.types.reward import GroundRequest, RewardRequest
from freerein.types.sim import (
    CloseSessionRequest,
    CreateSessionRequest,
    DemonstrateRequest,
    ResetRequest,
    StepRequest,
    Truth,
)

MODEL = "blocks"
"""The name of the model that is learned."""

_TASK, _DATASET, _CAMERA = "blocks.scatter", "scatter", "front"
_TRAJECTORIES = 1000
_SCENES, _ROUNDS, _RANDOM_STEPS = 50, 6, 4
_DRAWN = (0, 1, 2, 4)  # of the relations, those that a picture is drawn of


@dataclass(frozen=True, eq=False)
class Judgements:
    """What the reward model said of held-out images, each asked of both orders of the two blocks on show.

    Attributes:
        said: int64 (M,), the relation that won, an index into `RELATIONS`.
        truth: int64 (M,), the one that holds.
    """

    said: npt.NDArray[np.int64]
    truth: npt.NDArray[np.int64]

    @property
    def accuracy(self) -> float:
        """The share of questions answered right."""
        return float(np.mean(self.said == self.truth))

    @property
    def balanced_accuracy(self) -> float:
        """The mean over relations of the share answered right."""
        return float(np.mean([np.mean(self.said[self.truth == r] == r) for r in np.unique(self.truth)]))


@dataclass(frozen=True, eq=False)
class _Scenes:
    """Held-out images: uint8 (N, H, W, 3), and the true states behind them, float64 (N, S)."""

    frames: npt.NDArray[np.uint8]
    states: npt.NDArray[np.float64]


async def record_scatter(context: Context) -> None:
    """Records what the reward model learns from: blocks anywhere, a gripper that moves at random, and no label."""
    request = DemonstrateRequest(_TASK, "random", count=_TRAJECTORIES, seed=context.seed, cameras=(_CAMERA,))
    await context.record(_DATASET, request)


async def start_reward(context: Context) -> RunningFit:
    """Starts to learn the reward model."""
    return await start_fit(context, "reward", _DATASET, model_name=MODEL, config={})


async def judge_held_out(context: Context) -> tuple[Judgements, tuple[Judged, ...]]:
    """Asks the reward model of images of unseen scenes; returns its answers, and some of them as they are drawn."""
    async with context.sim() as sim:
        scenes = await _look(sim, seed=context.seed + HELD_OUT)
    async with RewardClient(context.channel("reward")) as client:
        said, truth = [], []
        questions = relations.questions(scenes.states)
        with context.screen.progress("ask for rewards", len(questions)) as advance:
            for done, (pair, which) in enumerate(questions.items(), 1):
                answer = await client.reward(_request(pair, scenes.frames[which]))
                said.append(answer.winners)
                truth.append(relations.truth(scenes.states[which], pair))
                advance(done)
        drawn = [
            await _judged(client, pair, scenes.frames[index], int(relations.truth(scenes.states[[index]], pair)[0]))
            for pair, index in _picks(scenes)
        ]
    return Judgements(np.concatenate(said), np.concatenate(truth)), tuple(drawn)


def _request(pair: Pair, frames: npt.NDArray[np.uint8]) -> RewardRequest:
    goal, *rivals = pair.texts
    return RewardRequest(goal, {_CAMERA: frames}, rivals=tuple(rivals), model=ModelRef(MODEL))


async def _look(sim: SimClient, *, seed: int) -> _Scenes:
    """Returns images of many scenes, each as it begins and after some random actions."""
    created = await sim.create_session(CreateSessionRequest(_TASK, num_envs=_SCENES, seed=seed, privileged=True))
    rng, frames, states, step = np.random.default_rng(seed), [], [], 0
    for _ in range(_ROUNDS):
        begun = await sim.reset(ResetRequest(created.session, cameras=(_CAMERA,)))
        frames.append(begun.frames[_CAMERA])
        states.append(cast(Truth, begun.truth).state)
        goes_on = np.ones(_SCENES, np.bool_)
        for _ in range(_RANDOM_STEPS):
            step += 1
            actions = rng.uniform(-1, 1, (_SCENES, created.task.action.size)).astype(np.float32)
            stepped = await sim.step(StepRequest(created.session, step, actions, cameras=(_CAMERA,)))
            goes_on &= ~(stepped.terminated | stepped.truncated)  # else the frame is of the next episode
        frames.append(stepped.frames[_CAMERA][goes_on])
        states.append(cast(Truth, stepped.truth).state[goes_on])
    await sim.close_session(CloseSessionRequest(created.session))
    return _Scenes(np.concatenate(frames), np.concatenate(states))


def _picks(scenes: _Scenes) -> list[tuple[Pair, int]]:
    """Returns a question for each relation that is drawn, the first there is."""
    asked = relations.questions(scenes.states).items()
    truths = [(pair, which, relations.truth(scenes.states[which], pair)) for pair, which in asked]
    return [
        next((pair, int(which[np.argmax(truth == relation)])) for pair, which, truth in truths if relation in truth)
        for relation in _DRAWN
    ]


async def _judged(client: RewardClient, pair: Pair, frame: npt.NDArray[np.uint8], truth: int) -> Judged:
    """Returns one image, its groundings, and how well each relation's sentence fits it."""
    raw = RewardRequest(pair.texts[0], {_CAMERA: frame[None]}, mode="raw", model=ModelRef(MODEL))
    fits = [(await client.reward(replace(raw, goal_text=text))).similarities[0] for text in pair.texts]
    grounded = await client.ground(GroundRequest(images.encode(frame, encoding="raw_rgb8"), pair.phrases))
    return Judged(
        image=frame,
        phrases=pair.phrases,
        heatmaps=[each.heatmap for each in grounded.groundings],
        pixels=[(each.x, each.y) for each in grounded.groundings],
        texts=pair.texts,
        similarities=np.array(fits, np.float32),
        truth=truth,
    )
