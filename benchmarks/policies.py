"""Policies for benchmarks: untrained, which changes no time, and so strict that no goal ever counts as reached."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from freerein import images, wire
from freerein.api.imitation.v1 import imitation_pb2
from freerein.learning import weights
from freerein.learning.model_files import save_model
from freerein.serving.model_store import ModelStore
from freerein.types.common import ActionSpec, Camera, Goal, Image, ModelRef, Observation
from freerein.types.imitation import ControlRequest, Hello, Observed
from freerein_imitation import model

NEVER_STEPS = 2**31
"""Control steps after which a goal is given up: more than a benchmark takes."""

_ACTION = ActionSpec(3, 0, ("dx", "dy", "dz"), "m", (0.01, 0.01, 0.01))
_CAMERA, _CONTROL_DT_S = "front", 0.02
_CERTAIN = 1.0
_PATIENCE_S = 10.0
_CALIBRATION_FRAMES = 16
_WIDTH = 128
_NUMBERED_AT_ONCE = 1000

Frame = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Scene:
    """A policy in a service's store, and what a robot shows it.

    Attributes:
        ref: The policy's name and version.
        folder: Where it lies.
        frame: What is seen, uint8 (H, W, 3).
        goal: What is to be seen, uint8 (H, W, 3).
    """

    ref: ModelRef
    folder: Path
    frame: Frame
    goal: Frame

    @property
    def seen(self) -> Observation:
        """The observation."""
        return Observation((_raw(self.frame),))

    @property
    def wanted(self) -> Goal:
        """The goal."""
        return Goal((_raw(self.goal),))

    def hello(self) -> ControlRequest:
        """Returns what opens a control stream; the robot takes late answers, too, which are measured, not refused."""
        camera = Camera(_CAMERA, *self.frame.shape)
        hello = Hello(
            self.wanted,
            (camera,),
            _ACTION,
            _CONTROL_DT_S,
            self.ref,
            max_steps_per_goal=NEVER_STEPS,
            valid_for_s=_PATIENCE_S,
        )
        return ControlRequest(hello=hello)

    def greeting(self) -> bytes:
        """Returns the Hello as bytes."""
        return wire.pack(self.hello()).SerializeToString()

    def observations(self) -> Iterator[bytes]:
        """Yields observations as bytes, numbered from 0: what is ready is sent again, and a number after it."""
        ready = wire.pack(self.observed(0)).SerializeToString()
        for first in count(step=_NUMBERED_AT_ONCE):
            numbers = [_numbered(seq) for seq in range(first, first + _NUMBERED_AT_ONCE)]
            yield from (ready + number for number in numbers)  # of a field that comes twice, protobuf reads the last

    def observed(self, seq: int) -> ControlRequest:
        """Returns the observation of this number, after one executed action."""
        executed = np.zeros((1, _ACTION.size), np.float32)
        return ControlRequest(observed=Observed(seq, self.seen, executed, observation_time_ns=seq))


def publish(side_px: int, data_dir: Path, *, width: int = _WIDTH) -> Scene:
    """Puts an untrained goal-conditioned policy into the imitation service's store, active; returns it with a scene.

    Args:
        side_px: Height and width of the frames.
        data_dir: The service's data directory.
        width: Image features, and units of the LSTM.
    """
    frames = np.random.default_rng(0).integers(256, size=(_CALIBRATION_FRAMES, side_px, side_px, 3), dtype=np.uint8)
    network = model.GoalConditionedNetwork(
        model.GoalConditionedSpec(
            camera=_CAMERA,
            action_size=_ACTION.size,
            height=side_px,
            width=side_px,
            features=width,
            hidden=width,
        )
    )
    weights.initialise(network, generator=torch.Generator().manual_seed(0))
    network.calibrate(torch.from_numpy(frames))
    folder = data_dir / f"{side_px}px.new"
    folder.mkdir(parents=True)
    handshake = model.Handshake(_ACTION, _CONTROL_DT_S, reached_threshold=_CERTAIN, max_steps_per_goal=NEVER_STEPS)
    save_model(network, folder, card={"kind": model.GoalConditionedPolicy.kind, **handshake.to_card()})
    store = ModelStore(data_dir / "models" / "imitation")
    ref = store.publish(f"{side_px}px", folder)
    store.activate(ref)
    return Scene(ref, store.folder(ref), frames[0], frames[1])


def _numbered(seq: int) -> bytes:
    return imitation_pb2.ControlRequest(observed=imitation_pb2.Observed(seq=seq)).SerializeToString()


def _raw(frame: Frame) -> Image:
    return images.encode(frame, encoding="raw_rgb8", camera=_CAMERA)
