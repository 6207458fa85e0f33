"""The segmentation service as a process: `python -m freerein_segmentation`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import torch

from freerein.api.segmentation.v1 import segmentation_pb2
from freerein.fork_server import ForkServer, StartChild, spawn
from freerein.learning.model_files import choose_device
from freerein.learning.optimiser import IMPORTED_BY_OPTIMISERS
from freerein.serving.batcher import Batcher
from freerein.serving.health import Health
from freerein.serving.learned import LearnedSettings, learned_service
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits, Slots
from freerein.serving.metrics import Metrics
from freerein_segmentation.core import Segmenter, SegmentStreamService, SkillModel, VideoDecoding, run_batch
from freerein_segmentation.methods import METHODS

NAME = "segmentation"

_BATCH = 1
"""Trajectories are answered one by one: none of a batch would be answered before the last of it is computed."""


def build(
    settings: LearnedSettings,
    limits: Limits,
    metrics: Metrics,
    health: Health,
    *,
    load: Callable[[Path, str], SkillModel] = METHODS.load,
    start_child: StartChild = spawn,
) -> Service:
    """Returns the service; `load` loads the model of a folder onto a device."""
    choose_device(settings.device)  # a missing one ends the start, also where there is no model yet
    torch.set_num_threads(1)  # more would compete with the fit
    batcher = Batcher(run_batch, queue=settings.queue, batch=_BATCH, metrics=metrics, call_s=limits.unary_s)
    return learned_service(
        NAME,
        segmentation_pb2.DESCRIPTOR.services_by_name["SegmentationService"],
        lambda models: (
            Segmenter(
                models,
                batcher,
                VideoDecoding(limits.videos),
                Slots(limits.buffered_bytes, "bytes of decoded images may be in memory"),
            ),
            SegmentStreamService(models, batcher, health=health, drain_s=limits.drain_s),
        ),
        settings=settings,
        health=health,
        batcher=batcher,
        load=lambda folder: _warm(load(folder, settings.device)),
        resolve=METHODS.resolve,
        config_schema=METHODS.schema,
        start_child=start_child,
    )


def _warm(loaded: SkillModel) -> SkillModel:
    """Returns a model after its first, slow call."""
    camera, action = loaded.camera, loaded.action
    frames = np.zeros((1, camera.height, camera.width, camera.channels), np.uint8)
    loaded.predict(frames, np.zeros((1, action.size), action.dtype) if action else None)
    return loaded


if __name__ == "__main__":
    fork_server = ForkServer.fork(IMPORTED_BY_OPTIMISERS)
    run(NAME, LearnedSettings, partial(build, start_child=fork_server.start))
