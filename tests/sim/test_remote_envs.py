"""Gymnasium environments over the real sim service, in a process of its own."""

from collections.abc import Callable

import grpc
import gymnasium
import numpy as np
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc
from gymnasium.utils.env_checker import check_env

from freerein.clients import Channel, SimClient, SyncClient
from freerein.clients.tasks import find_camera, find_task
from freerein.envs import SimEnv, SimVectorEnv
from freerein.errors import InvalidInput, NotFound, Unauthenticated
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds import blocks, grid
from freerein_sim.worlds.tasks import tasks

TOKEN = "secret"
TASKS = {task.name: task for task in (*grid.TASKS, *blocks.TASKS)}

pytestmark = pytest.mark.e2e


@pytest.fixture(scope="module")
def address(start_module_service: Callable[..., object]) -> str:
    service = start_module_service("freerein_sim", FREEREIN_TOKEN=TOKEN, FREEREIN_SIM_WORKERS="1")
    with grpc.insecure_channel(service.address) as channel:
        for reply in health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest(), timeout=300.0):
            if reply.status == health_pb2.HealthCheckResponse.SERVING:
                break
    return service.address


@pytest.mark.parametrize(
    ("task", "cameras", "privileged"), [("grid", (), False), ("blocks.red-left-of-blue", ("front", "left"), True)]
)
def test_gymnasium_finds_nothing_to_mend(address: str, task: str, cameras: tuple[str, ...], privileged: bool) -> None:
    options = {"address": address, "cameras": cameras, "privileged": privileged, "token": TOKEN}
    with gymnasium.make(f"freerein/{task}-v0", **options) as env:
        check_env(env.unwrapped)


def test_every_task_that_comes_with_freerein_has_an_id() -> None:
    ids = {name for name, each in gymnasium.registry.items() if each.namespace == "freerein"}
    assert ids == {f"freerein/{task}-v0" for task in tasks()}


@pytest.mark.fault("M11")
@pytest.mark.parametrize(
    ("task", "steps", "conditions"),
    [
        ("grid", 60, ("noise-10", "warm")),
        ("blocks", 5, ("camera-5cm", "blocks-3")),
    ],
)
def test_a_remote_vector_is_bit_for_bit_the_one_in_process(
    address: str, task: str, steps: int, conditions: tuple[str, ...]
) -> None:
    camera = TASKS[task].spec.cameras[0].name
    local = VectorEnv(TASKS[task], num_envs=3, seed=0, privileged=True, conditions=conditions)
    remote = SimVectorEnv(task, address, num_envs=3, privileged=True, conditions=conditions, token=TOKEN)
    first, _ = remote.reset(seed=4)
    np.testing.assert_array_equal(first, local.reset(seed=4, cameras=(camera,)).frames[camera])
    remote.action_space.seed(4)
    for _ in range(steps):
        actions = remote.action_space.sample()
        observation, reward, terminated, truncated, info = remote.step(actions)
        expected = local.step(actions.reshape(3, -1), (camera,))
        ended = expected.terminated | expected.truncated
        np.testing.assert_array_equal(observation, expected.frames[camera])
        np.testing.assert_array_equal(reward, expected.truth.reward)
        np.testing.assert_array_equal(terminated | truncated, ended)
        for final, index in zip(expected.final_frames[camera], np.flatnonzero(ended), strict=True):
            np.testing.assert_array_equal(info["final_obs"][index], final)
    remote.close()
    local.close()


def test_an_action_is_held_as_in_process(address: str) -> None:
    local = VectorEnv(TASKS["blocks"], num_envs=2, seed=0)
    options = {"num_envs": 2, "action_repeat": 4, "episode_timesteps": 6, "address": address, "token": TOKEN}
    remote = gymnasium.make_vec("freerein/blocks-v0", **options)
    remote.reset(seed=4)
    local.reset(seed=4)
    actions = np.full((2, 3), 0.5, np.float32)
    observation, *_ = remote.step(actions)
    expected = local.step(actions, ("front",), action_repeat=4)
    np.testing.assert_array_equal(observation, expected.frames["front"])
    assert remote.step(actions)[3].all()
    assert remote.metadata["render_fps"] == pytest.approx(1 / (4 * TASKS["blocks"].spec.control_dt_s))
    remote.close()
    local.close()


def test_an_action_is_held_for_a_timestep_at_least(address: str) -> None:
    with pytest.raises(InvalidInput, match="at least 1 timestep") as refusal:
        SimEnv("grid", address, token=TOKEN, action_repeat=0)
    assert refusal.value.field == "action_repeat"


def test_errors_of_the_service_say_what_to_mend(address: str) -> None:
    with pytest.raises(NotFound, match="name of a task") as not_found:
        SimEnv("fly", address, token=TOKEN)
    assert not_found.value.hint
    with pytest.raises(Unauthenticated):
        SimEnv("grid", address, token="guess")
    with SimEnv("blocks", address, token=TOKEN) as env:
        env.reset()
        with pytest.raises(InvalidInput) as invalid:
            env.step(np.full(3, 2.0))
        assert invalid.value.field == "actions"
        env.step(np.zeros(3))


def test_a_task_is_found_by_its_name(address: str) -> None:
    with SyncClient(SimClient(Channel(address, token=TOKEN))) as sim:
        assert find_task(sim, "grid").name == "grid"
        with pytest.raises(NotFound, match="must name one") as not_found:
            find_task(sim, "gri")
        assert not_found.value.field == "config.task"


def test_a_camera_is_found_by_its_name_and_the_first_by_none() -> None:
    task = TASKS["grid"].describe()
    assert find_camera(task, "").name == find_camera(task, "top").name == "top"
    with pytest.raises(InvalidInput, match="must be one of the task's, top; got `below`") as refused:
        find_camera(task, "below")
    assert (refused.value.field, refused.value.hint) == ("config.camera", "Leave it out for the first.")
