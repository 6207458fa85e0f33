"""The imitation service as a process: `python -m freerein_imitation`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from freerein.api.imitation.v1 import imitation_pb2
from freerein.serving.batcher import Batcher
from freerein.serving.fits import FitService
from freerein.serving.health import Health
from freerein.serving.learned import learned_service, open_store
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein_imitation import fit, model
from freerein_imitation.acting import BatchActor, Policy
from freerein_imitation.control import ControlStreams
from freerein_imitation.core import Actor
from freerein_imitation.settings import ImitationSettings

NAME = "imitation"


def build(
    settings: ImitationSettings,
    limits: Limits,
    metrics: Metrics,
    health: Health,
    *,
    load: Callable[[Path, str], Policy] = model.load,
) -> Service:
    """Returns the service.

    Args:
        settings: What the operator chose.
        limits: The bounds.
        metrics: Where the batcher is measured.
        health: Tells when draining.
        load: Returns the model of a folder, on a device.
    """
    torch.set_num_threads(1)  # one model thread: more would fight each other and the fit
    store = open_store(NAME, settings)
    models: ModelCache[Policy] = ModelCache(
        store,
        lambda folder: _warm(load(folder, settings.device)),
        fit_command="freerein fit imitation DATASET",
    )
    batcher = Batcher(BatchActor().act_batch, queue=settings.queue, batch=limits.batch, metrics=metrics)
    fits = FitService(
        settings.data_dir / "fits" / NAME,
        module="freerein_imitation.fit",
        arguments=(str(settings.data_dir), settings.device),
        store=store,
        models=models,
        resolve=lambda dataset, config: fit.resolve(settings.data_dir, dataset, config, threads=settings.train_threads),
        health=health,
    )
    actor = Actor(models, batcher, timeout_s=limits.unary_s)
    streams = ControlStreams(models, batcher, health=health, drain_s=limits.drain_s)
    contract = imitation_pb2.DESCRIPTOR.services_by_name["ImitationService"]
    return learned_service(NAME, contract, actor, streams, models=models, batchers=(batcher,), fits=fits)


def _warm(loaded: Policy) -> Policy:
    """Returns a model after its first, slowest call."""
    frames = np.zeros((1, loaded.height, loaded.width, loaded.channels), np.uint8)
    goals = {"goal_conditioned": frames, "skills": loaded.skills[:1], "language": ("begin",)}
    codes = loaded.encode_goals(goals[loaded.kind])
    none = np.full((1, loaded.action_size), -1 if loaded.action_choices else 0)
    previous = none.astype(np.int64 if loaded.action_choices else np.float32)
    loaded.step(frames, codes, previous, np.zeros((1, loaded.memory_size), np.float32))
    return loaded


if __name__ == "__main__":
    raise SystemExit(run(NAME, ImitationSettings, build))
