"""Checks that a world does the same again: under a seed, and from a snapshot."""

from contextlib import closing
from functools import partial

import numpy as np

from freerein_sim.worlds.conformance.assertions import require, require_refusal
from freerein_sim.worlds.conformance.rollouts import SEED, begin, continued, demonstrate, observed
from freerein_sim.worlds.world import TaskDefinition


def repeats_itself_under_a_seed(task: TaskDefinition) -> None:
    """Equal seeds and actions give equal bits; another seed gives another initial state."""
    with (
        closing(begin(task)) as first,
        closing(begin(task)) as second,
        closing(begin(task, seed=SEED + 1)) as other,
    ):
        require(first.fingerprint == second.fingerprint, "Worlds of one task have one fingerprint.")
        require(observed(first) == observed(second), "Worlds of one seed begin alike.")
        require(observed(first) != observed(other), "Worlds of different seeds begin differently.")
        require(continued(first) == continued(second), "Worlds of one seed stay alike.")


def resets_to_the_same_start(task: TaskDefinition) -> None:
    """A reset does not depend on earlier episodes."""
    with closing(begin(task)) as used, closing(begin(task)) as fresh:
        continued(used)
        for world in (used, fresh):
            world.reset(np.random.default_rng(SEED + 2))
        require(observed(used) == observed(fresh), "A used world resets as a fresh one does.")
        require(continued(used) == continued(fresh), "A used world goes on as a fresh one does.")


def restores_bit_for_bit(task: TaskDefinition) -> None:
    """A snapshot continued in another world gives the same states and frames."""
    with closing(begin(task)) as world, closing(begin(task, seed=SEED + 1)) as other:
        continued(world)
        snapshot = world.snapshot()
        other.restore(snapshot)
        require(other.snapshot() == snapshot, "A restored world has the snapshot that it was given.")
        require(other.steps == world.steps, "A restored world has made as many steps.")
        require(observed(world) == observed(other), "A restored world looks the same.")
        require(continued(world) == continued(other), "A restored world goes on the same.")


def refuses_broken_snapshots(task: TaskDefinition) -> None:
    """Invalid snapshots are refused and change nothing."""
    with closing(begin(task)) as world:
        snapshot = world.snapshot()
        for broken in (b"", snapshot[:-1], snapshot + b"\0", bytes(len(snapshot)), b"\xff" * len(snapshot)):
            require_refusal(partial(world.restore, broken), "A broken snapshot is refused.")
        require(world.snapshot() == snapshot, "A refused snapshot changes nothing.")


def demonstrates_the_same_under_a_seed(task: TaskDefinition) -> None:
    """Equal seeds give equal demonstrations: frames, actions, labels and true states, in a used world, too."""
    if not task.spec.has_expert:
        return
    with closing(task.make()) as first, closing(begin(task)) as other:
        made = []
        for world in (first, other):
            rng = np.random.default_rng(SEED)
            fewest, _ = task.recipes.lengths(task.spec.skills)
            recipe = task.recipes.draw(rng, task.spec.skills, fewest=fewest, most=fewest)
            made.append(demonstrate(world, recipe, rng, cameras=task.spec.cameras[:1]))
    one, again = (each.episode for each in made)
    (frames,), (same_frames,) = one.frames.values(), again.frames.values()
    require(frames.tobytes() == same_frames.tobytes(), "Demonstrations of one seed look alike.")
    require(one.actions.tobytes() == again.actions.tobytes(), "Demonstrations of one seed have equal actions.")
    require(one.labels.tolist() == again.labels.tolist(), "Demonstrations of one seed have equal labels.")
    require(made[0].states.tobytes() == made[1].states.tobytes(), "Demonstrations of one seed have equal states.")
