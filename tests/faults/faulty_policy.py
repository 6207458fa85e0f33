"""The imitation service as it is, around a policy that fails where an observation's first pixel asks it to.

The first pixel of an observation is (which fault, hundredths of a second to take, brightness); a goal is reached by an
observation of its brightness. One that asks to be held waits until a test has opened and closed the FIFO `gate` of the
data directory. The policy remembers all that it saw and did, so that no two histories have one answer,
and its weights are drawn from the seed in its file, so that no two versions have one answer.
"""

import json
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from freerein.model_store import ModelStore
from freerein.serving.health import Health
from freerein.serving.learned import LearnedSettings
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.types.common import ActionSpec, Camera, ModelRef
from freerein_imitation.__main__ import NAME, build
from freerein_imitation.model.policy import CameraFrames, Policy, PolicyOutput, PolicySpec

RIGHT, RAISES, NOT_A_NUMBER, WRONG_SHAPE, INFINITE, HELD = range(6)
SEEDS = (7, 8)  # of the versions that are published; the first is active
Floats = npt.NDArray[np.float32]


class FaultyPolicy(Policy):
    """Answers what its whole history says, unless told otherwise."""

    spec = PolicySpec(
        action=ActionSpec(2, 0, ("x", "y"), "m", (0.01, 0.01)),
        control_dt_s=0.02,
        reached_threshold=0.5,
        max_steps_per_goal=1000,
        goal_form="images",
        cameras=(Camera("front", 4, 4, 3),),
        horizon=3,
        recurrent_size=5,
    )

    def __init__(
        self,
        seed: int,
        *,
        sleep: Callable[[float], None] = lambda _seconds: None,
        hold: Callable[[], object] = lambda: None,
    ) -> None:
        self._sleep, self._hold = sleep, hold
        rng = np.random.default_rng(seed)
        pixels, size = 4 * 4 * 3, self.spec.recurrent_size
        self._seen = rng.normal(0, 0.3, (pixels, size)).astype(np.float32)
        self._wanted = rng.normal(0, 0.3, (pixels, size)).astype(np.float32)
        self._done = rng.normal(0, 1, (self.spec.action.size, size)).astype(np.float32)
        self._act = rng.normal(0, 1, (size, self.spec.horizon * self.spec.action.size)).astype(np.float32)

    def encode_goals(self, goals: CameraFrames) -> Floats:
        return (goals["front"].reshape(len(goals["front"]), -1) / 255.0).astype(np.float32)

    def step(
        self, images: CameraFrames, goals: Floats, previous: Floats, recurrent: Floats, _robot_state: None = None
    ) -> PolicyOutput:
        frames = images["front"]
        faults = frames[:, 0, 0, 0]
        self._sleep(frames[:, 0, 0, 1].max() / 100)
        if HELD in faults:
            self._hold()
        if RAISES in faults:
            raise RuntimeError("weights at 0x7f00deadbeef in /root/secret")
        seen = (frames.reshape(len(frames), -1) / 255.0).astype(np.float32)
        hidden = np.tanh(0.5 * recurrent + seen @ self._seen + goals @ self._wanted + previous @ self._done)
        actions = np.tanh(hidden @ self._act).reshape(len(frames), self.spec.horizon, self.spec.action.size)
        actions[faults == NOT_A_NUMBER] = np.nan
        hidden[faults == INFINITE, -1] = np.inf
        reached = (np.round(255 * goals[:, 2]) == frames[:, 0, 0, 2]).astype(np.float32)
        familiar = (1 / (1 + frames[:, 0, 0, 2])).astype(np.float32)
        return PolicyOutput(actions[:, : 2 if WRONG_SHAPE in faults else None], reached, hidden, familiar)


def load(folder: Path, _device: str, *, hold: Callable[[], object] = lambda: None) -> FaultyPolicy:
    return FaultyPolicy(int(json.loads((folder / "weights").read_bytes())), sleep=time.sleep, hold=hold)


def publish_policies(data_dir: Path) -> list[ModelRef]:
    """Puts a version for each seed in the store, once; returns them all."""
    store = ModelStore(data_dir / "models" / NAME)
    refs = []
    for seed in SEEDS:
        folder = data_dir / f"unpublished-{seed}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "weights").write_text(json.dumps(seed))
        (folder / "card.json").write_text(json.dumps({"dataset": "none"}))
        refs.append(store.publish("", folder))
    if not store.active_version("default"):
        store.activate(refs[0])
    return refs


def build_faulty(settings: LearnedSettings, limits: Limits, metrics: Metrics, health: Health) -> Service:
    """Returns the service."""
    publish_policies(settings.data_dir)
    gate = settings.data_dir / "gate"
    if not gate.exists():
        os.mkfifo(gate)
    return build(settings, limits, metrics, health, load=partial(load, hold=gate.read_bytes))


if __name__ == "__main__":
    run(NAME, LearnedSettings, build_faulty)
