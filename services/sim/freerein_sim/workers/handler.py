"""The child's side: holds sessions, answers one call after the other."""

import ctypes
import logging
import secrets
import socket
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace

from freerein.errors import Internal, ServiceError, SessionNotFound, WorkerLost
from freerein.types import sim
from freerein.types.common import error_message
from freerein_sim.workers import demonstrations, protocol
from freerein_sim.workers.checks import check
from freerein_sim.workers.vector_env import VectorEnv
from freerein_sim.worlds.varied_world import build
from freerein_sim.worlds.world import TaskDefinition, World

_LOG = logging.getLogger(__name__)


class RequestHandler:
    """Answers the requests to one worker process, and holds its sessions. The service has checked names of tasks."""

    def __init__(self, tasks: Mapping[str, TaskDefinition]) -> None:
        self._tasks = tasks
        self._sessions: dict[str, VectorEnv] = {}
        self._demonstrated: tuple[str, list[str]] = ("", [])  # task and conditions of the last demonstration
        self._demonstration_world: World | None = None

    def reply(self, header: protocol.Header, body: bytearray) -> tuple[bytes, bytes]:
        """Returns the framed response to a framed request, or its refusal.

        A bug in one world must not harm the others: any other exception, or a response that cannot be sent, closes the
        session, or the world of demonstrations, and is answered by `Internal`. So does a world whose own
        process has ended, by `WorkerLost`.
        """
        request: object = None
        try:
            request = protocol.decode(body, protocol.CALLS[header.call])
            try:
                response = self.handle(request)
            except ServiceError as error:
                if isinstance(error, WorkerLost):
                    self._abandon(request)
                return _refusal(error, header)
            return protocol.encode(response, call=header.call, number=header.number)
        except Exception:
            _LOG.exception("a world failed")
            self._abandon(request)
            return _refusal(_failed(request), header)

    def close(self) -> None:
        """Frees every world."""
        for envs in self._sessions.values():
            envs.close()
        self._close_demonstration_world()

    def handle(self, request: object) -> object:
        """Returns the response to a request of `protocol.CALLS`. Raises ServiceError where it is refused."""
        response: object
        match request:
            case sim.ListTasksRequest():
                response = sim.ListTasksResponse(tuple(task.describe() for task in self._tasks.values()))
            case sim.CreateSessionRequest():
                response = self._create_session(request)
            case sim.DemonstrateRequest():
                response = self._demonstrate(request)
            case sim.DrawRecipesRequest():
                response = self._draw_recipes(request)
            case sim.CloseSessionRequest():
                self._discard(request.session)
                _return_freed_memory()
                response = sim.CloseSessionResponse()
            case _:
                response = _answer_in_session(self._envs(getattr(request, "session", "")), request)
        return response

    def _create_session(self, request: sim.CreateSessionRequest) -> sim.CreateSessionResponse:
        """Creates a session; the service has filled in the request's defaults."""
        task, seed, session = self._tasks[request.task], request.seed or 0, secrets.token_hex(16)
        self._sessions[session] = VectorEnv(
            task,
            num_envs=request.num_envs,
            seed=seed,
            height=request.height,
            width=request.width,
            privileged=request.privileged,
            conditions=request.conditions,
            max_episode_steps=request.max_episode_steps,
        )
        described = replace(task.describe(), max_episode_steps=request.max_episode_steps)
        return sim.CreateSessionResponse(session, seed, request.num_envs, described, request.lease_s)

    def _demonstrate(self, request: sim.DemonstrateRequest) -> sim.DemonstrateResponse:
        """Returns one trajectory. The service has checked its size for episodes of the nominal length only."""
        world = self._world_of(request)
        cameras, images = request.cameras or (world.spec.cameras[0].name,), world.spec.max_episode_steps
        task = self._tasks[request.task]
        protocol.check_frames(task.describe(), cameras, height=request.height, width=request.width, images=images)
        return demonstrations.make_demonstration(task, world, request)

    def _draw_recipes(self, request: sim.DrawRecipesRequest) -> sim.DrawRecipesResponse:
        """Returns recipes; conditions may limit their length, which only the world's own spec says."""
        task = self._tasks[request.task]
        spec = task.spec
        if request.conditions:
            with closing(build(task, request.conditions)) as world:
                spec = world.spec
        return demonstrations.draw_recipes(task, spec, request)

    def _world_of(self, request: sim.DemonstrateRequest) -> World:
        """Returns the world of the last demonstration, or a new one where that was of another task or conditions."""
        asked = request.task, sorted(request.conditions)
        if self._demonstration_world is None or self._demonstrated != asked:
            made = build(self._tasks[request.task], asked[1])
            self._close_demonstration_world()
            self._demonstrated, self._demonstration_world = asked, made
        return self._demonstration_world

    def _close_demonstration_world(self) -> None:
        world, self._demonstration_world = self._demonstration_world, None
        if world is not None:
            world.close()

    def _envs(self, session: str) -> VectorEnv:
        if (envs := self._sessions.get(session)) is None:
            raise SessionNotFound("There is no such session.", field="session", hint="Create the session anew.")
        return envs

    def _abandon(self, request: object) -> None:
        """Closes what a request failed in: its session, or the world of demonstrations."""
        try:
            if isinstance(request, sim.DemonstrateRequest):
                self._close_demonstration_world()
            self._discard(getattr(request, "session", ""))
        except Exception:
            _LOG.exception("a world that failed cannot be closed either")

    def _discard(self, session: str) -> None:
        if (envs := self._sessions.pop(session, None)) is not None:
            envs.close()


def _return_freed_memory() -> None:
    """Returns the memory of closed worlds to the kernel; glibc would keep most of it."""
    if (trim := getattr(ctypes.CDLL(None), "malloc_trim", None)) is not None:  # other C libraries have none
        trim(0)


def _answer_in_session(envs: VectorEnv, request: object) -> object:
    response: object
    match request:
        case sim.ResetRequest():
            response = envs.reset(request.envs, request.seed, cameras=request.cameras, recipes=request.recipes)
        case sim.StepRequest():
            response = envs.step(request.actions, request.cameras, action_repeat=request.action_repeat or 1)
        case sim.RenderRequest():
            response = envs.render(request.cameras, height=request.height, width=request.width)
        case sim.SnapshotRequest():
            response = sim.SnapshotResponse(envs.snapshot())
        case sim.RestoreRequest():
            envs.restore(request.snapshot, request.envs, request.sources)
            response = sim.RestoreResponse(envs.step_id)
        case sim.CheckRequest():
            response = check(envs.task, request)
        case sim.ExpertActionsRequest():
            response = envs.expert_actions(request.recipes, behaviour=request.behaviour)
        case _:
            raise TypeError(f"no answer to {type(request).__name__}")
    return response


def serve(connection: socket.socket, handler: RequestHandler) -> None:
    """Answers requests from a socket in order, until the other end closes it."""
    try:
        while (head := _receive(connection, protocol.HEADER_BYTES)) is not None:
            header = protocol.decode_header(head)
            if (body := _receive(connection, header.length)) is None:
                return
            for part in handler.reply(header, body):
                connection.sendall(part)
    except (BrokenPipeError, ConnectionResetError):
        return  # the service is gone


def _failed(request: object) -> Internal:
    """Returns the error of a request in which a world failed."""
    if getattr(request, "session", ""):
        return Internal("The world failed; its session has ended.", hint="Create the session anew.")
    return Internal("The world failed; the service's log holds the cause.", hint="Report it; another `seed` may do.")


def _refusal(error: ServiceError, header: protocol.Header) -> tuple[bytes, bytes]:
    return protocol.encode(error_message(error), call=protocol.REFUSED, number=header.number)


def _receive(connection: socket.socket, length: int) -> bytearray | None:
    """Returns the next `length` bytes; None when the other end closed."""
    data = bytearray(length)
    view = memoryview(data)
    while view:
        received = connection.recv_into(view)
        if not received:
            return None
        view = view[received:]
    return data
