"""Error of actions given skills: a criterion that compares labels of any origin without true ones.

Labels that follow what the robot does make its actions predictable from a frame and the skill; a boundary that is moved
gives some timesteps the wrong skill. For each labelling the same network is trained from the same start in the same
order, and judged on held-out trajectories with their labels from the same source.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from freerein.learning import weights
from freerein.learning.encoders import ENCODERS, CameraEncoders, FrameTensors
from freerein.learning.optimiser import cosine_lr
from freerein.learning.trajectories import Trajectories
from freerein_segmentation.model import ModelSpec
from freerein_segmentation.model.action_model import ActionModel

_BATCH, _LR, _WARMUP = 256, 2e-3, 30
_MAX_GRAD_NORM = 1.0
_NORMALISATION_FRAMES = 2000
_FRAMES_AT_ONCE = 1024

TrajectoryLabels = Sequence[npt.NDArray[np.int64]]
"""int64 (T,) per trajectory: a skill, or -1 for none."""


class _Policy(nn.Module):
    """An encoder and an action model over it."""

    def __init__(self, spec: ModelSpec) -> None:
        super().__init__()
        self.spec = spec
        self.image = CameraEncoders(ENCODERS[spec.encoder], spec.cameras, features=spec.features)
        # What was rejected is a skill of its own, so that nothing is gained by rejecting what is hard to predict.
        self.actions = ActionModel(features=self.image.size, skills=len(spec.skills) + 1, action=spec.action)

    def forward(self, frames: FrameTensors, actions: Tensor, skills: Tensor) -> Tensor:
        """Returns the negative log-likelihood of actions (N, A) given skills int64 (N,), float (N,)."""
        log_likelihood: Tensor = self.actions(self.image(frames), self.spec.scaled(actions))  # (N, K + 1)
        return -log_likelihood.gather(1, skills[:, None])[:, 0]


def held_out_action_loss(
    training: Trajectories,
    training_labels: TrajectoryLabels,
    validation: Trajectories,
    validation_labels: TrajectoryLabels,
    *,
    spec: ModelSpec,
    steps: int,
    seed: int,
    device: torch.device,
) -> float:
    """Returns the mean negative log-likelihood per timestep of held-out actions, given frame and label, in nats.

    Actions are standardised by those of `training`, or discrete. Sets torch's number of threads to one, on which the
    result depends, for the whole process.

    Args:
        training: Trajectories that the policy is cloned from.
        training_labels: Their labels.
        validation: Trajectories that it is judged on.
        validation_labels: Their labels, from the same source.
        spec: Cameras, actions, skills and encoder, the same for all sources that are compared.
        steps: Optimiser steps.
        seed: Seed of the initial weights and the order of timesteps.
        device: Where it is trained.
    """
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    policy = _Policy(spec)
    weights.initialise(policy, generator=generator)
    seen = training.sample_frames(_NORMALISATION_FRAMES)
    policy.image.fit_normalisation(seen, generator=generator)
    policy.to(device)
    data, held_out = _Timesteps(training, training_labels, spec), _Timesteps(validation, validation_labels, spec)
    if not spec.action.choices:
        actions = [training.actions[item] for item in range(len(training))]
        policy.actions.standardise("action", spec.scaled(torch.from_numpy(np.concatenate(actions))))
    optimiser = torch.optim.Adam(policy.parameters(), _LR, fused=True)
    for step in range(steps):
        optimiser.param_groups[0]["lr"] = cosine_lr(_LR, step, warmup_steps=_WARMUP, steps=steps)
        optimiser.zero_grad()
        rows = torch.randint(data.count, (_BATCH,), generator=generator)
        policy(*data.at(rows.numpy(), device)).mean().backward()
        nn.utils.clip_grad_norm_(policy.parameters(), _MAX_GRAD_NORM)
        optimiser.step()
    with torch.no_grad():
        parts = np.array_split(np.arange(held_out.count), -(-held_out.count // _FRAMES_AT_ONCE))
        return torch.cat([policy(*held_out.at(part, device)) for part in parts]).mean().item()


class _Timesteps:
    """The timesteps of trajectories, one after the other."""

    def __init__(self, seen: Trajectories, labels: TrajectoryLabels, spec: ModelSpec) -> None:
        self._seen = seen
        self._labels = np.concatenate(list(labels))
        self._none = len(spec.skills)
        self._ends = np.cumsum(seen.lengths())
        self.count = int(self._ends[-1])

    def at(self, rows: npt.NDArray[np.int64], device: torch.device) -> tuple[dict[str, Tensor], Tensor, Tensor]:
        """Returns frames by camera, actions (N, A) and skills (N,) of some timesteps."""
        items = np.searchsorted(self._ends, rows, side="right")
        times = rows - np.concatenate([[0], self._ends])[items]
        places = list(zip(items.tolist(), times.tolist(), strict=True))
        frames = self._seen.frames_at([(item, slice(t, t + 1)) for item, t in places], device)
        actions = torch.from_numpy(np.stack([self._seen.actions[item][t] for item, t in places])).to(device)
        labels = self._labels[rows]
        return frames, actions, torch.from_numpy(np.where(labels < 0, self._none, labels)).to(device)
