"""A robot at the imitation service with an untrained policy that never counts a goal as reached."""

from collections.abc import AsyncGenerator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from benchmarks.servers import exchange
from benchmarks.untrained import initialise, publish
from freerein import images, wire
from freerein.api.imitation.v1 import imitation_pb2
from freerein.clients import ImitationClient
from freerein.types.common import ActionSpec, Camera, Goal, Image, ModelRef, Observation
from freerein.types.imitation import ControlRequest, ControlResponse, Hello, Observed
from freerein_imitation.methods import METHODS
from freerein_imitation.methods.goal_conditioned.network import GoalConditionedNetwork, GoalConditionedSpec
from freerein_imitation.model.policy import ControlSpec, PolicyOutput

CONTROL = "/freerein.api.imitation.v1.ImitationService/Control"
NEVER_STEPS = 2**31
"""More control steps per goal than a benchmark takes."""

_ACTION = ActionSpec(3, 0, ("dx", "dy", "dz"), "m", (0.01, 0.01, 0.01))
_CAMERA, _CONTROL_DT_S = "front", 0.02
_VALID_FOR_S = 10.0
_CALIBRATION_FRAMES = 16
_WIDTH = 128
_NUMBERS_AT_ONCE = 1000

Frame = npt.NDArray[np.uint8]
Observe = Callable[[], Awaitable[ControlResponse]]


@dataclass(frozen=True, eq=False)
class Scene:
    """A published policy, the robot, and the images that it sends: the observed one and the goal, uint8 (H, W, 3)."""

    ref: ModelRef
    folder: Path
    frame: Frame
    goal: Frame
    camera: str = _CAMERA
    action: ActionSpec = _ACTION

    def observation(self) -> Observation:
        """Returns the observation."""
        return Observation((_raw(self.frame),))

    def goal_image(self) -> Goal:
        """Returns the goal."""
        return Goal((_raw(self.goal),))

    def hello(self) -> ControlRequest:
        """Returns the first message of a control stream; actions stay valid long enough for late replies."""
        return ControlRequest(
            hello=Hello(
                self.goal_image(),
                (Camera(_CAMERA, *self.frame.shape),),
                _ACTION,
                _CONTROL_DT_S,
                self.ref,
                max_steps_per_goal=NEVER_STEPS,
                valid_for_s=_VALID_FOR_S,
            )
        )

    def hello_bytes(self) -> bytes:
        """Returns the first message of a control stream as bytes."""
        return wire.pack(self.hello()).SerializeToString()

    def observed(self, seq: int) -> ControlRequest:
        """Returns the observation of this number, after one executed action."""
        executed = np.zeros((1, _ACTION.size), np.float32)
        return ControlRequest(observed=Observed(seq, self.observation(), executed, observation_time_ns=seq))

    def observed_bytes(self) -> Iterator[bytes]:
        """Yields observations as bytes, numbered from 0: one prepared message followed by a new number.

        Protobuf keeps the last value of a field that occurs twice.
        """
        prepared = wire.pack(self.observed(0)).SerializeToString()
        for first in count(step=_NUMBERS_AT_ONCE):
            yield from [prepared + _seq_bytes(seq) for seq in range(first, first + _NUMBERS_AT_ONCE)]


def publish_scene(side_px: int, data_dir: Path) -> Scene:
    """Publishes an untrained goal-conditioned policy to the imitation service's store; returns it with its images."""
    frames = np.random.default_rng(0).integers(256, size=(_CALIBRATION_FRAMES, side_px, side_px, 3), dtype=np.uint8)
    camera = Camera(_CAMERA, side_px, side_px, 3)
    spec = GoalConditionedSpec(cameras=(camera,), action=_ACTION, features=_WIDTH, hidden_size=_WIDTH)
    network = GoalConditionedNetwork(spec)
    initialise(network)
    network.fit_normalisation({_CAMERA: torch.from_numpy(frames)}, generator=torch.Generator())
    control = ControlSpec(_CONTROL_DT_S, reached_threshold=1.0, max_steps_per_goal=NEVER_STEPS)
    card = {"method": "goal_conditioned", **control.to_card()}
    ref = publish(network, data_dir, "imitation", name=f"{side_px}px", card=card)
    return Scene(ref, data_dir / "models" / "imitation" / ref.name / ref.version, frames[0], frames[1])


def policy_step(scene: Scene) -> Callable[[], PolicyOutput]:
    """Returns the model call as the service's core makes it, on the scene's frame; the memory is passed on."""
    policy = METHODS.load(scene.folder, "cpu")
    frames, goals = {_CAMERA: scene.frame[None]}, policy.encode_goals({_CAMERA: scene.goal[None]})
    previous, recurrent = policy.spec.action.no_action()[None], np.zeros((1, policy.spec.recurrent_size), np.float32)

    def step() -> PolicyOutput:
        nonlocal recurrent
        output = policy.step(frames, goals, previous, recurrent)
        recurrent = output.recurrent
        return output

    return step


@asynccontextmanager
async def control_stream(client: ImitationClient, scene: Scene) -> AsyncGenerator[Observe, None]:
    """Opens a control stream; yields a function that sends the next observation and returns the reply, a chunk."""
    seqs = count(1)
    async with exchange(client.control) as ask:
        await ask(scene.hello())

        async def observe() -> ControlResponse:
            reply = await ask(scene.observed(next(seqs)))
            if reply.chunk is None:
                raise RuntimeError(f"An observation must be answered by a chunk; got {reply}.")
            return reply

        yield observe


def _seq_bytes(seq: int) -> bytes:
    return imitation_pb2.ControlRequest(observed=imitation_pb2.Observed(seq=seq)).SerializeToString()


def _raw(frame: Frame) -> Image:
    return images.encode(frame, encoding="raw_rgb8", camera=_CAMERA)
