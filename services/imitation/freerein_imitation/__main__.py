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
from freerein_imitation.core import ActService, ControlService, PolicyRunner
from freerein_imitation.model.policy import Policy
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
        settings: Settings of the service.
        limits: Limits on calls.
        metrics: Metrics of the batcher.
        health: Tells when the service drains.
        load: Loads the model in a folder onto a device.
    """
    torch.set_num_threads(1)  # one model thread: more would compete with each other and with a fit
    store = open_store(NAME, settings)
    models: ModelCache[Policy] = ModelCache(
        store,
        lambda folder: _warm_up(load(folder, settings.device)),
        fit_command="freerein fit imitation DATASET",
    )
    batcher = Batcher(PolicyRunner().run_batch, queue=settings.queue, batch=limits.batch, metrics=metrics)
    fits = FitService(
        settings.data_dir / "fits" / NAME,
        module="freerein_imitation.fit",
        arguments=(str(settings.data_dir), settings.device),
        store=store,
        models=models,
        resolve=lambda dataset, config: fit.resolve(settings.data_dir, dataset, config, threads=settings.train_threads),
        health=health,
    )
    act = ActService(models, batcher, timeout_s=limits.unary_s)
    control = ControlService(models, batcher, health=health, drain_s=limits.drain_s)
    contract = imitation_pb2.DESCRIPTOR.services_by_name["ImitationService"]
    return learned_service(NAME, contract, act, control, models=models, batchers=(batcher,), fits=fits)


def _warm_up(policy: Policy) -> Policy:
    """Returns a policy after its first step, which is slower than later ones."""
    spec = policy.spec
    frames = np.zeros((1, spec.height, spec.width, spec.channels), np.uint8)
    goals = {"images": frames, "recipe": spec.skills[:1], "text": ("",)}
    recurrent = np.zeros((1, spec.recurrent_size), np.float32)
    policy.step(frames, policy.encode_goals(goals[spec.goal_form]), spec.no_action()[None], recurrent)
    return policy


if __name__ == "__main__":
    raise SystemExit(run(NAME, ImitationSettings, build))
