"""One policy per skill in the demo: cloned from demonstrations segmented by tags alone, executed by recipe."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from freerein.cli.demo import recipes
from freerein.cli.demo.context import HELD_OUT, Context
from freerein.cli.demo.driving import Drive, Driver, Robots, Wanderer
from freerein.cli.demo.fits import RunningFit, start_fit
from freerein.cli.demo.segmenting import BLOCKS
from freerein.cli.labelling import label_all
from freerein.clients import ImitationClient, SegmentationClient
from freerein.types.common import Goal, ModelRef
from freerein.types.imitation import GetSpecRequest
from freerein.types.segmentation import SegmentRequest

_TASK, _CAMERA = BLOCKS.task, "front"
_MODEL = ModelRef("skills")
_ROBOTS, _STEPS = 40, 148  # an episode ends after 150


@dataclass(frozen=True)
class Executed:
    """How well recipes were executed, of an order and a length that no demonstration had.

    Attributes:
        skills_completed: The share of skills completed.
        lifted: The share whose block was lifted at all.
        random_completed: The share that a random policy completes, given as long.
    """

    skills_completed: float
    lifted: float
    random_completed: float


async def label_demonstrations(context: Context) -> None:
    """Labels every timestep of the demonstrations by the segmentation model that was learned from their tags."""
    context.screen.call(f"freerein segment {BLOCKS.train_name} --model {BLOCKS.task} --smoothing 1 --save")
    request = SegmentRequest(ModelRef(BLOCKS.task), smoothing=1.0)
    with context.screen.progress(f"label {BLOCKS.train_name}", BLOCKS.train) as advance:
        async with SegmentationClient(context.channel("segmentation")) as client:
            await label_all(client, context.dataset(BLOCKS.train_name), request, camera=_CAMERA, on_count=advance)


async def start_skills(context: Context) -> RunningFit:
    """Starts to clone the skills."""
    config = {"policy": "skills"}
    return await start_fit(context, "imitation", BLOCKS.train_name, model_name=_MODEL.name, config=config)


async def execute(context: Context) -> Executed:
    """Has robots execute recipes of all skills, each in an order of its own, from unseen starts."""
    seed = context.seed + HELD_OUT
    rng = np.random.default_rng(seed)
    async with context.sim() as sim, ImitationClient(context.channel("imitation")) as client:
        spec = await client.get_spec(GetSpecRequest(_MODEL))
        plans = [tuple(str(skill) for skill in rng.permutation(spec.skills)) for _ in range(_ROBOTS)]
        share = _STEPS // len(spec.skills)  # of the episode, for each skill
        robots = Robots(sim, _TASK, camera=_CAMERA, count=_ROBOTS, seed=seed)
        async with robots:
            driver = Driver(client, _MODEL, [Goal(recipe=plan) for plan in plans], _CAMERA, max_steps_per_goal=share)
            with context.screen.progress("execute recipes", _STEPS) as advance:
                driven = await robots.drive(driver, steps=_STEPS, on_step=advance)
            wandered = await robots.drive(Wanderer(robots.task.action.size, _ROBOTS, rng), steps=_STEPS)
    done = _outcomes(plans, driven, np.stack(driver.goal_index))
    by_chance = np.repeat((np.arange(_STEPS) // share).clip(max=len(spec.skills))[:, None], _ROBOTS, axis=1)
    asked = _ROBOTS * len(spec.skills)
    return Executed(
        skills_completed=recipes.skills_completed(done, asked=asked),
        lifted=recipes.lifted_rate(done, asked=asked),
        random_completed=recipes.skills_completed(_outcomes(plans, wandered, by_chance), asked=asked),
    )


def _outcomes(
    plans: Sequence[tuple[str, ...]], drive: Drive, goal_index: "np.ndarray[tuple[int, ...], np.dtype[np.int64]]"
) -> list[recipes.Outcome]:
    """Returns what came of each turn that robots came to, `goal_index` int64 (T, N), before their episodes ended."""
    found = []
    for robot, plan in enumerate(plans):
        moments = min(int(drive.lengths[robot]), len(goal_index))
        turns = recipes.turns(plan, drive.states[:moments, robot], goal_index[:moments, robot])
        found += [recipes.judge(turn) for turn in turns]
    return found
