"""Sequences through the other doors: a robot on a WebSocket, labels of a stream and of a video."""

import asyncio
import io
from collections.abc import AsyncIterator
from contextlib import aclosing
from functools import cache, partial

import numpy as np
from websockets.asyncio.client import connect

from freerein.types.segmentation import SegmentHello, SegmentRequest, SegmentStreamRequest, Timesteps
from freerein_imitation.openpi.messages import pack, unpack
from soak.questions import Answer, Question, Services, WrongAnswer, trajectory

_OF_EACH_KIND = 4
_turns = asyncio.Lock()


def all_doors() -> list[Question]:
    """Returns the sequences; each is answered by what all its calls are answered."""
    return [partial(kind, seed=seed) for kind in (websocket, label_stream, video) for seed in range(_OF_EACH_KIND)]


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
