"""One policy per skill in the demo: cloned from demonstrations segmented by tags alone, executed by recipe."""

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt

from freerein.cli.commands.segment import label_all
from freerein.cli.demo.context import HELD_OUT_SEED, Context
from freerein.cli.demo.evaluation import recipes
from freerein.cli.demo.evaluation.recipes import SkillOutcome
from freerein.cli.demo.report import Figure
from freerein.cli.demo.rollout import Rollout, ServedPolicy, robot_session
from freerein.cli.demo.segmentation import BLOCKS
from freerein.clients import ImitationClient, SegmentationClient
from freerein.types.common import Goal, ModelRef
from freerein.types.imitation import GetSpecRequest
from freerein.types.learning import Fit
from freerein.types.segmentation import SegmentRequest

_CAMERA = "front"
_MODEL = ModelRef("skills")
_ROBOTS, _STEPS = 40, 148  # an episode ends after 150


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
        "imitation", BLOCKS.train_dataset, model_name=_MODEL.name, config={"method": "skills"}
    )


async def execute_recipes(context: Context) -> tuple[Figure, ...]:
    """Has each robot execute all skills in an order of its own, from unseen starts; no demonstration had such a recipe.

    Returns the shares of skills completed and of blocks lifted; random actions have as many steps per skill.
    """
    seed = context.seed + HELD_OUT_SEED
    rng = np.random.default_rng(seed)
    async with context.sim() as sim, ImitationClient(context.channel("imitation")) as client:
        spec = await client.get_spec(GetSpecRequest(_MODEL))
        plans = [tuple(str(skill) for skill in rng.permutation(spec.skills)) for _ in range(_ROBOTS)]
        skill_steps = _STEPS // len(spec.skills)
        async with robot_session(sim, BLOCKS.task, camera=_CAMERA, count=_ROBOTS, seed=seed) as session:
            goals = [Goal(recipe=plan) for plan in plans]
            policy = ServedPolicy(client, _MODEL, goals, _CAMERA, max_steps_per_goal=skill_steps)
            with context.reporter.progress("execute recipes", _STEPS) as advance:
                executed = await session.rollout(policy, steps=_STEPS, on_step=advance)
            random = await session.rollout(session.random_policy(rng), steps=_STEPS)
    outcomes = _outcomes(plans, executed, np.stack(policy.goal_index))
    timed = np.repeat((np.arange(_STEPS) // skill_steps).clip(max=len(spec.skills))[:, None], _ROBOTS, axis=1)
    random_outcomes = _outcomes(plans, random, timed)

    def share(flags: Iterable[bool]) -> float:
        return sum(flags) / (_ROBOTS * len(spec.skills))

    completed, lifted = share(each.completed for each in outcomes), share(each.lifted for each in outcomes)
    random_completed = share(each.completed for each in random_outcomes)
    random_lifted = share(each.lifted for each in random_outcomes)
    return (
        Figure("recipe.skills_completed", completed, random_completed, "random actions", beats_baseline=True),
        Figure("recipe.blocks_lifted", lifted, random_lifted, "random actions"),
    )


def _outcomes(
    plans: Sequence[tuple[str, ...]], rollout: Rollout, goal_index: npt.NDArray[np.int64]
) -> list[SkillOutcome]:
    """Returns the outcome of each skill started before the robot's episode ended; `goal_index` is int64 (T, N)."""
    found = []
    for robot, plan in enumerate(plans):
        length = min(int(rollout.lengths[robot]), len(goal_index))
        started = recipes.attempts(plan, rollout.states[:length, robot], goal_index[:length, robot])
        found += [recipes.outcome(skill, states) for skill, states in started]
    return found
