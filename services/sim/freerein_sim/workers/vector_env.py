"""A vector of environments of one task, stepped together: a session without a service. Synchronous, single-threaded."""

from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.errors import FailedPrecondition, InvalidInput, must_be
from freerein.types.common import Camera
from freerein.types.sim import (
    Behaviour,
    CameraFrames,
    ExpertActionsResponse,
    Recipe,
    RenderResponse,
    ResetResponse,
    StepResponse,
    Truth,
)
from freerein_sim.workers import snapshots
from freerein_sim.worlds import generators
from freerein_sim.worlds.random_policy import explorer_of
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import (
    NO_SKILL,
    ScriptedPolicy,
    StepResult,
    TaskDefinition,
    check_actions,
    check_saves,
    expert_of,
    sized_cameras,
    skill_indices,
)

MAX_RECIPE = 256
"""Most skills of a recipe."""
MAX_ACTION_REPEAT = 64


class VectorEnv:
    """N environments of one task. Environment i draws from `SeedSequence(seed).spawn(N)[i]`.

    A refused call changes nothing.

    Args:
        task: The task.
        num_envs: N.
        seed: Seeds the generators.
        height: Frame height in pixels; 0 means the cameras' own.
        width: Frame width in pixels; 0 means the cameras' own.
        privileged: Whether replies hold `Truth`.
        conditions: Conditions of the task.
        max_episode_steps: Steps after which an episode is truncated; 0 means the task's own.

    Attributes:
        step_id: Steps made in total; not changed by `reset`, set by `restore` of all environments.
    """

    def __init__(
        self,
        task: TaskDefinition,
        *,
        num_envs: int,
        seed: int,
        height: int = 0,
        width: int = 0,
        privileged: bool = False,
        conditions: Sequence[str] = (),
        max_episode_steps: int = 0,
    ) -> None:
        self.task = task
        self.num_envs = num_envs
        self.step_id = 0
        self._height, self._width = height, width
        self._conditions = conditions
        self._max_steps = max_episode_steps or task.spec.max_episode_steps
        self._privileged = privileged
        self._cameras(camera.name for camera in task.spec.cameras)
        self._worlds = [build(task, conditions) for _ in range(num_envs)]
        self._rngs = _generators(seed, num_envs)
        self._steps = np.zeros(num_envs, np.int64)
        self._scripted: dict[tuple[int, Behaviour], ScriptedPolicy] = {}  # by environment, of the current episode
        self._is_reset = False
        self._tried_views: set[Camera] = set()

    def reset(
        self,
        envs: Sequence[int] = (),
        seed: int | None = None,
        *,
        cameras: Sequence[str] = (),
        recipes: Sequence[Recipe] = (),
    ) -> ResetResponse:
        """Begins new episodes; the first reset must be of all environments.

        Args:
            envs: Indices of environments; empty for all.
            seed: Re-seeds all generators first; None keeps them.
            cameras: Cameras to render.
            recipes: Recipe of each environment, what its new episode requires; empty for the worlds' own.
        """
        chosen, recipes = self._chosen(envs), self._recipes(recipes)
        self._try_recipes([recipes[i] for i in chosen])
        views = self._cameras(cameras)
        self._try_views(views)
        if seed is not None:
            self._rngs = _generators(seed, self.num_envs)
        for i in chosen:
            self._begin(i, recipes[i].skills)
        self._is_reset = True
        return ResetResponse(self._frames(views, range(self.num_envs)), self._truth() if self._privileged else None)

    def step(self, actions: npt.NDArray[Any], cameras: Sequence[str] = (), *, action_repeat: int = 1) -> StepResponse:
        """Steps every environment once; one whose episode ends is reset in the same call.

        Args:
            actions: float32 or int64 (N, size), matching the task's action spec once they are `normalised`.
            cameras: Cameras to render.
            action_repeat: Timesteps that each action is held for, or until the episode ends.
        """
        self._check_reset("Step")
        _check_action_repeat(action_repeat)
        actions = self.task.spec.action.normalised(actions)
        check_actions(self.task.spec.action, actions, batch=(self.num_envs,))
        views = self._cameras(cameras)
        self._try_views(views)
        results = [self._hold(env, action, action_repeat) for env, action in enumerate(actions)]
        self.step_id += 1
        terminated = np.array([result.terminated for result in results])
        truncated = ~terminated & (self._steps >= self._max_steps)
        truth = self._truth() if self._privileged else None
        ended = np.flatnonzero(terminated | truncated).tolist()
        final_frames = self._frames(views, ended)
        for i in ended:
            self._begin(i)
        return StepResponse(
            step_id=self.step_id,
            frames=self._frames(views, range(self.num_envs)),
            reward=np.zeros(self.num_envs, np.float32),
            terminated=terminated,
            truncated=truncated,
            diverged=np.array([result.diverged for result in results]),
            final_frames=final_frames,
            truth=truth,
        )

    def render(self, cameras: Sequence[str] = (), *, height: int = 0, width: int = 0) -> RenderResponse:
        """Returns the current frames; no cameras means all, a size of 0 the session's."""
        self._check_reset("Render")
        names = cameras or [camera.name for camera in self.task.spec.cameras]
        return RenderResponse(self._frames(self._cameras(names, height, width), range(self.num_envs)))

    def expert_actions(
        self, recipes: Sequence[Recipe] = (), *, behaviour: Behaviour = "expert"
    ) -> ExpertActionsResponse:
        """Returns a scripted policy's next actions; to be called once before each step.

        The first call after an environment's reset or restore makes its policy, which draws from a jump of the
        environment's generator: later episodes do not depend on it.

        Args:
            recipes: Recipe of each environment, read when its expert is made. None, or an empty one, means the recipe
                of the episode, or all of the task's skills in order where episodes have none.
            behaviour: The expert, or random exploration.
        """
        self._check_reset("ExpertActions")
        self._scripted |= {
            (i, behaviour): self._make_scripted(i, recipe.skills, behaviour)
            for i, recipe in enumerate(self._recipes(recipes))
            if (i, behaviour) not in self._scripted
        }
        chosen = [self._scripted[i, behaviour].act() for i in range(self.num_envs)]
        hold = self.task.spec.action.nearest_to_hold()
        return ExpertActionsResponse(
            actions=np.stack([hold if each is None else each.action for each in chosen]),
            finished=np.array([each is None for each in chosen]),
            skills=np.array([NO_SKILL if each is None else each.skill for each in chosen], np.int64),
        )

    def snapshot(self) -> bytes:
        """Returns the complete state; after `restore` the same actions give the same bits."""
        check_saves(self._worlds[0])
        self._check_reset("Snapshot")
        states = zip(self._steps.tolist(), self._rngs, self._worlds, strict=True)
        envs = tuple(snapshots.EnvState(steps, rng, world.snapshot()) for steps, rng, world in states)
        return snapshots.encode(snapshots.Snapshot(self.task.name, self._worlds[0].fingerprint, self.step_id, envs))

    def restore(self, snapshot: bytes, envs: Sequence[int] = (), sources: Sequence[int] = ()) -> None:
        """Restores a snapshot of the same task, build and conditions.

        Args:
            snapshot: What `snapshot` returned; of N environments, where `envs` is empty.
            envs: Indices of M environments, each once, whose worlds are restored; they keep their generators, and
                `step_id` and the other environments stay as they are. Empty for all, with generators and `step_id`.
            sources: M indices: the environment of the snapshot whose state each of `envs` takes; may be repeated.

        Raises:
            InvalidInput: The snapshot is damaged or has an episode that is over, or an index is out of range.
            FailedPrecondition: The snapshot is of another task, build, condition or number of environments, or there
                was no reset before a restore of `envs`.
        """
        check_saves(self._worlds[0])
        state = snapshots.decode(snapshot)
        _check_sources(sources, num_envs=len(envs), num_saved=len(state.envs))
        self._check_compatible(state, num_envs=0 if envs else self.num_envs)
        if envs:
            self._check_reset("Restore of single environments")
        saved = [state.envs[source] for source in sources] or state.envs
        states = dict(zip(self._chosen(envs), saved, strict=True))
        if any(env.steps >= self._max_steps for env in states.values()):
            raise must_be("snapshot", "of episodes that go on", "one that is over")
        self._restore_worlds(states)
        for i, env in states.items():
            self._steps[i] = env.steps
            self._forget_scripted(i)
        if not envs:
            self._rngs = [env.rng for env in state.envs]
            self.step_id = state.step_id
        self._is_reset = True

    def close(self) -> None:
        """Closes the worlds, on the thread that rendered; may be called twice."""
        for world in self._worlds:
            world.close()

    def _hold(self, env: int, action: npt.NDArray[Any], timesteps: int) -> StepResult:
        """Takes an action for some timesteps, or until the episode ends; returns the result of the last."""
        for _ in range(timesteps):
            result = self._worlds[env].step(action)
            self._steps[env] += 1
            if result.terminated or self._steps[env] >= self._max_steps:
                break
        return result

    def _begin(self, env: int, recipe: Sequence[str] = ()) -> None:
        self._worlds[env].reset(self._rngs[env], recipe=recipe)
        self._steps[env] = 0
        self._forget_scripted(env)

    def _make_scripted(self, env: int, recipe: Sequence[str], behaviour: Behaviour) -> ScriptedPolicy:
        world, rng = self._worlds[env], generators.jumped(self._rngs[env])
        return expert_of(world)(recipe, rng) if behaviour == "expert" else explorer_of(self.task, world, rng)

    def _forget_scripted(self, env: int) -> None:
        self._scripted = {key: policy for key, policy in self._scripted.items() if key[0] != env}

    def _frames(self, views: Sequence[Camera], envs: Sequence[int]) -> CameraFrames:
        frames = {view.name: np.empty((len(envs), view.height, view.width, view.channels), np.uint8) for view in views}
        for row, env in enumerate(envs):
            for view in views:
                frames[view.name][row] = self._worlds[env].render(view.name, height=view.height, width=view.width)
        return frames

    def _truth(self) -> Truth:
        truths = [world.truth() for world in self._worlds]
        return Truth(
            state=np.stack([truth.state for truth in truths]),
            reward=np.array([truth.reward for truth in truths], np.float32),
            success=np.array([truth.success for truth in truths], np.bool_),
        )

    def _cameras(self, names: Iterable[str], height: int = 0, width: int = 0) -> tuple[Camera, ...]:
        """Returns the named cameras with the size at which to render them."""
        height, width = height or self._height, width or self._width
        return sized_cameras(self.task.spec, names, height=height, width=width)

    def _try_views(self, views: Sequence[Camera]) -> None:
        """Renders each new view once, so that one that cannot be rendered is refused before a step."""
        untried = set(views) - self._tried_views
        if untried and not self._is_reset:
            self._worlds[0].reset(np.random.default_rng(0))
        for view in untried:
            self._worlds[0].render(view.name, height=view.height, width=view.width)
        self._tried_views |= untried

    def _try_recipes(self, recipes: Sequence[Recipe]) -> None:
        """Resets another world with each recipe, so that one that is none of the task's is refused before a reset."""
        if any(recipe.skills for recipe in recipes):
            with closing(build(self.task, self._conditions)) as world:
                for recipe in recipes:
                    world.reset(np.random.default_rng(0), recipe=recipe.skills)

    def _restore_worlds(self, states: Mapping[int, snapshots.EnvState]) -> None:
        """Restores the worlds of some environments, or none."""
        before = {i: self._worlds[i].snapshot() for i in states} if self._is_reset else {}
        try:
            for i, state in states.items():
                world = self._worlds[i]
                world.restore(state.world)
                steps = getattr(world, "steps", None)  # worlds of other packages may lack it
                if steps not in (None, state.steps):
                    raise InvalidInput(
                        f"`snapshot` must count the actions that it records; got {state.steps} for {steps}.",
                        field="snapshot",
                        hint="Send it back unchanged.",
                    )
        except InvalidInput:
            for i, earlier in before.items():
                self._worlds[i].restore(earlier)
            raise

    def _chosen(self, envs: Sequence[int]) -> Sequence[int]:
        if len(set(envs)) != len(envs) or not all(0 <= i < self.num_envs for i in envs):
            raise InvalidInput(
                f"`envs` must name environments 0 to {self.num_envs - 1}, each once; got others, or one twice.",
                field="envs",
                hint="Leave it empty for all.",
            )
        if not self._is_reset and 0 < len(envs) < self.num_envs:
            raise FailedPrecondition(
                f"The first reset must be of all {self.num_envs} environments; got {len(envs)}.",
                field="envs",
                hint="Leave `envs` empty.",
            )
        return envs or range(self.num_envs)

    def _recipes(self, recipes: Sequence[Recipe]) -> Sequence[Recipe]:
        """Returns a recipe for each environment."""
        if recipes and len(recipes) != self.num_envs:
            rule = f"one for each of the {self.num_envs} environments, or none"
            raise must_be("recipes", rule, len(recipes), hint="Leave it empty for the task's own.")
        if any(len(recipe.skills) > MAX_RECIPE for recipe in recipes):
            raise InvalidInput(
                f"A recipe must have at most {MAX_RECIPE} skills; got a longer one.",
                field="recipes",
                hint="Ask for the rest after the next reset.",
            )
        for recipe in recipes:
            skill_indices(self.task.spec, recipe.skills, field="recipes")
        return recipes or (Recipe(),) * self.num_envs

    def _check_reset(self, call: str) -> None:
        if not self._is_reset:
            raise FailedPrecondition(f"{call} needs episodes; there was no reset yet.", hint="Call `Reset` first.")

    def _check_compatible(self, snapshot: snapshots.Snapshot, *, num_envs: int) -> None:
        """Checks that a snapshot can be restored, and has `num_envs` environments; 0 for any number."""
        if snapshot.task != self.task.name:
            got = f"of the task {snapshot.task}"
        elif snapshot.fingerprint != self._worlds[0].fingerprint:
            got = "of another build or other conditions"
        elif num_envs and len(snapshot.envs) != num_envs:
            got = f"of {len(snapshot.envs)} environments"
        else:
            return
        number = f", and of {num_envs} environments" if num_envs else ""
        raise FailedPrecondition(
            f"`snapshot` must be of this session's task, build and conditions{number}; got one {got}.",
            field="snapshot",
            hint="Create a session like the one that the snapshot was taken from.",
        )


def _check_sources(sources: Sequence[int], *, num_envs: int, num_saved: int) -> None:
    """Checks that there is one of `num_saved` saved environments for each of those to restore."""
    if len(sources) != num_envs:
        rule = f"{num_envs} indices, one for each of `envs`"
        raise must_be("sources", rule, len(sources), hint="Leave both empty for the whole session.")
    for source in sources:
        if not 0 <= source < num_saved:
            rule = f"indices of the snapshot's environments, 0 to {num_saved - 1}"
            raise must_be("sources", rule, source, hint="Count the environments of the session that was saved.")


def _check_action_repeat(action_repeat: int) -> None:
    if not 1 <= action_repeat <= MAX_ACTION_REPEAT:
        raise must_be("action_repeat", f"1 to {MAX_ACTION_REPEAT} timesteps", action_repeat, hint="Repeat the step.")


def _generators(seed: int, num_envs: int) -> list[np.random.Generator]:
    return [generators.generator(child) for child in np.random.SeedSequence(seed).spawn(num_envs)]
