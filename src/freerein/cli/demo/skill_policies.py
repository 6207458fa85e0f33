"""One policy per skill in the demo: cloned from demonstrations segmented by tags alone, executed by recipe."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from freerein.cli.commands.segment import label_all
from freerein.cli.demo.context import HELD_OUT_SEED, Context
from freerein.cli.demo.evaluation import recipes
from freerein.cli.demo.evaluation.recipes import SkillOutcome
from freerein.cli.demo.report import Figure
from freerein.cli.demo.rollout import RandomPolicy, RobotSession, Rollout, ServedPolicy
from freerein.cli.demo.segmentation import BLOCKS
from freerein.clients import ImitationClient, SegmentationClient
from freerein.types.common import Goal, ModelRef
from freerein.types.imitation import GetSpecRequest
from freerein.types.learning import Fit
from freerein.types.segmentation import SegmentRequest

_CAMERA = "front"
_MODEL = ModelRef("skills")
_ROBOTS, _STEPS = 40, 148  # an episode ends after 150


@dataclass(frozen=True)
class RecipeResult:
    """How well recipes were executed, of an order and a length that no demonstration had; shares in [0, 1].

    Attributes:
        completed: Skills completed.
        lifted: Skills whose block was lifted.
        random_completed: Skills that random actions complete in as many steps.
        random_lifted: Skills whose block random actions lift.
    """

    completed: float
    lifted: float
    random_completed: float
    random_lifted: float


async def label_demonstrations(context: Context) -> None:
    """Labels every timestep of the demonstrations by the segmentation model that was learned from their tags."""
    context.reporter.command(f"freerein segment {BLOCKS.train_dataset} --model {BLOCKS.task} --smoothing 1 --save")
    request = SegmentRequest(ModelRef(BLOCKS.task), smoothing=1.0)
    with context.reporter.progress(f"label {BLOCKS.train_dataset}", BLOCKS.train) as advance:
        async with SegmentationClient(context.channel("segmentation")) as client:
            await label_all(client, context.dataset(BLOCKS.train_dataset), request, camera=_CAMERA, on_count=advance)


async def start_fit(context: Context) -> tuple[str, Fit]:
    """Starts to clone the skills."""
    return await context.start_fit(
        "imitation", BLOCKS.train_dataset, model_name=_MODEL.name, config={"policy": "skills"}
    )


async def execute_recipes(context: Context) -> RecipeResult:
    """Has each robot execute all skills in an order of its own, from unseen starts."""
    seed = context.seed + HELD_OUT_SEED
    rng = np.random.default_rng(seed)
    async with context.sim() as sim, ImitationClient(context.channel("imitation")) as client:
        spec = await client.get_spec(GetSpecRequest(_MODEL))
        plans = [tuple(str(skill) for skill in rng.permutation(spec.skills)) for _ in range(_ROBOTS)]
        skill_steps = _STEPS // len(spec.skills)
        session = RobotSession(sim, BLOCKS.task, camera=_CAMERA, count=_ROBOTS, seed=seed)
        async with session:
            goals = [Goal(recipe=plan) for plan in plans]
            policy = ServedPolicy(client, _MODEL, goals, _CAMERA, max_steps_per_goal=skill_steps)
            with context.reporter.progress("execute recipes", _STEPS) as advance:
                executed = await session.rollout(policy, steps=_STEPS, on_step=advance)
            random = await session.rollout(RandomPolicy(session.task.action.size, _ROBOTS, rng), steps=_STEPS)
    outcomes = _outcomes(plans, executed, np.stack(policy.goal_index))
    timed = np.repeat((np.arange(_STEPS) // skill_steps).clip(max=len(spec.skills))[:, None], _ROBOTS, axis=1)
    random_outcomes = _outcomes(plans, random, timed)
    asked = _ROBOTS * len(spec.skills)
    return RecipeResult(
        completed=sum(each.completed for each in outcomes) / asked,
        lifted=sum(each.lifted for each in outcomes) / asked,
        random_completed=sum(each.completed for each in random_outcomes) / asked,
        random_lifted=sum(each.lifted for each in random_outcomes) / asked,
    )


def _outcomes(
    plans: Sequence[tuple[str, ...]], rollout: Rollout, goal_index: npt.NDArray[np.int64]
) -> list[SkillOutcome]:
    """Returns the outcome of each skill started before the robot's episode ended; `goal_index` is int64 (T, N)."""
    found = []
    for robot, plan in enumerate(plans):
        length = min(int(rollout.lengths[robot]), len(goal_index))
        started = recipes.attempts(plan, rollout.states[:length, robot], goal_index[:length, robot])
        found += [recipes.outcome(attempt) for attempt in started]
    return found


def figures(result: RecipeResult) -> tuple[Figure, ...]:
    """Returns the figures of recipes."""
    guess = "random actions"
    return (
        Figure("recipe.skills_completed", result.completed, result.random_completed, guess, beats_baseline=True),
        Figure("recipe.blocks_lifted", result.lifted, result.random_lifted, guess),
    )
