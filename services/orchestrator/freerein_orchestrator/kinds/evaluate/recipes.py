"""Form `recipes`: each robot executes a recipe that the task draws, by default as long as they come.

A skill counts by true states: the task's predicates `completed/SKILL` and, where it offers them, `lifted/SKILL` judge
its attempt. A skill that the policy never learned is skipped, and not completed. The task's random behaviour with as
many steps per skill is the baseline.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from freerein.clients import SyncClient
from freerein.config import bounded
from freerein.errors import InvalidInput
from freerein.types.common import Goal
from freerein.types.sim import DrawRecipesRequest, Recipe, Task
from freerein_orchestrator.envs.episodes import Episode, run_episodes
from freerein_orchestrator.envs.policies import PolicyHandle, explorer_policy
from freerein_orchestrator.envs.random_policies import exploration_policy
from freerein_orchestrator.envs.truth import Flags, States, TruthSession, check_predicates, truth_session
from freerein_orchestrator.kinds.evaluate.form import FILMED, Form, Result, Setup, Trial, share_figure
from freerein_orchestrator.kinds.evaluate.policies import PolicyConfig, check_no_goal, check_policy, find_policy

COMPLETED, LIFTED = "completed", "lifted"
WHOLE = "whole"
"""Figure: the share of recipes all of whose skills are completed."""


@dataclass(frozen=True, kw_only=True)
class RecipesConfig(PolicyConfig):
    """Configuration of the form `recipes`.

    Attributes:
        form: The form.
        skills_per_recipe: Skills of each recipe; 0 means the most that a recipe of the task has.
        steps_per_skill: Steps after which a skill is abandoned; 0 leaves it to `step_limits`.
        episode_steps: Steps of an episode, in which all skills are to be executed; 0 means the task's own.
        step_limits: `equal` shares the steps of an episode equally among the skills, `own` are the model's, which may
            differ between skills.
    """

    form: Literal["recipes"] = "recipes"
    skills_per_recipe: int = bounded(0, least=0, most=256)
    steps_per_skill: int = bounded(0, least=0, most=10_000)
    episode_steps: int = bounded(0, least=0, most=10_000)
    step_limits: Literal["equal", "own"] = "equal"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_no_goal(self)


class RecipesEvaluation:
    """Has the policy execute recipes.

    Attributes:
        subject: The policy.
    """

    def __init__(self, setup: Setup[RecipesConfig]) -> None:
        task = setup.task
        if not task.skills:
            raise InvalidInput(
                f"The form recipes needs a task with skills; {task.name} has none.",
                field="config.task",
                hint="Choose another task, or another form.",
            )
        check_predicates(task, [f"{COMPLETED}/{skill}" for skill in task.skills], form=setup.config.form)
        offered = {predicate.name for predicate in task.predicates}
        self._predicates = [
            name for name in (COMPLETED, LIFTED) if {f"{name}/{skill}" for skill in task.skills} <= offered
        ]
        self._setup = setup
        self._length = setup.config.skills_per_recipe or task.max_skills
        asked, own = setup.config.steps_per_skill, setup.config.step_limits == "own"
        episode_steps = setup.config.episode_steps or task.max_episode_steps
        self._max_steps = asked or max(1, episode_steps // self._length)
        self._steps = episode_steps if own and not asked else self._max_steps * self._length
        self._policy = find_policy(setup, max_steps_per_goal=asked if own else self._max_steps)
        self.subject: dict[str, Any] = self._policy.description

    def run_round(self, first: int, count: int) -> Sequence[Trial]:
        """Returns trials `first` to `first + count`."""
        setup, policy = self._setup, self._policy
        drawn = self._draw_recipes(first, count)
        recipes = [recipe.skills for recipe in drawn]
        request = setup.session(
            count, first, height=policy.height, width=policy.width, max_steps=setup.config.episode_steps
        )
        goals, steps = [Goal(recipe=known_skills(recipe, policy.skills)) for recipe in recipes], self._steps
        episodes = run_episodes(
            setup.sim, request, policy, setup.interrupt, goals=goals, recipes=drawn, max_steps=steps
        )
        executed = [
            replace(each, goal_index=places_in_recipe(each.goal_index, recipe, policy.skills))
            for each, recipe in zip(episodes, recipes, strict=True)
        ]
        random = random_behaviour(setup.sim, setup.task)
        baseline = run_episodes(setup.sim, request, random, setup.interrupt, recipes=drawn, max_steps=steps)
        with truth_session(setup.sim, setup.task.name) as truth:
            checker = _AttemptChecker(truth, self._predicates, self._max_steps)
            outcomes = checker.outcomes(recipes, executed)
            by_chance = checker.outcomes(recipes, baseline)
        return [
            Trial(
                {
                    "recipe": list(recipe),
                    **own,
                    **{f"baseline_{name}": flags for name, flags in chance.items()},
                    "skills_completed": float(np.mean(own[COMPLETED])),
                },
                {FILMED: episode.actions},
            )
            for recipe, own, chance, episode in zip(recipes, outcomes, by_chance, episodes, strict=True)
        ]

    def _draw_recipes(self, first: int, count: int) -> Sequence[Recipe]:
        """Returns the recipes of trials `first` to `first + count`.

        Raises:
            InvalidInput: The task has no recipes of so many skills.
        """
        setup = self._setup
        request = DrawRecipesRequest(
            setup.task.name,
            count,
            setup.seed(first),
            min_skills=self._length,
            max_skills=self._length,
            conditions=setup.config.conditions,
        )
        reply = setup.sim.draw_recipes(request)
        return reply.recipes

    def result(self, trials: Sequence[Trial]) -> Result:
        """Returns the figures of all trials."""
        values, seed = [trial.values for trial in trials], self._setup.config.seed
        figures = {}
        for name in self._predicates:
            flags, chance = [each[name] for each in values], [each[f"baseline_{name}"] for each in values]
            if figure := share_figure(flags, chance, seed=seed):
                figures[f"skills_{name}"] = figure
        whole, by_chance = ([[all(each[name])] for each in values] for name in (COMPLETED, f"baseline_{COMPLETED}"))
        if figure := share_figure(whole, by_chance, seed=seed):
            figures[WHOLE] = figure
        counts = {"episodes": len(values), "skills": sum(len(each["recipe"]) for each in values)}
        config = self._setup.config
        film = self._setup.film(
            0,
            trials[0],
            self._policy,
            recipes=self._draw_recipes(0, min(config.num_envs, config.episodes))[:1],
            episode_steps=config.episode_steps,
        )
        return Result(figures, counts, film=film)


def random_behaviour(sim: SyncClient, task: Task) -> PolicyHandle:
    """Returns the task's random behaviour: its explorer where it has one, else smooth random actions."""
    return explorer_policy(sim) if task.has_explorer else exploration_policy(task.action)


def known_skills(recipe: Sequence[str], known: Collection[str]) -> tuple[str, ...]:
    """Returns the skills of a recipe that a policy knows, one that it knows if there are none; `known` empty: all."""
    return tuple(skill for skill in recipe if not known or skill in known) or tuple(known)[:1]


def places_in_recipe(
    goal_index: npt.NDArray[np.int64] | None, recipe: Sequence[str], known: Collection[str]
) -> npt.NDArray[np.int64] | None:
    """Returns the places in a recipe that goal indices stand for, int64 (T,), where a policy skips unknown skills."""
    if goal_index is None:
        return None
    places = [place for place, skill in enumerate(recipe) if not known or skill in known]
    return np.array([*places, len(recipe), len(recipe)])[goal_index]


@dataclass(frozen=True)
class _AttemptChecker:
    """Checks attempts at skills by true states.

    Attributes:
        truth: The privileged session.
        predicates: Names of the checked predicates: `completed`, `lifted`.
        max_steps: Steps per skill of a policy that does not say which skill it executes.
    """

    truth: TruthSession
    predicates: Sequence[str]
    max_steps: int

    def outcomes(self, recipes: Sequence[Sequence[str]], episodes: Sequence[Episode]) -> list[dict[str, list[bool]]]:
        """Returns for each episode, by predicate, whether it held for each skill of the recipe."""
        found = [{name: [False] * len(recipe) for name in self.predicates} for recipe in recipes]
        starts = np.zeros(len(recipes), np.int64)
        for place in range(len(recipes[0])):
            skills = [recipe[place] for recipe in recipes]
            attempts = [
                _attempt(each, place, start, self.max_steps)
                for each, start in zip(episodes, starts.tolist(), strict=True)
            ]
            held = {name: self._holds(name, skills, attempts) for name in self.predicates}
            for env, (episode, flags) in enumerate(zip(episodes, held[COMPLETED], strict=True)):
                last = max(0, len(flags) - 1)
                if episode.goal_index is None and flags.any():
                    last = int(np.argmax(flags))
                starts[env] += last
                for name, each in held.items():
                    found[env][name][place] = bool(each[env][last : last + 1].any())
        return found

    def _holds(self, predicate: str, skills: Sequence[str], attempts: Sequence[States]) -> list[Flags]:
        """Returns where the predicate of each attempt's skill holds, bool (T,) each; (0,) for one not begun."""
        found: list[Flags] = [np.zeros(0, bool)] * len(attempts)
        for skill in sorted(set(skills)):
            envs = [env for env, own in enumerate(skills) if own == skill and len(attempts[env]) > 1]
            held = self.truth.holds(f"{predicate}/{skill}", [attempts[env] for env in envs])
            for env, flags in zip(envs, held, strict=True):
                found[env] = flags
        return found


def _attempt(episode: Episode, place: int, start: int, max_steps: int) -> States:
    """Returns the states of an attempt at the skill at a place of the recipe, the first of the next skill included.

    The policy says when it goes on to the next skill. One that does not say goes on once the skill is truly completed,
    or after `max_steps`: its attempt begins at `start`.
    """
    if episode.goal_index is None:
        return episode.states[start : start + max_steps + 1]
    begin, end = attempt_bounds(episode.goal_index, place)
    return episode.states[begin : end + 1] if begin < end else episode.states[:0]


def attempt_bounds(goal_index: npt.NDArray[np.int64], place: int) -> tuple[int, int]:
    """Returns the first timestep of a goal, and of the one after it; `goal_index`, int64 (T,), never falls."""
    begin, end = np.searchsorted(goal_index, [place, place + 1]).tolist()
    return begin, end


FORM = Form(RecipesConfig, RecipesEvaluation, check_policy)
