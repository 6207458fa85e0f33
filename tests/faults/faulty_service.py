"""The segmentation service as it is, around a model that fails where a trajectory's first pixel asks it to.

The first pixel of a trajectory is (which fault, hundredths of a second to take, brightness). The label of a timestep is
whether its first pixel's brightness is odd, so that every right answer can be told from a wrong one. A call that asks
to be held waits until a test has opened and closed the FIFO `gate` of the data directory.
"""

import json
import logging
import os
import sys
import threading
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from freerein.fork_server import ForkServer, StartChild, spawn
from freerein.model_store import ModelStore
from freerein.serving.health import Health
from freerein.serving.learned import LearnedSettings
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.types.common import Camera
from freerein_segmentation.__main__ import NAME, build
from freerein_segmentation.model import Prediction

SIDE = int(os.environ.get("FAULTY_SIDE", "4"))
RIGHT, RAISES, NOT_A_NUMBER, WRONG_SHAPE, INFINITE, HANGS, HELD = range(7)


class FaultyModel:
    """Answers even and odd, unless told otherwise; `FAULTY_SIDE` is the side of its frames."""

    skills: tuple[str, ...] = ("even", "odd")
    lag, fps = None, 0.0
    camera, action = Camera("front", SIDE, SIDE, 3), None

    def __init__(self, gate: Path) -> None:
        self._gate = gate

    def encode(self, frames: npt.NDArray[np.uint8], _actions: npt.NDArray[Any] | None) -> npt.NDArray[np.uint8]:
        return frames

    def predict_encoded(self, parts: Sequence[npt.NDArray[np.uint8]]) -> Prediction:
        return self.predict(np.concatenate(parts), None)

    def predict(self, frames: npt.NDArray[np.uint8], _actions: npt.NDArray[Any] | None) -> Prediction:
        fault, hundredths, _ = frames[0, 0, 0]
        time.sleep(hundredths / 100)
        if fault == HANGS:
            threading.Event().wait()
        if fault == HELD:
            self._gate.read_bytes()
        if fault == RAISES:
            raise RuntimeError("weights at 0x7f00deadbeef in /root/secret")
        likely = np.eye(2, dtype=np.float32)[frames[:, 0, 0, 2] % 2]
        if fault == NOT_A_NUMBER:
            likely[-1] = np.nan
        if fault == INFINITE:
            likely[-1] = np.inf
        return Prediction(likely[:-1] if fault == WRONG_SHAPE else likely, np.ones(len(frames), np.float32))


def publish_model(data_dir: Path) -> None:
    """Puts a model in the store, once, so that there is an active one to load."""
    store, folder = ModelStore(data_dir / "models" / NAME), data_dir / f"unpublished-{NAME}"
    if not store.active_version("default"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "weights").write_bytes(bytes(range(256)))
        (folder / "card.json").write_text(json.dumps({"dataset": "none"}))
        store.activate(store.publish("", folder))


def build_faulty(
    settings: LearnedSettings, limits: Limits, metrics: Metrics, health: Health, *, start_child: StartChild = spawn
) -> Service:
    """Returns the service."""
    publish_model(settings.data_dir)
    gate = settings.data_dir / "gate"
    if not gate.exists():
        os.mkfifo(gate)
    loaded = partial(build, load=lambda folder, _device: load(folder, gate), start_child=start_child)
    return loaded(settings, limits, metrics, health)


def load(folder: Path, gate: Path) -> FaultyModel:
    """Returns the model, or hangs when told to: with any, or with one that was fitted."""
    is_published_here = (folder / "weights").is_file()
    if os.environ.get("FAULTY_LOAD") in (("hangs",) if is_published_here else ("hangs", "hangs when fitted")):
        logging.getLogger(__name__).warning("hanging")
        threading.Event().wait()
    return FaultyModel(gate)


def write_down_what_is_touched(path: str) -> None:
    """Appends every file that this process opens, and every address that it connects to, to a file."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event in ("open", "socket.connect"):
            os.write(descriptor, f"{event} {arguments[0 if event == 'open' else 1]!r}\n".encode(errors="replace"))

    sys.addaudithook(hook)


if __name__ == "__main__":
    if audit := os.environ.get("FAULTY_AUDIT"):
        write_down_what_is_touched(audit)
    fork_server = ForkServer.fork()
    run(NAME, LearnedSettings, partial(build_faulty, start_child=fork_server.start))
