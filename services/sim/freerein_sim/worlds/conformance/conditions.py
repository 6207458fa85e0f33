"""Checks of the conditions of a task."""

from contextlib import closing
from functools import partial
from itertools import combinations

from freerein_sim.worlds.camera_effects import EFFECTS
from freerein_sim.worlds.conformance.assertions import require, require_refusal
from freerein_sim.worlds.conformance.rollouts import SEED, begin, continued, observed
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import TaskDefinition

_FEW_STEPS = 2


def declares_its_conditions(task: TaskDefinition) -> None:
    """Conditions have names of their own, and every other list of them is refused."""
    names = [condition.name for condition in task.conditions]
    require(len(set(names)) == len(names), "Conditions have names of their own.")
    require(task.describe().conditions == tuple(names), "A task describes its conditions.")
    wrong = [["no-such-condition"], *([name, name] for name in names[:1])]
    wrong += [[one.name, other.name] for one, other in combinations(task.conditions, 2) if one.group == other.group]
    for chosen in wrong:
        require_refusal(partial(build, task, chosen), "An unknown condition, or two of a group, is refused.")


def runs_under_each_condition(task: TaskDefinition) -> None:
    """Under each condition a world is deterministic, and restores its own snapshots bit for bit."""
    with closing(task.make()) as nominal:
        fingerprint = nominal.fingerprint
    for condition in task.conditions:
        with (
            closing(begin(task, conditions=[condition.name])) as world,
            closing(begin(task, conditions=[condition.name], seed=SEED + 1)) as other,
        ):
            require(world.fingerprint == other.fingerprint, "Worlds of one condition have one fingerprint.")
            require(world.fingerprint != fingerprint, "A condition is part of the fingerprint.")
            continued(world, steps=_FEW_STEPS)
            snapshot = world.snapshot()
            other.restore(snapshot)
            require(other.snapshot() == snapshot, "A restored world has the snapshot that it was given.")
            same = continued(world, steps=_FEW_STEPS) == continued(other, steps=_FEW_STEPS)
            require(same, f"A world restored under {condition.name} goes on the same.")


def looks_different_under_conditions_of_the_camera(task: TaskDefinition) -> None:
    """Effects, lights and camera moves change frames, and nothing of the true state."""
    with closing(begin(task)) as nominal:
        truth, *frames = observed(nominal)
        for condition in task.conditions:
            if condition.name in EFFECTS or condition.group in ("light", "camera"):
                with closing(begin(task, conditions=[condition.name])) as world:
                    seen, *views = observed(world)
                    require(seen == truth, f"{condition.name} leaves the true state as it is.")
                    require(views[1:] != frames[1:], f"{condition.name} changes what cameras see.")
                    shapes = [len(view) for view in views] == [len(frame) for frame in frames]
                    require(shapes, f"{condition.name} leaves the frame's size as it is.")
