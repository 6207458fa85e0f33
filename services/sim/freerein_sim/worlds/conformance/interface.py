"""Checks of a world's inputs and outputs."""

from contextlib import closing
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein_sim.worlds.conformance.assertions import require, require_refusal
from freerein_sim.worlds.conformance.rollouts import SEED, act_randomly, begin, observed
from freerein_sim.worlds.world import TaskDefinition, expert_of


def describes_itself(task: TaskDefinition) -> None:
    """The spec is consistent, and the world has the task's spec."""
    spec = task.spec
    action = spec.action
    require(len(spec.cameras) > 0, "A world has at least one camera.")
    require(len({each.name for each in spec.cameras}) == len(spec.cameras), "Cameras have names of their own.")
    require(len(set(spec.skills)) == len(spec.skills), "Skills have names of their own.")
    require(spec.control_dt_s > 0 and spec.max_episode_steps > 0, "Time goes forward.")
    require(len(action.names) == (action.choices or action.size), "Every number, or every choice, has a name.")
    require(action.size == 1 or not action.choices, "A discrete action is one number.")
    require(action.hold in range(-1, action.choices), "What holds is one of the choices, or -1.")
    require(bool(action.choices) or len(action.scale) == action.size, "A continuous action has a scale.")
    with closing(task.make()) as world:
        require(world.spec == spec, "The world's spec is the task's.")
        require(
            (world.expert is not None) == spec.has_expert,
            "A spec with skills, or with `has_expert`, is of a world with an expert, and one without is not.",
        )
    require(task.describe().name == task.name, "A task describes itself.")


def tells_the_truth_in_shape(task: TaskDefinition) -> None:
    """True state is finite float64, one number per name, in every step."""
    with closing(begin(task)) as world:
        for _ in act_randomly(world):
            truth = world.truth()
            require(truth.state.dtype == np.float64, "True state is float64.")
            require(truth.state.shape == (len(task.spec.state_names),), "Each number of the true state has a name.")
            require(bool(np.isfinite(truth.state).all()) and bool(np.isfinite(truth.reward)), "GroundTruth is finite.")
            require(not (task.reward_free and truth.reward), "A reward-free task rewards nothing.")


def starts_unsolved(task: TaskDefinition) -> None:
    """No episode begins with its goal reached."""
    with closing(task.make()) as world:
        for child in np.random.SeedSequence(SEED).spawn(50):
            world.reset(np.random.default_rng(child))
            require(not world.truth().success, "An episode begins with its goal not reached.")


def renders_what_was_asked(task: TaskDefinition) -> None:
    """Frames have the requested size and channels, are not uniform, and share no memory."""
    with closing(begin(task)) as world:
        for camera in task.spec.cameras:
            frame = world.render(camera.name, height=camera.height, width=camera.width)
            again = world.render(camera.name, height=camera.height, width=camera.width)
            require(frame.dtype == np.uint8, "Frames are uint8.")
            require(frame.shape == (camera.height, camera.width, camera.channels), "Frames have the size asked for.")
            require(int(frame.min()) < int(frame.max()), "Frames show something.")
            require(not np.shares_memory(frame, again), "Every frame is an array of its own.")
            require(np.array_equal(frame, again), "Looking changes nothing.")


def refuses_bad_views(task: TaskDefinition) -> None:
    """Unknown cameras and sizes out of bounds are refused."""
    camera, too_big = task.spec.cameras[0].name, task.spec.max_size + 1
    with closing(begin(task)) as world:
        require_refusal(partial(world.render, "no-such-camera", height=8, width=8), "An unknown camera is refused.")
        for height, width in ((0, 8), (8, -1), (too_big, 8), (8, too_big)):
            require_refusal(
                partial(world.render, camera, height=height, width=width), "A size out of bounds is refused."
            )


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
    with closing(begin(task)) as world:
        before = observed(world)
        for action in bad:
            require_refusal(partial(world.step, action), "A bad action is refused.")
        require(observed(world) == before, "A refused action changes nothing.")


def refuses_unknown_skills(task: TaskDefinition) -> None:
    """Skills that the world does not have are refused."""
    with closing(begin(task)) as world:
        rng = np.random.default_rng(SEED)
        if task.spec.has_expert:
            require_refusal(partial(expert_of(world), ("no-such-skill",), rng), "An unknown skill has no expert.")
        require_refusal(partial(world.reset, rng, recipe=("no-such-skill",)), "An unknown skill is in no recipe.")


def judges_its_states(task: TaskDefinition) -> None:
    """Every predicate has a name of its own, and judges each state given those before it."""
    names = [predicate.name for predicate in task.predicates]
    require(len(set(names)) == len(names), "Predicates have names of their own.")
    with closing(begin(task)) as world:
        states = np.stack([world.truth().state for _ in act_randomly(world)])[None]
    for predicate in task.predicates:
        references = (states[:, ::-1],) if predicate.needs_reference else ()
        holds = predicate.holds(states, *references)
        require(holds.dtype == np.bool_ and holds.shape == states.shape[:2], "A predicate judges each timestep.")
        shorter = predicate.holds(states[:, :-1], *(each[:, :-1] for each in references))
        require(np.array_equal(shorter, holds[:, :-1]), "A predicate does not look ahead.")
