"""Conformance tests for any `World`, including those of other packages.

    @pytest.mark.parametrize("check", conformance.CHECKS, ids=lambda check: check.__name__)
    def test_my_world_conforms(check):
        check(my_task)

A check raises `AssertionError` with a sentence; it makes and closes its own worlds.
"""

from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.errors import InvalidInput
from freerein_sim.worlds.camera_effects import EFFECTS
from freerein_sim.worlds.conditions import Condition
from freerein_sim.worlds.episodes import record_episode
from freerein_sim.worlds.random_policy import SmoothRandomPolicy
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import Action, Frame, TaskDefinition, World, expert_of

_SEED = 7
_STEPS = 12
_FEW_STEPS = 2


def describes_itself(task: TaskDefinition) -> None:
    """The spec is consistent, and the world has the task's spec."""
    spec = task.spec
    action = spec.action
    _require(len(spec.cameras) > 0, "A world has at least one camera.")
    _require(len({each.name for each in spec.cameras}) == len(spec.cameras), "Cameras have names of their own.")
    _require(len(set(spec.skills)) == len(spec.skills), "Skills have names of their own.")
    _require(spec.control_dt_s > 0 and spec.max_episode_steps > 0, "Time goes forward.")
    _require(len(action.names) == (action.choices or action.size), "Every number, or every choice, has a name.")
    _require(action.size == 1 or not action.choices, "A discrete action is one number.")
    _require(bool(action.choices) or len(action.scale) == action.size, "A continuous action has a scale.")
    with closing(task.make()) as world:
        _require(world.spec == spec, "The world's spec is the task's.")
    _require(task.describe().name == task.name, "A task describes itself.")


def tells_the_truth_in_shape(task: TaskDefinition) -> None:
    """True state is finite float64, one number per name, in every step."""
    with closing(_begin(task)) as world:
        for _ in _act_randomly(world):
            truth = world.truth()
            _require(truth.state.dtype == np.float64, "True state is float64.")
            _require(truth.state.shape == (len(task.spec.state_names),), "Each number of the true state has a name.")
            _require(bool(np.isfinite(truth.state).all()) and bool(np.isfinite(truth.reward)), "GroundTruth is finite.")


def starts_unsolved(task: TaskDefinition) -> None:
    """No episode begins with its goal reached."""
    with closing(task.make()) as world:
        for child in np.random.SeedSequence(_SEED).spawn(50):
            world.reset(np.random.default_rng(child))
            _require(not world.truth().success, "An episode begins with its goal not reached.")


def repeats_itself_under_a_seed(task: TaskDefinition) -> None:
    """Equal seeds and actions give equal bits; another seed gives another initial state."""
    with (
        closing(_begin(task)) as first,
        closing(_begin(task)) as second,
        closing(_begin(task, seed=_SEED + 1)) as other,
    ):
        _require(first.fingerprint == second.fingerprint, "Worlds of one task have one fingerprint.")
        _require(_observed(first) == _observed(second), "Worlds of one seed begin alike.")
        _require(_observed(first) != _observed(other), "Worlds of different seeds begin differently.")
        _require(_continued(first) == _continued(second), "Worlds of one seed stay alike.")


def resets_to_the_same_start(task: TaskDefinition) -> None:
    """A reset does not depend on earlier episodes."""
    with closing(_begin(task)) as used, closing(_begin(task)) as fresh:
        _continued(used)
        for world in (used, fresh):
            world.reset(np.random.default_rng(_SEED + 2))
        _require(_observed(used) == _observed(fresh), "A used world resets as a fresh one does.")
        _require(_continued(used) == _continued(fresh), "A used world goes on as a fresh one does.")


def restores_bit_for_bit(task: TaskDefinition) -> None:
    """A snapshot continued in another world gives the same states and frames."""
    with closing(_begin(task)) as world, closing(_begin(task, seed=_SEED + 1)) as other:
        _continued(world)
        snapshot = world.snapshot()
        other.restore(snapshot)
        _require(other.snapshot() == snapshot, "A restored world has the snapshot that it was given.")
        _require(other.steps == world.steps, "A restored world has made as many steps.")
        _require(_observed(world) == _observed(other), "A restored world looks the same.")
        _require(_continued(world) == _continued(other), "A restored world goes on the same.")


def refuses_broken_snapshots(task: TaskDefinition) -> None:
    """Invalid snapshots are refused and change nothing."""
    with closing(_begin(task)) as world:
        snapshot = world.snapshot()
        for broken in (b"", snapshot[:-1], snapshot + b"\0", bytes(len(snapshot)), b"\xff" * len(snapshot)):
            _refuses(partial(world.restore, broken), "A broken snapshot is refused.")
        _require(world.snapshot() == snapshot, "A refused snapshot changes nothing.")


def renders_what_was_asked(task: TaskDefinition) -> None:
    """Frames have the requested size and channels, are not uniform, and share no memory."""
    with closing(_begin(task)) as world:
        for camera in task.spec.cameras:
            frame = world.render(camera.name, height=camera.height, width=camera.width)
            again = world.render(camera.name, height=camera.height, width=camera.width)
            _require(frame.dtype == np.uint8, "Frames are uint8.")
            _require(frame.shape == (camera.height, camera.width, camera.channels), "Frames have the size asked for.")
            _require(int(frame.min()) < int(frame.max()), "Frames show something.")
            _require(not np.shares_memory(frame, again), "Every frame is an array of its own.")
            _require(np.array_equal(frame, again), "Looking changes nothing.")


def refuses_bad_views(task: TaskDefinition) -> None:
    """Unknown cameras and sizes out of bounds are refused."""
    camera, too_big = task.spec.cameras[0].name, task.spec.max_size + 1
    with closing(_begin(task)) as world:
        _refuses(partial(world.render, "no-such-camera", height=8, width=8), "An unknown camera is refused.")
        for height, width in ((0, 8), (8, -1), (too_big, 8), (8, too_big)):
            _refuses(partial(world.render, camera, height=height, width=width), "A size out of bounds is refused.")


def refuses_bad_actions(task: TaskDefinition) -> None:
    """Actions of the wrong dtype, shape or range are refused, and change nothing."""
    spec = task.spec.action
    dtype = spec.dtype
    bad: list[npt.NDArray[Any]] = [
        np.zeros(spec.size + 1, dtype),
        np.zeros((1, spec.size), dtype),
        np.zeros(spec.size, np.float64),
        np.full(spec.size, spec.choices or 1.5, dtype),
        np.full(spec.size, -1 if spec.choices else -1.5, dtype),
    ]
    if not spec.choices:
        bad += [np.full(spec.size, value, dtype) for value in (np.nan, np.inf)]
    with closing(_begin(task)) as world:
        before = _observed(world)
        for action in bad:
            _refuses(partial(world.step, action), "A bad action is refused.")
        _require(_observed(world) == before, "A refused action changes nothing.")


def refuses_unknown_skills(task: TaskDefinition) -> None:
    """Skills that the world does not have are refused."""
    with closing(_begin(task)) as world:
        rng = np.random.default_rng(_SEED)
        if task.spec.has_expert:
            _refuses(partial(expert_of(world), ("no-such-skill",), rng), "An unknown skill has no expert.")
        _refuses(partial(world.reset, rng, recipe=("no-such-skill",)), "An unknown skill is in no recipe.")


def has_an_expert_that_succeeds(task: TaskDefinition) -> None:
    """The expert executes every skill in order and in time, and the oracle agrees that the goal, if any, holds."""
    spec = task.spec
    if not spec.has_expert:
        return
    with closing(task.make()) as world:
        rng = np.random.default_rng(_SEED)
        world.reset(rng, recipe=spec.skills)
        expert = expert_of(world)(spec.skills, rng)
        shown = record_episode(world, expert, cameras=(), max_steps=spec.max_episode_steps)
        _require(shown.success, "The expert succeeds.")
        order = shown.labels[np.flatnonzero(np.diff(shown.labels, prepend=-2))]
        _require(order.tolist() == list(range(len(spec.skills))), "Labels follow the recipe.")
        _require(not task.goal_text or world.truth().success, "The oracle sees the goal that the expert reached.")


def has_an_expert_that_survives_any_state(task: TaskDefinition) -> None:
    """The expert acts within the spec from a random state, too."""
    if not task.spec.has_expert:
        return
    with closing(_begin(task)) as world:
        for _ in _act_randomly(world):
            pass
        expert = expert_of(world)(task.spec.skills, np.random.default_rng(_SEED))
        record_episode(world, expert, cameras=(), max_steps=5 * _STEPS)


def has_an_expert_of_its_own_recipe(task: TaskDefinition) -> None:
    """An expert without skills executes what the episode requires."""
    if not task.spec.has_expert:
        return
    with closing(task.make()) as world:
        rng = np.random.default_rng(_SEED)
        world.reset(rng)
        shown = record_episode(world, expert_of(world)((), rng), cameras=(), max_steps=task.spec.max_episode_steps)
        _require(shown.success, "The expert succeeds at the recipe of the episode.")


def judges_its_states(task: TaskDefinition) -> None:
    """Every predicate has a name of its own, and judges each state given those before it."""
    names = [predicate.name for predicate in task.predicates]
    _require(len(set(names)) == len(names), "Predicates have names of their own.")
    with closing(_begin(task)) as world:
        states = np.stack([world.truth().state for _ in _act_randomly(world)])[None]
    for predicate in task.predicates:
        references = (states[:, ::-1],) if predicate.needs_reference else ()
        holds = predicate.holds(states, *references)
        _require(holds.dtype == np.bool_ and holds.shape == states.shape[:2], "A predicate judges each timestep.")
        shorter = predicate.holds(states[:, :-1], *(each[:, :-1] for each in references))
        _require(np.array_equal(shorter, holds[:, :-1]), "A predicate does not look ahead.")


def declares_its_conditions(task: TaskDefinition) -> None:
    """Conditions have names of their own, and every other list of them is refused."""
    names = [condition.name for condition in task.conditions]
    _require(len(set(names)) == len(names), "Conditions have names of their own.")
    _require(task.describe().conditions == tuple(names), "A task describes its conditions.")
    wrong = [["no-such-condition"], *([name, name] for name in names[:1])]
    wrong += [[one.name, other.name] for one, other in combinations(task.conditions, 2) if one.group == other.group]
    for chosen in wrong:
        _refuses(partial(build, task, chosen), "An unknown condition, or two of a group, is refused.")


def runs_under_each_condition(task: TaskDefinition) -> None:
    """Under each condition a world is deterministic, and restores its own snapshots bit for bit."""
    with closing(task.make()) as nominal:
        fingerprint = nominal.fingerprint
    for condition in task.conditions:
        with closing(_vary(task, condition)) as world, closing(_vary(task, condition, seed=_SEED + 1)) as other:
            _require(world.fingerprint == other.fingerprint, "Worlds of one condition have one fingerprint.")
            _require(world.fingerprint != fingerprint, "A condition is part of the fingerprint.")
            _continued(world, steps=_FEW_STEPS)
            snapshot = world.snapshot()
            other.restore(snapshot)
            _require(other.snapshot() == snapshot, "A restored world has the snapshot that it was given.")
            same = _continued(world, steps=_FEW_STEPS) == _continued(other, steps=_FEW_STEPS)
            _require(same, f"A world restored under {condition.name} goes on the same.")


def looks_different_under_conditions_of_the_camera(task: TaskDefinition) -> None:
    """Effects, lights and camera moves change frames, and nothing of the true state."""
    with closing(_begin(task)) as nominal:
        truth, *frames = _observed(nominal)
        for condition in task.conditions:
            if condition.name in EFFECTS or condition.group in ("light", "camera"):
                with closing(_vary(task, condition)) as world:
                    seen, *views = _observed(world)
                    _require(seen == truth, f"{condition.name} leaves the true state as it is.")
                    _require(views[1:] != frames[1:], f"{condition.name} changes what cameras see.")
                    shapes = [len(view) for view in views] == [len(frame) for frame in frames]
                    _require(shapes, f"{condition.name} leaves the frame's size as it is.")


CHECKS: tuple[Callable[[TaskDefinition], None], ...] = (
    describes_itself,
    tells_the_truth_in_shape,
    starts_unsolved,
    repeats_itself_under_a_seed,
    resets_to_the_same_start,
    restores_bit_for_bit,
    refuses_broken_snapshots,
    renders_what_was_asked,
    refuses_bad_views,
    refuses_bad_actions,
    refuses_unknown_skills,
    has_an_expert_that_succeeds,
    has_an_expert_that_survives_any_state,
    has_an_expert_of_its_own_recipe,
    judges_its_states,
    declares_its_conditions,
    runs_under_each_condition,
    looks_different_under_conditions_of_the_camera,
)
"""All checks, simplest first."""


def _require(holds: bool, sentence: str) -> None:
    if not holds:
        raise AssertionError(f"Expected: {sentence}")


def _refuses(call: Callable[[], object], sentence: str) -> None:
    try:
        call()
    except InvalidInput:
        return
    raise AssertionError(f"Expected: {sentence}")


def _begin(task: TaskDefinition, *, seed: int = _SEED) -> World:
    world = task.make()
    world.reset(np.random.default_rng(seed))
    return world


def _vary(task: TaskDefinition, condition: Condition, *, seed: int = _SEED) -> World:
    world = build(task, [condition.name])
    world.reset(np.random.default_rng(seed))
    return world


def _act_randomly(world: World, *, steps: int = _STEPS) -> Iterator[Action]:
    """Steps the world with a fixed random policy; yields after each step until the episode ends."""
    policy = SmoothRandomPolicy(world.spec.action, np.random.default_rng(_SEED))
    for _ in range(steps):
        action = policy.act().action
        result = world.step(action)
        yield action
        if result.terminated:
            return


def _observed(world: World) -> tuple[bytes, ...]:
    """Returns true state, oracle reward and all cameras' frames as bytes."""
    views: list[Frame] = [world.render(each.name, height=each.height, width=each.width) for each in world.spec.cameras]
    truth = world.truth()
    return truth.state.tobytes(), np.float64(truth.reward).tobytes(), *(view.tobytes() for view in views)


def _continued(world: World, *, steps: int = _STEPS) -> list[tuple[bytes, ...]]:
    return [_observed(world) for _ in _act_randomly(world, steps=steps)]
