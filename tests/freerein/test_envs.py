"""Gymnasium environments over a sim service: here a toy that speaks gRPC and nothing of ours."""
# ruff: noqa: N802 -- gRPC names the methods

import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import grpc
import gymnasium
import numpy as np
import numpy.typing as npt
import pytest
from google.rpc import error_details_pb2, status_pb2
from grpc_status import rpc_status
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import DictInfoToList, RecordEpisodeStatistics

from freerein import wire
from freerein.api.sim.v1 import sim_pb2_grpc
from freerein.envs import SimEnv, SimVectorEnv, leased_session, register
from freerein.errors import FailedPrecondition, InvalidInput, NotFound, Overloaded, ServiceError
from freerein.types.common import ActionSpec, Camera
from freerein.types.sim import (
    CloseSessionResponse,
    CreateSessionRequest,
    CreateSessionResponse,
    ResetRequest,
    ResetResponse,
    StepRequest,
    StepResponse,
    Task,
    Truth,
)

STEPS = 4
CAMERAS = (Camera("front", 40, 44, 3), Camera("wrist", 36, 36, 1))
TASKS = {
    name: Task(name, "line", "", CAMERAS, action, 0.1, (), STEPS)
    for name, action in (
        ("slide", ActionSpec(2, 0, ("along", "stop"))),
        ("hop", ActionSpec(1, 3, ("stay", "go", "stop"))),
    )
}


def refused(code: str) -> status_pb2.Status:
    status = status_pb2.Status(code=grpc.StatusCode.FAILED_PRECONDITION.value[0], message=code)
    status.details.add().Pack(error_details_pb2.ErrorInfo(reason=code, domain="freerein"))
    return status


OUT_OF_ORDER = refused("step_out_of_order")


@dataclass
class Line:
    """A point on a line, seen as the brightness of its frames; an action that says stop ends the episode."""

    rng: np.random.Generator
    position: int = 0
    steps: int = 0

    def reset(self) -> None:
        self.position, self.steps = int(self.rng.integers(100)), 0

    def step(self, action: npt.NDArray[np.generic]) -> tuple[bool, bool]:
        self.steps += 1
        self.position += 1 + int(action[0] > 0.5)
        return bool(action[-1] > (0.9 if len(action) > 1 else 1)), self.steps == STEPS


@dataclass
class Session:
    request: CreateSessionRequest
    lines: list[Line]
    steps: int = 0
    last: StepResponse | None = None

    def frames(self, cameras: tuple[str, ...], lines: list[Line]) -> dict[str, npt.NDArray[np.uint8]]:
        sizes = {c.name: (self.request.height or c.height, self.request.width or c.width, c.channels) for c in CAMERAS}
        return {
            camera: np.array([np.full(sizes[camera], line.position, np.uint8) for line in lines]) for camera in cameras
        }

    def truth(self) -> Truth | None:
        position = np.array([[line.position] for line in self.lines], np.float64)
        truth = Truth(position, position[:, 0].astype(np.float32), position[:, 0] > 100)
        return truth if self.request.privileged else None


def lines(seed: int, count: int) -> list[Line]:
    return [Line(np.random.default_rng(child)) for child in np.random.SeedSequence(seed).spawn(count)]


@dataclass
class Sim(sim_pb2_grpc.SimServiceServicer):
    """`failures`: statuses with which the next steps end after they were made."""

    sessions: dict[str, Session] = field(default_factory=dict)
    asked: list[CreateSessionRequest] = field(default_factory=list)
    created: list[CreateSessionResponse] = field(default_factory=list)
    calls: list[str] = field(default_factory=list)
    failures: list[grpc.StatusCode] = field(default_factory=list)
    refusal: str = ""
    reset_refusal: str = ""
    lost: dict[str, str] = field(default_factory=dict)

    def lose_sessions(self, code: str) -> None:
        self.lost |= dict.fromkeys(self.sessions, code)
        self.sessions.clear()

    def refuse_lost(self, session: str, context) -> None:
        if code := self.refusal or self.lost.get(session, ""):
            self.refusal = ""
            context.abort_with_status(rpc_status.to_status(refused(code)))

    def CreateSession(self, message, context):
        request = wire.unpack(message, CreateSessionRequest)
        if request.task not in TASKS:
            context.abort(grpc.StatusCode.NOT_FOUND, "no such task")
        assert request.idempotency_key
        self.asked.append(request)
        known = (name for name, each in self.sessions.items() if each.request == request)
        count, name = request.num_envs or 1, next(known, f"{len(self.created):032x}")
        self.sessions.setdefault(name, Session(request, lines(7, count)))
        self.created.append(CreateSessionResponse(name, 7, count, TASKS[request.task], request.lease_s))
        return wire.pack(self.created[-1])

    def Reset(self, message, context):
        self.calls.append("Reset")
        request = wire.unpack(message, ResetRequest)
        self.refusal, self.reset_refusal = self.refusal or self.reset_refusal, ""
        self.refuse_lost(request.session, context)
        session = self.sessions[request.session]
        if request.seed is not None:
            session.lines = lines(request.seed, len(session.lines))
        for index in request.envs or range(len(session.lines)):
            session.lines[index].reset()
        return wire.pack(ResetResponse(session.frames(request.cameras, session.lines), session.truth()))

    def Step(self, message, context):
        self.calls.append("Step")
        request = wire.unpack(message, StepRequest)
        self.refuse_lost(request.session, context)
        session = self.sessions[request.session]
        if request.step_id not in (session.steps, session.steps + 1):
            context.abort_with_status(rpc_status.to_status(OUT_OF_ORDER))
        if np.abs(request.actions).max() > 2 or request.actions.shape[0] != len(session.lines):
            context.abort(grpc.StatusCode.INVALID_ARGUMENT, "action out of range")
        if request.step_id > session.steps:
            session.steps, session.last = request.step_id, self._step(session, request)
        if self.failures:
            context.abort(self.failures.pop(), "the reply is lost")
        return wire.pack(session.last)

    def CloseSession(self, message, context):
        if message.session not in self.lost:
            self.sessions.pop(message.session)
        return wire.pack(CloseSessionResponse())

    @staticmethod
    def _step(session: Session, request: StepRequest) -> StepResponse:
        ends = np.array([line.step(action) for line, action in zip(session.lines, request.actions, strict=True)])
        ended = [line for line, end in zip(session.lines, ends, strict=True) if end.any()]
        truth, final = session.truth(), session.frames(request.cameras, ended) if ended else {}
        for line in ended:
            line.reset()
        zeros = np.zeros(len(ends), np.float32)
        frames = session.frames(request.cameras, session.lines)
        return StepResponse(session.steps, frames, zeros, ends[:, 0], ends[:, 1], zeros > 0, final, truth)


@pytest.fixture(scope="module", autouse=True)
def _registered() -> Iterator[None]:
    register(*TASKS)
    yield
    for task in TASKS:
        gymnasium.registry.pop(f"freerein/{task}-v0")


@pytest.fixture(autouse=True)
def _no_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    """A session that cannot be closed in time is left to its lease, which the toy does not have."""
    monkeypatch.setattr(leased_session, "_CALL_S", 60.0)


@pytest.fixture
def service() -> Sim:
    return Sim()


@pytest.fixture
def address(service: Sim) -> Iterator[str]:
    server = grpc.server(ThreadPoolExecutor(2))
    sim_pb2_grpc.add_SimServiceServicer_to_server(service, server)
    port = server.add_insecure_port("127.0.0.1:0")
    server.start()
    yield f"127.0.0.1:{port}"
    server.stop(None).wait()


GO = np.zeros(2, np.float32)
STOP = np.ones(2, np.float32)


def test_an_observation_is_the_one_cameras_frame_or_a_dict_of_several(address: str) -> None:
    with SimEnv("slide", address) as env:
        assert env.observation_space == gymnasium.spaces.Box(0, 255, (40, 44, 3), np.uint8)
        assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
    with SimEnv("hop", address, cameras=("front", "wrist"), height=20) as env:
        shapes = {camera: space.shape for camera, space in env.observation_space.spaces.items()}
        assert shapes == {"front": (20, 44, 3), "wrist": (20, 36, 1)}
        assert env.action_space == gymnasium.spaces.Discrete(3)


@pytest.mark.parametrize("privileged", [False, True], ids=["unprivileged", "privileged"])
@pytest.mark.parametrize("cameras", [("wrist",), ("front", "wrist")], ids=["box", "dict"])
@pytest.mark.parametrize("task", TASKS)
def test_gymnasium_finds_nothing_to_mend(address: str, task: str, cameras: tuple[str, ...], privileged: bool) -> None:
    with gymnasium.make(f"freerein/{task}-v0", address=address, cameras=cameras, privileged=privileged) as env:
        check_env(env.unwrapped)


def test_gymnasium_makes_a_vector_of_one_session(address: str, service: Sim) -> None:
    envs = gymnasium.make_vec("freerein/slide-v0", num_envs=3, address=address)
    assert isinstance(envs, SimVectorEnv)
    assert envs.reset(seed=1)[0].shape == (3, 40, 44, 3)
    assert len(service.sessions) == 1
    envs.close()


def test_the_service_limits_the_timesteps_of_an_episode(address: str, service: Sim) -> None:
    gymnasium.make("freerein/slide-v0", address=address, episode_timesteps=3).close()
    gymnasium.make_vec("freerein/slide-v0", num_envs=2, address=address, episode_timesteps=3).close()
    assert [request.max_episode_steps for request in service.asked] == [3, 3]


def test_the_last_frame_is_the_old_episodes_and_reset_takes_up_the_one_already_begun(
    address: str, service: Sim
) -> None:
    with SimEnv("slide", address, render_mode="rgb_array") as env:
        first, _ = env.reset(seed=3)
        last, _, terminated, truncated, _ = env.step(STOP)
        assert (terminated, truncated) == (True, False)
        assert last.max() == first.max() + 2
        assert env.render().max() == last.max()
        fresh, _ = env.reset()
        [session] = service.sessions.values()
        assert fresh.max() == env.render().max() == session.lines[0].position
        env.step(GO)
        assert service.calls == ["Reset", "Step", "Step"]


def test_reset_begins_another_episode_when_seeded_or_in_the_middle_of_one(address: str, service: Sim) -> None:
    with SimEnv("slide", address) as env:
        first, _ = env.reset(seed=3)
        env.step(STOP)
        again, _ = env.reset(seed=3)
        np.testing.assert_array_equal(first, again)
        env.step(GO)
        env.reset()
        assert service.calls == ["Reset", "Step", "Reset", "Step", "Reset"]


def test_a_step_after_the_end_is_refused_until_reset(address: str) -> None:
    with SimEnv("hop", address) as env:
        env.reset()
        ends = [env.step(0)[2:4] for _ in range(STEPS)]
        assert ends == [(False, False)] * (STEPS - 1) + [(False, True)]
        with pytest.raises(FailedPrecondition, match="has ended"):
            env.step(0)


def test_rewards_and_truth_are_the_oracles_only_when_privileged(address: str) -> None:
    with SimEnv("slide", address) as env, SimEnv("slide", address, privileged=True) as judge:
        env.reset(seed=1)
        _, reset_info = judge.reset(seed=1)
        _, reward, *_, info = env.step(GO)
        _, oracle_reward, *_, oracle_info = judge.step(GO)
    assert (reward, info) == (0.0, {"diverged": False})
    assert oracle_reward == oracle_info["truth"]["reward"] == reset_info["truth"]["state"][0] + 1
    assert oracle_info["truth"]["success"] is False


def test_what_is_returned_belongs_to_the_caller(address: str) -> None:
    with SimEnv("slide", address) as env:
        observation, _ = env.reset()
        observation[:] = 0


def test_a_lost_reply_is_fetched_again_and_no_step_is_made_twice(address: str, service: Sim) -> None:
    with SimEnv("slide", address) as env:
        first, _ = env.reset()
        service.failures = [grpc.StatusCode.UNAVAILABLE] * 2
        second, *_ = env.step(GO)
    assert second.max() == first.max() + 1
    assert service.calls == ["Reset", "Step", "Step", "Step"]


def test_a_refused_action_is_no_step_and_a_step_of_unknown_fate_is_one(address: str, service: Sim) -> None:
    with SimEnv("slide", address) as env:
        first, _ = env.reset()
        with pytest.raises(InvalidInput):
            env.step(3 * STOP)
        service.failures = [grpc.StatusCode.INTERNAL]
        with pytest.raises(ServiceError, match="the reply is lost"):
            env.step(GO)
        third, *_ = env.step(GO)
    assert third.max() == first.max() + 2


def test_an_action_that_is_none_is_no_step(address: str) -> None:
    with SimEnv("slide", address) as env:
        first, _ = env.reset()
        with pytest.raises(ValueError, match="could not convert"):
            env.step("go")
        second, *_ = env.step(GO)
    assert second.max() == first.max() + 1


@pytest.mark.parametrize("made", [0, 1, 2])
def test_after_steps_of_unknown_fate_reset_begins_anew(address: str, service: Sim, made: int) -> None:
    with SimEnv("slide", address) as env:
        env.reset()
        env.step(GO)
        service.failures = [grpc.StatusCode.INTERNAL] * 2
        for _ in range(2):
            with pytest.raises(ServiceError, match="the reply is lost"):
                env.step(GO)
        (session,) = service.sessions.values()
        session.steps = 1 + made
        for _ in range(2):
            first, _ = env.reset(seed=1)
            second, *_ = env.step(GO)
            assert second.max() == first.max() + 1


def test_close_ends_the_session_once_and_needs_no_service(address: str, service: Sim) -> None:
    env = SimEnv("slide", address)
    assert len(service.sessions) == 1
    env.close()
    env.close()
    assert service.sessions == {}
    lost = SimEnv("slide", address)
    service.sessions.clear()
    lost.close()


def test_the_lease_is_renewed_while_the_environment_lives(
    address: str, service: Sim, wait_until: Callable[..., float]
) -> None:
    env = SimEnv("slide", address, lease_s=0.03)
    wait_until(lambda: len(service.created) > 3, 60)
    assert len({each.session for each in service.created}) == 1
    del env
    wait_until(lambda: service.sessions == {}, 60)
    wait_until(lambda: "session-lease" not in {thread.name for thread in threading.enumerate()}, 60)


def test_a_session_that_the_service_lost_is_not_made_again(
    address: str, service: Sim, wait_until: Callable[..., float]
) -> None:
    env = SimEnv("slide", address, lease_s=0.03)
    service.sessions.clear()
    wait_until(lambda: len({each.session for each in service.created}) == 2, 60)
    wait_until(lambda: service.sessions == {}, 60)
    with pytest.raises(ServiceError):
        env.reset()
    env.close()


def test_what_cannot_be_made_leaves_nothing_behind(address: str, service: Sim) -> None:
    threads = {thread.name for thread in threading.enumerate()}
    with pytest.raises(NotFound, match="no such task"):
        SimEnv("fly", address)
    with pytest.raises(InvalidInput, match="among front, wrist"):
        SimEnv("slide", address, cameras=("top",))
    with pytest.raises(InvalidInput, match="rgb_array"):
        SimEnv("slide", address, render_mode="human")
    assert service.sessions == {}
    assert "SimClient" not in {thread.name for thread in threading.enumerate()} - threads


@pytest.mark.parametrize("task", TASKS)
def test_every_info_has_the_same_keys(address: str, task: str) -> None:
    with SimEnv(task, address) as env:
        infos = [env.reset(seed=1)[1]]
        for _ in range(3):
            infos += [env.step(np.zeros_like(env.action_space.sample()))[-1] for _ in range(STEPS)]
            infos.append(env.reset()[1])
    assert {frozenset(info) for info in infos} == {frozenset({"diverged"})}
    assert {type(info["diverged"]) for info in infos} == {bool}


@pytest.mark.parametrize("code", ["session_not_found", "worker_lost"])
def test_reset_takes_a_new_session_where_the_service_lost_the_old_one_and_says_so(
    address: str, service: Sim, code: str
) -> None:
    with SimEnv("slide", address) as env:
        env.reset(seed=3)
        env.step(GO)
        service.lose_sessions(code)
        with pytest.raises(ServiceError) as lost:
            env.step(GO)
        assert lost.value.code == code
        first, info = env.reset(seed=3)
        assert info == {"diverged": False, "new_session": True}
        second, *_, info = env.step(GO)
        assert (second.max(), info) == (first.max() + 1, {"diverged": False})
        assert env.reset()[1] == {"diverged": False}
        assert len(service.sessions) == 1
    assert service.sessions == {}


def test_a_vector_begins_everywhere_in_a_new_session_whatever_was_to_be_reset(address: str, service: Sim) -> None:
    envs = SimVectorEnv("hop", address, num_envs=3)
    envs.reset()
    service.lose_sessions("session_not_found")
    _, info = envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert info["new_session"].all()
    assert not envs.step(np.zeros(3, np.int64))[2].any()
    envs.close()


def test_another_refusal_of_a_reset_makes_no_session(address: str, service: Sim) -> None:
    with SimEnv("slide", address) as env:
        service.refusal = "overloaded"
        with pytest.raises(Overloaded):
            env.reset()
        assert len(service.created) == 1


@pytest.mark.parametrize(
    ("name", "meant"),
    [("frame_skip", "action_repeat"), ("camera", "cameras"), ("max_steps", "episode_timesteps"), ("hieght", "height")],
)
def test_an_option_that_there_is_not_is_named_beside_the_one_that_was_meant(
    address: str, name: str, meant: str
) -> None:
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(InvalidInput, match=f"got `{name}`; did you mean `{meant}`[?]"):
            make("freerein/slide-v0", address=address, **{name: 1})


# --- vectors


@pytest.mark.parametrize("cameras", [("wrist",), ("front", "wrist")], ids=["box", "dict"])
@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP], ids=["same", "next"])
def test_a_vector_of_one_is_what_gymnasium_makes_of_one_environment(
    address: str, mode: AutoresetMode, task: str, cameras: tuple[str, ...]
) -> None:
    options = {"address": address, "cameras": cameras, "privileged": mode is AutoresetMode.SAME_STEP}
    ours = gymnasium.make_vec(f"freerein/{task}-v0", num_envs=1, autoreset_mode=mode, **options)
    theirs = SyncVectorEnv([lambda: SimEnv(task, **options)], autoreset_mode=mode)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert ours.metadata == theirs.metadata
    assert data_equivalence(ours.reset(seed=5), theirs.reset(seed=5), exact=True)
    ours.action_space.seed(5)
    for _ in range(3 * STEPS):
        actions = ours.action_space.sample()
        assert data_equivalence(ours.step(actions), theirs.step(actions), exact=True)
    ours.close()
    theirs.close()


def test_where_an_episode_ends_the_next_step_begins_another_whatever_its_action(address: str, service: Sim) -> None:
    envs = SimVectorEnv("slide", address, num_envs=3, autoreset_mode="NextStep", privileged=True)
    first, _ = envs.reset(seed=2)
    last, rewards, terminated, *_ = envs.step(np.stack([GO, STOP, GO]))
    assert terminated.tolist() == [False, True, False]
    assert (last[:, 0, 0, 0] - first[:, 0, 0, 0]).tolist() == [1, 2, 1]
    assert rewards[1] == last[1].max()
    nothing = np.full(2, np.nan, np.float32)
    begun, rewards, terminated, truncated, info = envs.step(np.stack([GO, nothing, GO]))
    [session] = service.sessions.values()
    assert [line.steps for line in session.lines] == [2, 0, 2]
    assert begun[:, 0, 0, 0].tolist() == [line.position for line in session.lines]
    assert (begun[::2, 0, 0, 0] - last[::2, 0, 0, 0]).tolist() == [1, 1]
    assert (rewards[1], terminated.any(), truncated.any()) == (0, False, False)
    assert info["truth"]["state"][1, 0] == begun[1].max()
    assert "final_obs" not in info
    third, *_ = envs.step(np.stack([GO, GO, GO]))
    assert (third[:, 0, 0, 0] - begun[:, 0, 0, 0]).tolist() == [1, 1, 1]
    envs.close()


def test_where_only_the_reset_of_a_step_failed_the_step_is_not_made_twice(address: str, service: Sim) -> None:
    envs = SimVectorEnv("slide", address, num_envs=2, autoreset_mode=AutoresetMode.NEXT_STEP)
    envs.reset(seed=2)
    last, *_ = envs.step(np.stack([GO, STOP]))
    [session] = service.sessions.values()
    service.reset_refusal = "overloaded"
    with pytest.raises(ServiceError):
        envs.step(np.stack([GO, GO]))
    again, *_ = envs.step(np.stack([GO, GO]))
    assert session.steps == 2
    assert again[:, 0, 0, 0].tolist() == [line.position for line in session.lines]
    assert again[0].max() == last[0].max() + 1
    other, *_ = envs.step(np.stack([GO, GO]))
    assert (session.steps, other[0].max()) == (3, again[0].max() + 1)
    envs.close()


def test_a_mask_resets_one_that_ended_and_leaves_another_that_is_to_reset_next(address: str) -> None:
    envs = SimVectorEnv("slide", address, num_envs=3, autoreset_mode=AutoresetMode.NEXT_STEP)
    envs.reset(seed=2)
    last, *_ = envs.step(np.stack([GO, STOP, STOP]))
    shown, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert (shown[2] == last[2]).all()
    after, *_ = envs.step(np.stack([GO, GO, GO]))
    assert after[1].max() == shown[1].max() + 1
    envs.close()


def test_gymnasiums_limit_of_steps_is_one_of_timesteps(address: str, service: Sim) -> None:
    for limit, repeat in ((3, 1), (3, 2), (-1, 2), (None, 1)):
        options = {"max_episode_steps": limit, "action_repeat": repeat, "address": address}
        gymnasium.make_vec("freerein/slide-v0", num_envs=2, **options).close()
    assert [request.max_episode_steps for request in service.asked] == [3, 6, 0, 0]
    with pytest.raises(InvalidInput, match="`max_episode_steps` must be at least 1 step"):
        SimVectorEnv("slide", address, num_envs=1, max_episode_steps=3, episode_timesteps=3)
    with pytest.raises(InvalidInput, match="SAME_STEP or NEXT_STEP"):
        SimVectorEnv("slide", address, num_envs=1, autoreset_mode=AutoresetMode.DISABLED)


def test_where_an_episode_ends_the_next_begins_and_the_final_observation_is_in_info(address: str) -> None:
    with_stop = np.stack([GO, STOP, GO])
    envs = SimVectorEnv("slide", address, num_envs=3, privileged=True, render_mode="rgb_array")
    first, _ = envs.reset(seed=2)
    second, reward, terminated, truncated, info = envs.step(with_stop)
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert info["_final_obs"].tolist() == info["_final_info"].tolist() == [False, True, False]
    assert info["final_obs"][1].max() == reward[1] == first[1].max() + 2
    assert info["final_info"]["truth"]["state"][1, 0] == reward[1]
    assert info["_truth"].tolist() == [True, False, True]
    assert [frame.max() for frame in envs.render()] == second.max(axis=(1, 2, 3)).tolist()
    envs.close()


def test_environments_of_a_vector_draw_from_spawned_seeds_and_a_mask_resets_some(address: str) -> None:
    envs = SimVectorEnv("hop", address, num_envs=3)
    first, _ = envs.reset(seed=11)
    expected = [np.random.default_rng(child).integers(100, size=2) for child in np.random.SeedSequence(11).spawn(3)]
    assert first[:, 0, 0, 0].tolist() == [draws[0] for draws in expected]
    some, _ = envs.reset(options={"reset_mask": np.array([False, True, False])})
    assert some[:, 0, 0, 0].tolist() == [expected[0][0], expected[1][1], expected[2][0]]
    with pytest.raises(InvalidInput, match=r"bool \(3,\)"):
        envs.reset(options={"reset_mask": np.zeros(3, np.bool_)})
    envs.close()


def test_gymnasiums_wrappers_fit(address: str) -> None:
    envs = DictInfoToList(RecordEpisodeStatistics(SimVectorEnv("hop", address, num_envs=2, privileged=True)))
    envs.reset(seed=0)
    for _ in range(STEPS):
        *_, infos = envs.step(np.zeros(2, np.int64))
    assert [info["episode"]["l"] for info in infos] == [STEPS, STEPS]
    assert all(info["final_info"]["truth"]["state"].shape == (1,) for info in infos)
    envs.close()


# --- learners that know nothing of us


@pytest.mark.long
@pytest.mark.parametrize("cameras", [("front",), ("front", "wrist")], ids=["box", "dict"])
@pytest.mark.parametrize("task", TASKS)
def test_stable_baselines_trains_on_environments_as_they_are(address: str, task: str, cameras: tuple[str, ...]) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.env_checker import check_env as check_for_stable_baselines
    from stable_baselines3.common.env_util import make_vec_env

    policy, width = ("CnnPolicy", "features_dim") if len(cameras) == 1 else ("MultiInputPolicy", "cnn_output_dim")
    small = {"features_extractor_kwargs": {width: 8}}
    with SimEnv(task, address, cameras=cameras) as env:
        check_for_stable_baselines(env)
        sb3.PPO(policy, env, n_steps=8, batch_size=8, n_epochs=1, policy_kwargs=small).learn(8)
    envs = make_vec_env(lambda: SimEnv(task, address, cameras=cameras), n_envs=2, seed=0)
    learner = sb3.PPO(policy, envs, n_steps=8, batch_size=8, n_epochs=1, policy_kwargs=small)
    assert learner.learn(16).num_timesteps == 16
    envs.close()
