"""A grid world whose snapshots are replays."""

import struct
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from freerein.errors import InvalidInput
from freerein_sim.workers import snapshots
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import grid
from freerein_sim.worlds.grid import PICK_UP, GridWorld
from freerein_sim.worlds.replay import ReplayedWorld

TASK = replace(grid.TASKS[0], make=lambda: ReplayedWorld(GridWorld(indicator=True)))
DOWN = np.array([1])
HEADER = struct.Struct("<BHI37s")


def begin(seed: int, *recipe: str) -> ReplayedWorld:
    world = ReplayedWorld(GridWorld(indicator=True))
    world.reset(np.random.default_rng(seed), recipe=recipe)
    return world


def observe(world: ReplayedWorld) -> tuple[bytes, bytes]:
    return world.truth().state.tobytes(), world.render("top", height=33, width=30).tobytes()


def change(snapshot: bytes, place: int, value: object) -> bytes:
    """Returns a snapshot with another field of the header."""
    fields = list(HEADER.unpack_from(snapshot))
    fields[place] = value
    return HEADER.pack(*fields) + snapshot[HEADER.size :]


def walk_to_the_end(world: ReplayedWorld) -> bytes:
    """Returns a snapshot of an episode that is over, which no session makes."""
    expert = world.expert((), np.random.default_rng(0))
    while (chosen := expert.act()) is not None:
        world.step(chosen.action)
    return world.snapshot()


def test_a_snapshot_holds_the_recipe_and_the_actions_since_the_reset() -> None:
    world = begin(0, "pick-blue")
    for _ in range(3):
        world.step(DOWN)
    other = begin(1)

    other.restore(world.snapshot())

    assert observe(other) == observe(world)
    assert other.snapshot() == world.snapshot()
    world.reset(np.random.default_rng(2))
    assert len(world.snapshot()) == HEADER.size


@pytest.mark.fault("M10")
@pytest.mark.parametrize(
    "forge",
    [
        lambda snapshot: change(snapshot, 0, 2),
        lambda snapshot: change(snapshot, 1, 2),
        lambda snapshot: change(snapshot, 2, 2),
        lambda snapshot: change(snapshot, 3, bytes(37)),
        lambda snapshot: snapshot[: HEADER.size] + b"\xff\0" + snapshot[HEADER.size + 2 :],
        lambda snapshot: snapshot[:-8] + np.array([PICK_UP + 1], "<i8").tobytes(),
        lambda snapshot: change(snapshot, 2, 10_001) + np.ones(10_001 - 3, "<i8").tobytes(),
        lambda _: walk_to_the_end(begin(5)),
    ],
    ids=["version", "recipe", "length", "generator", "skill", "action", "too long", "over"],
)
def test_a_forged_snapshot_is_refused_and_changes_nothing(forge: Callable[[bytes], bytes]) -> None:
    world = begin(0, "pick-red")
    for _ in range(3):
        world.step(DOWN)
    before = observe(world), world.snapshot()

    with pytest.raises(InvalidInput) as caught:
        world.restore(forge(world.snapshot()))

    assert caught.value.field == "snapshot"
    assert (observe(world), world.snapshot()) == before


@pytest.mark.fault("F1")
@pytest.mark.parametrize("steps", [0, 2, 4])
def test_a_snapshot_that_miscounts_its_actions_is_refused_and_changes_nothing(steps: int) -> None:
    with closing(VectorEnv(TASK, num_envs=2, seed=1, conditions=("blur",))) as envs:
        envs.reset()
        for _ in range(3):
            envs.step(np.array([[1], [0]]))
        before = envs.snapshot()
        kept = snapshots.decode(before)
        forged = replace(kept, envs=(kept.envs[0], replace(kept.envs[1], steps=steps)))

        with pytest.raises(InvalidInput, match=f"got {steps} for 3"):
            envs.restore(snapshots.encode(forged))

        assert envs.snapshot() == before


@pytest.mark.fault("M10")
def test_a_session_of_longer_episodes_takes_its_own_snapshots_and_keeps_its_state_when_it_refuses_one() -> None:
    steps = TASK.spec.max_episode_steps + 5
    with closing(VectorEnv(TASK, num_envs=2, seed=1, max_episode_steps=steps + 1)) as envs:
        envs.reset()
        early = snapshots.decode(envs.snapshot())
        for _ in range(steps):
            envs.step(np.array([[1], [0]]))
        late = envs.snapshot()
        forged = replace(early, envs=(early.envs[0], replace(early.envs[1], steps=1)))

        with pytest.raises(InvalidInput, match="got 1 for 0"):
            envs.restore(snapshots.encode(forged))
        assert envs.snapshot() == late
        envs.reset()
        envs.restore(late)

        assert envs.snapshot() == late


def test_clients_see_no_difference() -> None:
    actions = np.random.default_rng(0).integers(5, size=(120, 3, 1))
    with closing(VectorEnv(TASK, num_envs=3, seed=1)) as envs, closing(VectorEnv(TASK, num_envs=3, seed=2)) as others:
        envs.reset()
        for action in actions[:70]:  # beyond the first episodes
            envs.step(action)
        others.restore(envs.snapshot())
        for action in actions[70:]:
            ours, theirs = envs.step(action, ("top",)), others.step(action, ("top",))
            assert ours.frames["top"].tobytes() == theirs.frames["top"].tobytes()
            assert (ours.terminated | ours.truncated).tolist() == (theirs.terminated | theirs.truncated).tolist()
