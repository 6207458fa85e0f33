"""The world `doom`, with its engine."""

import asyncio
import os
import signal
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from tests.child_processes import stop
from tests.engine import needs_engine
from tests.waiting import wait_until

from freerein.errors import InvalidInput, SessionNotFound, WorkerLost
from freerein.fork_server import StartChild
from freerein.types.common import Error, error_from
from freerein.types.sim import (
    CreateSessionRequest,
    CreateSessionResponse,
    ResetRequest,
    ResetResponse,
    StepRequest,
    StepResponse,
)
from freerein_sim.workers import protocol
from freerein_sim.workers.handler import RequestHandler
from freerein_sim.workers.worker import Worker
from freerein_sim.worlds.conformance import determinism
from freerein_sim.worlds.conformance.rollouts import demonstrate
from freerein_sim.worlds.doom import TASKS, maps, textmap, wad
from freerein_sim.worlds.doom.floor import floor_between
from freerein_sim.worlds.doom.spec import FORWARD, LEFT, NO_OP, RIGHT
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.walkable_grid import Places, smoothed
from freerein_sim.worlds.world import World, expert_of

pytestmark = needs_engine
BY_NAME = {task.name: task for task in TASKS}


@pytest.fixture(scope="module")
def opened() -> Iterator[World]:
    with closing(build(BY_NAME["doom"], ["heading-along-path"])) as world:
        yield world


def engines(process: int | None = None) -> set[psutil.Process]:
    """Returns the engines of a process, of this one if none is named."""
    return {each for each in psutil.Process(process).children(recursive=True) if each.name() == "vizdoom"}


def remains(engine: psutil.Process) -> set[Path]:
    """Returns the folder and the shared memory of an engine that runs."""
    words = engine.cmdline()
    instance = words[words.index("+viz_instance_id") + 1]
    return {Path(engine.cwd()), *Path("/dev/shm").glob(f"ViZDoom*{instance}")}


def has_ended(process: psutil.Process) -> bool:
    return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE


def act(world: World, *choices: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Takes actions; returns by how much that moved and turned the agent."""
    before = world.truth().state
    for choice in choices:
        world.step(np.array([choice]))
    moved = world.truth().state - before
    moved[2] = (moved[2] + 180) % 360 - 180
    return moved


def length(way: Places) -> float:
    return float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())


def test_actions_move_and_turn_as_the_engine_does(opened: World) -> None:
    opened.reset(np.random.default_rng(0), recipe=["path-1"])  # eastwards

    assert act(opened, NO_OP).tolist() == [0, 0, 0]
    x, y, turned = act(opened, FORWARD, FORWARD)
    assert (x, turned) == (pytest.approx(25, abs=5), 0)
    assert abs(y) < 10
    assert act(opened, LEFT)[2] == pytest.approx(7, abs=0.1)
    assert act(opened, RIGHT, RIGHT)[2] == pytest.approx(-12.3 - 14.06, abs=0.1)  # a turn goes on faster


def test_starts_are_spread_over_spots_and_headings_and_a_condition_keeps_the_room() -> None:
    poses = []
    with closing(build(BY_NAME["doom"])) as world, closing(build(BY_NAME["doom"], ["start-room-10"])) as in_room:
        for seed in range(60):
            world.reset(np.random.default_rng(seed))
            poses.append(world.truth().state)
        in_room.reset(np.random.default_rng(0))
        assert tuple(in_room.truth().state[:2]) == maps.A.spots[10]
        with pytest.raises(InvalidInput, match="begins where that does"):
            in_room.reset(np.random.default_rng(0), recipe=["path-1"])
    places, headings = {tuple(pose[:2]) for pose in poses}, np.array(poses)[:, 2]

    assert places <= set(maps.A.spots.values())
    assert len(places) > 12
    assert np.histogram(headings, 4, (0, 360))[0].min() > 5


def test_a_recipe_is_one_path(opened: World) -> None:
    with pytest.raises(InvalidInput, match="is one path; got path-1, path-2"):
        opened.reset(np.random.default_rng(0), recipe=["path-1", "path-2"])
    with pytest.raises(InvalidInput, match="is one path; got path-2, path-1"):
        expert_of(opened)(["path-2", "path-1"], np.random.default_rng(0))


def test_the_expert_walks_little_farther_than_it_must_and_keeps_off_the_vest(opened: World) -> None:
    floor = floor_between(textmap.read_walls(maps.A.text()))
    for path in opened.spec.skills:
        shown = demonstrate(opened, [path], np.random.default_rng(3))
        walked = shown.states[:, :2]
        shortest = smoothed(floor.way(walked[0], walked[-1]))

        assert shown.episode.success
        assert 60 <= len(shown.episode.actions) <= 180
        assert 600 < length(shortest) <= length(walked) <= 1.2 * length(shortest)


def test_the_vest_ends_an_episode(opened: World) -> None:
    opened.reset(np.random.default_rng(0))
    world = opened._world._world  # type: ignore[attr-defined]
    world._seen = world._engine.begin((1040, -300), 270.0)

    ended = [world.step(np.array([FORWARD])).terminated for _ in range(8)]

    assert ended[-1]
    assert world.render("first-person", height=42, width=42).shape == (42, 42, 1)


def test_textures_change_what_is_seen_and_nothing_that_happens() -> None:
    frames, poses = set(), set()
    for name in ("doom", "doom.v1", "doom.v2"):
        with closing(build(BY_NAME[name])) as world:
            world.reset(np.random.default_rng(4))
            act(world, *[FORWARD] * 5, *[LEFT] * 5)
            frames.add(world.render("first-person", height=42, width=42).tobytes())
            poses.add(world.truth().state.tobytes())

    assert (len(frames), len(poses)) == (3, 1)


def test_a_map_of_our_own_restores_bit_for_bit() -> None:
    determinism.restores_bit_for_bit(BY_NAME["doom.b"])


def test_the_games_own_file_has_every_texture() -> None:
    names = {name for name, _ in wad.read((maps.wheel() / maps.GAME).read_bytes())}
    lumps = dict(wad.read((maps.wheel() / maps.GAME).read_bytes()))
    grid = maps.GRID_B
    walls = lumps["TEXTURE1"]

    for texture in (*maps.A_V1.textures, *maps.A_V2.textures, *grid.walls.values(), grid.floor, grid.ceiling):
        assert texture in names or texture.encode() in walls, texture


def test_spots_are_where_the_map_has_them() -> None:
    things = [block for block in textmap._blocks(maps.A.text(), "thing") if block["type"] == "9001"]

    assert maps.A.spots == {int(each["id"]): (round(float(each["x"])), round(float(each["y"]))) for each in things}


@pytest.mark.fault("M6")
def test_an_engine_that_was_killed_costs_its_session_alone_and_is_said_in_one_line() -> None:
    with closing(RequestHandler(BY_NAME)) as handler:
        request = CreateSessionRequest("doom", num_envs=1, seed=1, max_episode_steps=525)
        one, other = (handler.handle(request).session for _ in range(2))  # type: ignore[attr-defined]
        others = engines()
        handler.handle(ResetRequest(one))
        (engine,) = engines() - others
        folder = Path(engine.cwd())
        handler.handle(ResetRequest(other))
        engine.kill()

        step = StepRequest(one, 1, np.array([[FORWARD]]))
        _, body = protocol.encode(step, call=0, number=0)
        _, reply = handler.reply(protocol.Header(0, protocol.CALLS.index(StepRequest), 1), bytearray(body))
        error = error_from(protocol.decode(reply, Error))

        assert isinstance(error, WorkerLost)
        assert error.detail == "The engine of this world has ended; its session has ended, too."
        assert not folder.exists()
        with pytest.raises(SessionNotFound):
            handler.handle(step)
        handler.handle(StepRequest(other, 1, np.array([[FORWARD]])))


@pytest.mark.fault("M6")
async def test_a_worker_that_is_killed_leaves_no_engine_no_folder_and_no_shared_memory(fork_worker: StartChild) -> None:
    for is_ready in (False, True) * (25 if os.environ.get("FREEREIN_FUZZ") else 1):
        worker = await Worker.start(fork_worker, stuck_s=60)
        request = CreateSessionRequest("doom", num_envs=2, seed=1, max_episode_steps=525)
        session = (await worker.call(request, CreateSessionResponse)).session
        resetting = asyncio.create_task(worker.call(ResetRequest(session), ResetResponse))
        if is_ready:
            await resetting
        await asyncio.to_thread(wait_until, lambda: engines(worker.pid))  # noqa: B023
        running = engines(worker.pid)
        left = set().union(*map(remains, running))

        os.kill(worker.pid, signal.SIGKILL)

        await worker.wait_ended()
        await asyncio.gather(resetting, return_exceptions=True)
        await asyncio.to_thread(wait_until, lambda: not any(path.exists() for path in left))  # noqa: B023
        assert all(map(has_ended, running))


@pytest.mark.fault("M6")
async def test_an_engine_that_hangs_is_killed_with_its_worker(fork_worker: StartChild) -> None:
    worker = await Worker.start(fork_worker, stuck_s=60)
    request = CreateSessionRequest("doom", num_envs=1, seed=1, max_episode_steps=525)
    session = (await worker.call(request, CreateSessionResponse)).session
    await worker.call(ResetRequest(session), ResetResponse)
    (engine,) = engines(worker.pid)
    left = remains(engine)
    stop(engine)

    with pytest.raises(WorkerLost):
        await worker.call(StepRequest(session, 1, np.array([[FORWARD]])), StepResponse, timeout_s=1)

    await worker.wait_ended()
    await asyncio.to_thread(wait_until, lambda: not any(path.exists() for path in left))
    assert has_ended(engine)
