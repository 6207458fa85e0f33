"""Calls whose right answers are known: those of the same services while they did nothing else."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import httpx
import numpy as np
import numpy.typing as npt

from freerein import wire
from freerein.clients import ImitationClient, OrchestratorClient, RewardClient, SegmentationClient, SimClient
from freerein.types.common import Goal, Image, Observation
from freerein.types.imitation import ActRequest, GetSpecResponse
from freerein.types.orchestrator import GetRunRequest
from freerein.types.reward import RewardRequest
from freerein.types.segmentation import SegmentRequest
from freerein.types.sim import DemonstrateRequest

_OF_EACH_KIND = 16
_TOLERANCE = 1e-4
"""Rounding differs between batches."""

Answer = npt.NDArray[Any]


class WrongAnswer(Exception):
    """A call was answered otherwise than while the services did nothing else."""


@dataclass(frozen=True)
class Services:
    """The services under load.

    Attributes:
        addresses: gRPC address by service.
        urls: REST URL by service.
        rest: HTTP client.
        spec: Spec of the imitation service's model.
        run_id: A run that has succeeded.
    """

    sim: SimClient
    segmentation: SegmentationClient
    imitation: ImitationClient
    reward: RewardClient
    orchestrator: OrchestratorClient
    rest: httpx.AsyncClient
    addresses: dict[str, str]
    urls: dict[str, str]
    spec: GetSpecResponse
    run_id: str

    def picture(self, pixels: Answer) -> Image:
        """Returns an image for the imitation service's model: uint8 (height, width, 3)."""
        camera = self.spec.cameras[0]
        return Image("raw_rgb8", camera.height, camera.width, pixels.tobytes(), camera.name)

    def seen(self, seed: int) -> Answer:
        """Returns what a robot may see, uint8 (height, width, 3)."""
        camera = self.spec.cameras[0]
        return _noise(seed, camera.height, camera.width)

    def act_request(self, seed: int) -> ActRequest:
        """Returns an observation of noise, and as a goal a black image, which noise never reaches."""
        noise = self.seen(seed)
        return ActRequest(Observation((self.picture(noise),)), Goal((self.picture(np.zeros_like(noise)),)))


Question = Callable[[Services, float], Awaitable[Answer]]
"""Asks a service within a number of seconds; returns its answer."""


def all_questions() -> list[Question]:
    """Returns the questions, equally many of each kind."""
    kinds = (segment, segment_over_rest, act, reward, demonstrate)
    questions: list[Question] = [partial(kind, seed=seed) for kind in kinds for seed in range(_OF_EACH_KIND)]
    return questions + [partial(get_run) for _ in range(_OF_EACH_KIND)]  # each another question


def check(answer: Answer, expected: Answer) -> None:
    """Raises WrongAnswer where two answers differ."""
    if answer.shape != expected.shape or not np.allclose(answer, expected, rtol=0, atol=_TOLERANCE):
        raise WrongAnswer(f"An answer of shape {answer.shape} differs from the one of shape {expected.shape}.")


def trajectory(seed: int) -> tuple[Answer, Answer]:
    """Returns frames of noise, uint8 (12, 33, 30, 3), and actions, int64 (12, 1)."""
    return _noise(seed, 12, 33, 30), np.random.default_rng(seed).integers(0, 5, (12, 1))


def segment_request(seed: int) -> SegmentRequest:
    """Returns a request for the labels of a trajectory."""
    frames, actions = trajectory(seed)
    return SegmentRequest(frames=frames, actions=actions)


async def segment(services: Services, timeout_s: float, seed: int) -> Answer:
    """Asks for the labels of a trajectory over gRPC."""
    response = await services.segmentation.segment(segment_request(seed), timeout_s=timeout_s)
    return np.concatenate([response.labels, response.confidence])


def segment_json(seed: int) -> bytes:
    """Returns the body of the same over REST."""
    return httpx.Request("POST", "http://x", json=wire.to_json(segment_request(seed))).content


async def segment_over_rest(services: Services, timeout_s: float, seed: int) -> Answer:
    """Asks for the labels of a trajectory over REST."""
    headers = {"content-type": "application/json"}
    url = f"{services.urls['segmentation']}/v1/segment"
    reply = await services.rest.post(url, content=segment_json(seed), headers=headers, timeout=max(timeout_s, 1.0))
    document = reply.raise_for_status().json()
    return np.array(document["labels"] + document["confidence"])


async def act(services: Services, timeout_s: float, seed: int) -> Answer:
    """Asks for the next actions towards a goal."""
    return (await services.imitation.act(services.act_request(seed), timeout_s=timeout_s)).actions


async def reward(services: Services, timeout_s: float, seed: int) -> Answer:
    """Asks for the similarity of an image to a goal text."""
    colours = ("red", "green", "yellow", "blue")
    text = f"a {colours[seed % 4]} block on top of a {colours[(seed + 1) % 4]} block"
    request = RewardRequest(text, {"front": _noise(seed, 1, 64, 64)}, mode="raw")
    return (await services.reward.reward(request, timeout_s=timeout_s)).similarities


async def demonstrate(services: Services, timeout_s: float, seed: int) -> Answer:
    """Asks for a trajectory of random actions."""
    request = DemonstrateRequest("grid", "random", count=1, seed=seed)
    found = [each.trajectory async for each in services.sim.demonstrate(request, timeout_s=timeout_s)]
    return np.concatenate([frames.ravel() for trajectory in found for frames in trajectory.frames.values()])


async def get_run(services: Services, timeout_s: float) -> Answer:
    """Asks for the state of a run that has ended."""
    run = (await services.orchestrator.get_run(GetRunRequest(services.run_id), timeout_s=timeout_s)).run
    return np.array([run.state == "succeeded", run.step, run.steps])


def _noise(seed: int, *shape: int) -> npt.NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (*shape, 3), np.uint8)
