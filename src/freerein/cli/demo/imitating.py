"""Chapter 3 in the demo: unlabelled exploration, in; a policy that follows goal images never seen, out."""

import asyncio
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.cli.demo import following
from freerein.cli.demo.context import HELD_OUT, Context
from freerein.cli.demo.driving import Drive, Driver, Robots, Wanderer
from freerein.cli.demo.filmstrip import Pursued
from freerein.cli.demo.fits import RunningFit, start_fit
from freerein.clients import ImitationClient
from freerein.metrics import auroc
from freerein.types.common import Goal, ModelRef, Observation
from freerein.types.imitation import ActRequest, GetSpecRequest
from freerein.types.sim import DemonstrateRequest

_TASK, _DATASET, _CAMERA = "blocks", "exploration", "front"
_MODEL = ModelRef("goal-images")
_TRAJECTORIES = 400
_ROBOTS, _LANDMARKS = 64, 4
_EXPLORED = _LANDMARKS * following.EVERY_STEPS
_MARKS = following.landmarks(_EXPLORED + 1, count=_LANDMARKS)
_PAIRS, _CLOSE_STEPS, _FAR_STEPS = 600, 2, 15


@dataclass(frozen=True, eq=False)
class Following:
    """How well goal images were followed.

    Attributes:
        landmarks_reached: The share of landmarks at which the robot truly was while it pursued them.
        landmarks_recognized: The share at which it was when it went on to the next.
        random_landmarks_reached: The share that a random policy reaches, told by the true state when to go on.
        goal_auroc: Of the goal recognizer, on held-out pairs of frames a few or many timesteps apart.
        pursued: The landmarks of one robot, as they are drawn.
    """

    landmarks_reached: float
    landmarks_recognized: float
    random_landmarks_reached: float
    goal_auroc: float
    pursued: tuple[Pursued, ...]


async def record_exploration(context: Context) -> None:
    """Records a gripper that moves at random: images and its own actions, nothing else."""
    request = DemonstrateRequest(_TASK, "random", count=_TRAJECTORIES, seed=context.seed, cameras=(_CAMERA,))
    await context.record(_DATASET, request)


async def start_following(context: Context) -> RunningFit:
    """Starts to learn the policy and its goal recognizer."""
    config = {"policy": "goal_conditioned"}
    return await start_fit(context, "imitation", _DATASET, model_name=_MODEL.name, config=config)


async def follow(context: Context) -> Following:
    """Lets robots explore from unseen starts, takes landmarks from that, goes back, and has the policy follow them."""
    rng = np.random.default_rng(context.seed + HELD_OUT)
    async with context.sim() as sim, ImitationClient(context.channel("imitation")) as client:
        spec = await client.get_spec(GetSpecRequest(_MODEL))
        steps = _LANDMARKS * spec.max_steps_per_goal
        robots = Robots(sim, _TASK, camera=_CAMERA, count=_ROBOTS, seed=context.seed + HELD_OUT)
        async with robots:
            wanderer = Wanderer(robots.task.action.size, _ROBOTS, rng)
            explored = await robots.drive(wanderer, steps=_EXPLORED)
            driver = Driver(client, _MODEL, _goals(explored), _CAMERA)
            with context.screen.progress("follow goal images", steps) as advance:
                driven = await robots.drive(driver, steps=steps, on_step=advance)
            wandered = await robots.drive(Wanderer(robots.task.action.size, _ROBOTS, rng), steps=steps)
        recognized = await _goal_auroc(client, explored, rng)
    return _measured(explored, driven, driver, wandered, goal_auroc=recognized, max_steps=spec.max_steps_per_goal)


def _goals(explored: Drive) -> list[Goal]:
    encoded = [[images.encode(frame, encoding="raw_rgb8") for frame in frames] for frames in _at_marks(explored)]
    return [Goal(images=tuple(each)) for each in encoded]


def _at_marks(explored: Drive) -> npt.NDArray[np.uint8]:
    """Returns what each robot saw at its landmarks, uint8 (N, landmarks, H, W, C)."""
    return explored.frames[_MARKS].swapaxes(0, 1)


def _measured(
    explored: Drive, driven: Drive, driver: Driver, wandered: Drive, *, goal_auroc: float, max_steps: int
) -> Following:
    """Returns how well those robots followed whose exploration did not end before its last landmark."""
    followed, chance = {}, []
    indices = np.stack(driver.goal_index)  # (T, N)
    for robot in np.flatnonzero(explored.lengths > _EXPLORED).tolist():
        landmarks = explored.states[_MARKS, robot]
        moments = min(int(driven.lengths[robot]), len(indices))
        followed[robot] = following.followed(driven.states[:moments, robot], indices[:moments, robot], landmarks)
        states = wandered.states[: wandered.lengths[robot], robot]
        chance.append(following.by_chance(states, landmarks, max_steps=max_steps))
    shown = sorted(followed, key=lambda robot: float(followed[robot].when_left.mean()))[len(followed) // 2]
    return Following(
        landmarks_reached=_share([each.ever for each in followed.values()]),
        landmarks_recognized=_share([each.when_left for each in followed.values()]),
        random_landmarks_reached=_share(chance),
        goal_auroc=goal_auroc,
        pursued=_pursued(explored, driven, driver, followed[shown], shown),
    )


def _share(flags: list[following.Flags]) -> float:
    return float(np.concatenate(flags).mean())


def _pursued(
    explored: Drive, driven: Drive, driver: Driver, followed: following.Followed, robot: int
) -> tuple[Pursued, ...]:
    """Returns one robot's landmarks, those that it came to be done with."""
    index = np.stack(driver.goal_index)[:, robot]
    found = []
    for place, goal in enumerate(_at_marks(explored)[robot]):
        done = np.flatnonzero(index > place)
        if len(done):
            t = int(done[0])
            confidence = float(driver.confidence[t][robot])
            found.append(Pursued(goal, driven.frames[t, robot], t, confidence, bool(followed.when_left[place])))
    return tuple(found)


async def _goal_auroc(client: ImitationClient, explored: Drive, rng: np.random.Generator) -> float:
    """Returns the goal recognizer's AUROC on pairs of the exploration that the landmarks come from."""
    pairs = following.pairs(explored.lengths, rng, count=_PAIRS, close_steps=_CLOSE_STEPS, far_steps=_FAR_STEPS)

    async def confidence(seen: npt.NDArray[np.int64], goal: npt.NDArray[np.int64]) -> float:
        frames = (explored.frames[moment, robot] for robot, moment in (seen, goal))
        observation, wanted = (images.encode(frame, encoding="raw_rgb8", camera=_CAMERA) for frame in frames)
        request = ActRequest(Observation((observation,)), Goal(images=(wanted,)), model=_MODEL)
        return (await client.act(request)).goal_confidence

    confidences: list[float] = []
    for some in np.array_split(np.arange(_PAIRS), _PAIRS // _ROBOTS):
        asked = (confidence(pairs.observations[i], pairs.goals[i]) for i in some)
        confidences += await asyncio.gather(*asked)
    return auroc(np.array(confidences), pairs.close)
