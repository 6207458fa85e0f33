"""The reward service as a process: `python -m freerein_reward`."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NoReturn

import numpy as np
import torch

from freerein.api.reward.v1 import reward_pb2
from freerein.errors import FailedPrecondition
from freerein.fork_server import ForkServer, StartChild, spawn
from freerein.learning.model_files import choose_device
from freerein.learning.optimiser import IMPORTED_BY_OPTIMISERS
from freerein.model_store import ModelStore
from freerein.serving.batcher import Batcher
from freerein.serving.health import Health
from freerein.serving.learned import learned_service, open_store
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.serving.model_cache import ModelCache
from freerein.types.common import ModelRef
from freerein_reward.core import (
    GoalCache,
    GroundingCore,
    GroundingModel,
    Inference,
    InferenceBatcher,
    RewardCore,
    RewardModel,
    RewardStreamService,
)
from freerein_reward.methods import METHODS, load
from freerein_reward.model import GROUNDING
from freerein_reward.settings import RewardSettings

NAME = "reward"
_PRETRAIN = "python -m freerein_reward.pretrain FOLDER"


def build(
    settings: RewardSettings,
    limits: Limits,
    metrics: Metrics,
    health: Health,
    *,
    load: Callable[[Path, str], RewardModel | GroundingModel] = load,
    start_child: StartChild = spawn,
) -> Service:
    """Returns the service; `load` loads the model of a folder onto a device."""
    choose_device(settings.device)  # a missing one ends the start, also where there is no model yet
    torch.set_num_threads(1)  # more would compete with the fit
    grounding = _grounding_folder(open_store(NAME, settings))
    goals = GoalCache(settings.goal_cache_bytes)
    batcher: InferenceBatcher = Batcher(
        Inference(goals).run, queue=settings.queue, batch=limits.batch, metrics=metrics, call_s=limits.unary_s
    )

    def make_cores(models: ModelCache[RewardModel | GroundingModel]) -> Sequence[object]:
        rewards = RewardCore(models, batcher, goals)
        return rewards, RewardStreamService(rewards, health, limits.drain_s), GroundingCore(models, batcher)

    return learned_service(
        NAME,
        reward_pb2.DESCRIPTOR.services_by_name["RewardService"],
        make_cores,
        settings=settings,
        health=health,
        batcher=batcher,
        load=lambda folder: _warm(load(folder, settings.device)),
        resolve=partial(METHODS.resolve, grounding=grounding) if grounding else _refuse_without_grounding,
        fit_arguments=(str(grounding),),
        config_schema=METHODS.schema,
        start_child=start_child,
        fit_hint=f"; a grounding model: {_PRETRAIN}",
    )


def _grounding_folder(store: ModelStore) -> Path | None:
    """Returns the folder of the grounding model for fits: the version that is active at start."""
    version = store.active_version(GROUNDING)
    return store.folder(ModelRef(GROUNDING, version)) if version else None


def _refuse_without_grounding(*_arguments: object, **_options: object) -> NoReturn:
    raise FailedPrecondition(
        "A fit needs a grounding model to caption images; there is none.",
        field="dataset",
        hint=f"Train one: {_PRETRAIN}; then restart the service.",
    )


def _warm(loaded: RewardModel | GroundingModel) -> RewardModel | GroundingModel:
    """Returns a model after its first, slow call."""
    image = loaded.preprocess(np.zeros((1, 1, 3), np.uint8))[None]
    if isinstance(loaded, GroundingModel):
        loaded.locate(image, ("a thing",))
    if isinstance(loaded, RewardModel):
        loaded.embed_images(dict.fromkeys(loaded.cameras, image))
        loaded.embed_texts(("a thing",))
    return loaded


if __name__ == "__main__":
    fork_server = ForkServer.fork(IMPORTED_BY_OPTIMISERS)
    run(NAME, RewardSettings, partial(build, start_child=fork_server.start))
