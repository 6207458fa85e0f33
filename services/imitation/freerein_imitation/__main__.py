"""The imitation service as a process: `python -m freerein_imitation`."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from freerein.api.imitation.v1 import imitation_pb2
from freerein.fork_server import ForkServer, StartChild, spawn
from freerein.learning.model_files import choose_device
from freerein.learning.optimiser import IMPORTED_BY_OPTIMISERS
from freerein.serving.batcher import Batcher
from freerein.serving.health import Health
from freerein.serving.learned import LearnedSettings, learned_service
from freerein.serving.lifecycle import Service, run
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein_imitation.core import ActService, ControlService, PolicyRunner, PublishService
from freerein_imitation.methods import METHODS
from freerein_imitation.model.policy import Policy
from freerein_imitation.openpi import OpenpiService

NAME = "imitation"


def build(
    settings: LearnedSettings,
    limits: Limits,
    metrics: Metrics,
    health: Health,
    *,
    load: Callable[[Path, str], Policy] = METHODS.load,
    start_child: StartChild = spawn,
) -> Service:
    """Returns the service; `load` loads the model of a folder onto a device."""
    choose_device(settings.device)  # a missing one ends the start, also where there is no model yet
    torch.set_num_threads(1)  # one model thread: more would compete with each other and with a fit
    batcher = Batcher(
        PolicyRunner().run_batch, queue=settings.queue, batch=limits.batch, metrics=metrics, call_s=limits.unary_s
    )
    return learned_service(
        NAME,
        imitation_pb2.DESCRIPTOR.services_by_name["ImitationService"],
        lambda models: (
            ActService(models, batcher),
            ControlService(models, batcher, health=health, drain_s=limits.drain_s),
            PublishService(models, settings.data_dir),
        ),
        make_websocket=lambda models: OpenpiService(models, batcher).open,
        settings=settings,
        health=health,
        batcher=batcher,
        load=lambda folder: _warm_up(load(folder, settings.device)),
        resolve=METHODS.resolve,
        config_schema=METHODS.schema,
        start_child=start_child,
    )


def _warm_up(policy: Policy) -> Policy:
    """Returns a policy after its first step, which is slower than later ones."""
    spec = policy.spec
    frames = {each.name: np.zeros((1, each.height, each.width, each.channels), np.uint8) for each in spec.cameras}
    goals: dict[str, Any] = {"images": frames, "recipe": spec.skills[:1], "text": ("",)}
    recurrent = np.zeros((1, spec.recurrent_size), np.float32)
    robot_state = np.zeros((1, spec.robot_state_size), np.float32) if spec.robot_state_size else None
    policy.step(
        frames, policy.encode_goals(goals[spec.goal_form]), spec.action.no_action()[None], recurrent, robot_state
    )
    return policy


if __name__ == "__main__":
    fork_server = ForkServer.fork(IMPORTED_BY_OPTIMISERS)
    run(NAME, LearnedSettings, partial(build, start_child=fork_server.start))
