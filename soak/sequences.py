"""Sequences of calls that belong together: sessions, streams, a robot on a WebSocket, a video, a watched run."""

import asyncio
import io
from collections.abc import AsyncIterator
from contextlib import aclosing
from functools import cache, partial

import numpy as np
from benchmarks.servers import exchange
from websockets.asyncio.client import connect

from freerein.types.imitation import ControlRequest, Hello, Observed
from freerein.types.orchestrator import WatchRunRequest
from freerein.types.segmentation import SegmentHello, SegmentRequest, SegmentStreamRequest, Timesteps
from freerein.types.sim import CloseSessionRequest, CreateSessionRequest, ResetRequest, StepRequest
from freerein_imitation.openpi.messages import pack, unpack
from soak.questions import Answer, Question, Services, WrongAnswer, trajectory

_LEASE_S = 5.0
_turns = asyncio.Lock()


def all_sequences() -> list[Question]:
    """Returns the sequences; each is answered by what all its calls are answered."""
    often = [partial(kind, seed=seed) for kind in (session, control) for seed in range(8)]
    return [
        *often,
        *(partial(kind, seed=seed) for kind in (websocket, label_stream, video) for seed in range(4)),
        watch,
    ]


async def open_session(services: Services, seed: int) -> str:
    """Returns a session of the sim service that ends by itself, 5 s after its last call."""
    request = CreateSessionRequest("grid", num_envs=2, seed=seed, lease_s=_LEASE_S)
    return (await services.sim.create_session(request)).session


async def session(services: Services, timeout_s: float, seed: int) -> Answer:
    """Steps two environments; returns the frames."""
    rng = np.random.default_rng(seed)
    session_id = await open_session(services, seed)
    frames = [(await services.sim.reset(ResetRequest(session_id, cameras=("top",)), timeout_s=timeout_s)).frames["top"]]
    for step_id in range(1, 5 + seed):
        step = StepRequest(session_id, step_id, rng.integers(0, 4, (2, 1)), ("top",))
        frames.append((await services.sim.step(step, timeout_s=timeout_s)).frames["top"])
    await services.sim.close_session(CloseSessionRequest(session_id))
    return np.concatenate([each.ravel() for each in frames])


async def control(services: Services, timeout_s: float, seed: int) -> Answer:
    """Sends observations on a control stream, each after the answer to the one before; returns the actions."""
    spec, actions = services.spec, []
    goal = services.act_request(seed).goal
    hello = Hello(goal, spec.cameras, spec.action, spec.control_dt_s, valid_for_s=60)
    async with exchange(partial(services.imitation.control, timeout_s=timeout_s)) as ask:
        await ask(ControlRequest(hello=hello))
        for seq in range(4 + seed):
            seen = Observed(seq, services.act_request(100 * seed + seq).observation)
            reply = await ask(ControlRequest(observed=seen))
            if reply.chunk is None:
                raise WrongAnswer(f"An observation was not answered by a chunk: {reply.error or reply}")
            actions.append(reply.chunk.actions.ravel())
    return np.concatenate(actions)


async def watch(services: Services, timeout_s: float) -> Answer:
    """Watches a run that has ended; returns the numbers of its events."""
    events = services.orchestrator.watch_run(WatchRunRequest(services.run_id), timeout_s=timeout_s)
    return np.array([event.sequence async for event in events])


async def websocket(services: Services, timeout_s: float, seed: int) -> Answer:
    """Sends observations as openpi's client does, each after the answer to the one before; returns the actions."""
    address, actions = services.urls["imitation"].replace("http", "ws", 1), []
    async with connect(address, compression=None, open_timeout=timeout_s) as robot:
        await robot.recv()
        for seq in range(4 + seed):
            frame, goal = services.seen(100 * seed + seq), np.zeros_like(services.seen(0))
            camera = services.spec.cameras[0].name
            await robot.send(pack({f"observation/{camera}": frame, f"goal/{camera}": goal}))
            reply = await robot.recv()
            if isinstance(reply, str):
                raise WrongAnswer(f"An observation was not answered by actions: {reply}")
            actions.append(unpack(reply)["actions"].ravel())
    return np.concatenate(actions)


async def label_stream(services: Services, timeout_s: float, seed: int) -> Answer:
    """Sends a trajectory by two timesteps at a time; returns the labels."""
    frames, actions = trajectory(seed)

    async def messages() -> AsyncIterator[SegmentStreamRequest]:
        yield SegmentStreamRequest(hello=SegmentHello())
        for seq, first in enumerate(range(0, len(frames), 2)):
            now = slice(first, first + 2)
            yield SegmentStreamRequest(timesteps=Timesteps(seq, frames[now], actions=actions[now]))

    async with aclosing(services.segmentation.segment_stream(messages(), timeout_s=timeout_s)) as replies:
        return np.concatenate([reply.labels.labels async for reply in replies if reply.labels])


async def video(services: Services, timeout_s: float, seed: int) -> Answer:
    """Asks for the labels of a video; one client after the other, as a service decodes two at once."""
    request = SegmentRequest(video=_video(seed), actions=trajectory(seed)[1])
    async with _turns:
        return (await services.segmentation.segment(request, timeout_s=timeout_s)).labels


@cache
def _video(seed: int) -> bytes:
    """Returns a trajectory as an mp4 file."""
    import av

    frames, file = trajectory(seed)[0], io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=10)
        _, stream.height, stream.width, _ = frames.shape
        stream.pix_fmt = "yuv444p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode(None))
    return file.getvalue()
