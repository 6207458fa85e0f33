"""Distillation into a language policy, from frames, executed actions and goal texts of single-task policies."""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from freerein.learning import weights
from freerein.learning.actor_critic.shared_object_encoder import SharedObjectEncoder
from freerein.learning.augmentation import resized_crops
from freerein.learning.encoders import FrameTensors
from freerein.learning.image_statistics import image_statistics
from freerein.learning.in_distribution import KNOWN_FRAMES
from freerein.learning.inputs import spec_of
from freerein.learning.learner import Items, Learner, Losses
from freerein.learning.train_state import TrainState
from freerein.learning.trajectories import Trajectories
from freerein.types.common import ActionSpec, Camera
from freerein_imitation.methods.language.config import LanguageConfig
from freerein_imitation.methods.language.goal_text_dataset import (
    GoalTextDataset,
    TimestepBatch,
    random_shift,
    split_by_text,
)
from freerein_imitation.methods.language.network import LanguageNetwork, LanguageSpec, principal_components
from freerein_imitation.methods.language.teacher_object_encoder import TeacherObjectEncoder
from freerein_imitation.methods.language.texts.goal_text_codes import encode_text
from freerein_imitation.methods.language.texts.goal_text_reader import GoalTextReader
from freerein_imitation.methods.language.texts.reader_fit import fit_goal_text_reader
from freerein_imitation.methods.language.texts.text_encoder import TextEncoder
from freerein_imitation.methods.shared import action_bins
from freerein_imitation.methods.shared.frame_features import trajectory_statistics
from freerein_imitation.methods.shared.losses import action_cross_entropy, squared_error, termination_loss

State = TrainState[LanguageNetwork]

_NORMALISATION_FRAMES = 2000
_EVALUATION_TIMESTEPS = 1024
_EVALUATION_BATCH = 128
_CALIBRATION_TIMESTEPS = 8192
_FRAMES_AT_ONCE = 256


@dataclass(frozen=True, eq=False)
class LanguageLearner(Learner[LanguageNetwork]):
    """Learner of a language policy; an item is a timestep.

    Attributes:
        text_encoder: File of the text encoder.
        reader: Reads goal texts.
        object_encoder: The teachers', frozen; None for an image encoder that is trained.
    """

    config: LanguageConfig
    spec: LanguageSpec
    training: GoalTextDataset
    validation: GoalTextDataset
    text_encoder: bytes
    reader: GoalTextReader
    fingerprint: str
    device: torch.device
    object_encoder: SharedObjectEncoder | None = None

    @classmethod
    def prepare(
        cls,
        config: LanguageConfig,
        trajectories: Trajectories,
        text_encoder: bytes,
        *,
        cameras: tuple[Camera, ...],
        action: ActionSpec,
        fingerprint: str,
        device: torch.device,
        object_encoder: SharedObjectEncoder | None = None,
    ) -> "LanguageLearner":
        """Returns the learner for trajectories with goal texts; fits a reader and reads every distinct text once.

        Raises InvalidInput where no goal text has two trajectories.
        """
        encoder, distinct = TextEncoder(text_encoder), sorted(set(trajectories.goal_texts))
        reader = fit_goal_text_reader(encoder, seed=config.seed)
        read = distinct[:1] * len(distinct) if config.conditioning == "none" else distinct
        phrases = object_encoder.spec.phrases if object_encoder else ()
        encode = partial(encode_text, reader=reader, encoder=encoder, text_code=config.text_code, phrases=phrases)
        codes = {text: encode(each).numpy() for text, each in zip(distinct, read, strict=True)}
        predicts_reached = bool(trajectories.reached) and config.reached_weight > 0
        learned = trajectories if predicts_reached else replace(trajectories, reached=())
        dataset = GoalTextDataset.of(
            learned, codes, seen=_see(object_encoder, cameras[0].name, trajectories) if object_encoder else ()
        )
        training, validation = split_by_text(dataset, fraction=config.validation_fraction, seed=config.seed)
        known = training.distinct_codes()
        components = principal_components(known[:, : reader.code_size]).shape[1]
        spec = spec_of(
            config,
            LanguageSpec,
            cameras=cameras,
            action=action,
            text_size=encoder.size,
            predicts_reached=predicts_reached,
            text_components=components,
            known_texts=len(known),
            eye=object_encoder.spec.image if object_encoder else None,
            phrases=phrases,
        )
        fingerprint = f"{fingerprint} {hashlib.sha256(text_encoder).hexdigest()}"
        if object_encoder:
            fingerprint += f" {weights.sha256(object_encoder)}"
        if predicts_reached:
            fingerprint += f" {_sha256(trajectories.reached)}"
        return cls(config, spec, training, validation, text_encoder, reader, fingerprint, device, object_encoder)

    @property
    def size(self) -> int:
        """Training timesteps."""
        return len(self.training)

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        network = LanguageNetwork(self.spec)
        weights.initialise(network, generator=generator)
        network.reader.load_state_dict(self.reader.state_dict())
        if self.object_encoder is not None and isinstance(network.encoder, TeacherObjectEncoder):
            network.encoder.shared.load_state_dict(self.object_encoder.state_dict())
        frames = self.training.trajectories.sample_frames(_NORMALISATION_FRAMES)
        network.fit_normalisation(frames, self.training.distinct_codes(), generator=generator)
        network.to(self.device)
        return TrainState.with_adam(network, self.config.lr, generator=generator, amsgrad=self.config.amsgrad)

    def loss(self, state: State, items: Items) -> Losses:
        """Returns the action loss of some timesteps, and that of what is said of reaching the goal."""
        batch = self.training.collate(items, device=self.device)
        batch = replace(batch, frames=self._augmented(batch.frames, state.generator))
        features = features_of(state.network, batch)
        modulated = state.network.modulate(features, batch.texts)
        action = action_loss(state.network, modulated, batch.actions).mean()
        if state.network.recognizer is None:
            return {"train_loss": action}
        reached = reached_loss(state.network, features, modulated, batch)
        return {"train_loss": action + self.config.reached_weight * reached, "reached_loss": reached}

    @torch.no_grad()
    def evaluate(self, state: State) -> float:
        """Returns the mean action loss over validation timesteps, the same ones each time."""
        network = state.network
        losses = [
            action_loss(network, network.modulate(features_of(network, batch), batch.texts), batch.actions)
            for batch in self._held_out(_EVALUATION_TIMESTEPS)
        ]
        return torch.cat(losses).mean().item()

    def _held_out(self, most: int) -> Iterator[TimestepBatch]:
        """Yields validation timesteps, spaced evenly, the same ones each time."""
        count = len(self.validation)
        timesteps = np.arange(0, count, math.ceil(count / most))
        for part in np.split(timesteps, range(_EVALUATION_BATCH, len(timesteps), _EVALUATION_BATCH)):
            yield self.validation.collate(part, device=self.device)

    @torch.no_grad()
    def held_out_reached(self, network: LanguageNetwork) -> tuple[Tensor, Tensor]:
        """Returns logits of held-out frames, float32 (N,), and whether they show the text's goal, bool (N,)."""
        parts = [
            reached_logits(network, features, network.modulate(features, batch.texts), batch)
            for batch in self._held_out(_CALIBRATION_TIMESTEPS)
            for features in [features_of(network, batch)]
        ]
        logits, shown, known = (torch.cat(each) for each in zip(*parts, strict=True))
        return logits[known], shown[known]

    def calibrate(self, network: LanguageNetwork) -> None:
        """Fits the network's in-distribution score, to training frames as they were seen and to held-out ones.

        What it says of reaching the goal is calibrated on held-out ones, too.
        """
        if network.recognizer is not None:
            network.recognizer.calibrate(*self.held_out_reached(network))
        generator = torch.Generator().manual_seed(self.config.seed)
        seen = self._augmented(self.training.trajectories.sample_frames(KNOWN_FRAMES), generator)
        held_out = trajectory_statistics(self.validation.trajectories).to(self.device)
        network.in_distribution.fit(
            image_statistics(seen).to(self.device),
            held_out,
            held_out.new_ones(len(held_out)),
            trajectories=len(self.validation.trajectories),
        )

    def _augmented(self, frames: FrameTensors, generator: torch.Generator) -> FrameTensors:
        """Returns frames shifted, or cropped, at random, as configured; unchanged for an object encoder."""
        if self.object_encoder is not None:
            return frames
        if self.config.max_shift:
            shift = partial(random_shift, most=self.config.max_shift, generator=generator)
            frames = {camera: shift(each) for camera, each in frames.items()}
        if self.config.resized_crops:
            frames = {camera: resized_crops(each, generator=generator) for camera, each in frames.items()}
        return frames


def features_of(network: LanguageNetwork, batch: TimestepBatch) -> Tensor:
    """Returns a network's image features of a batch, float32 (B, D)."""
    return network.encoder(batch.frames) if batch.seen is None else batch.seen


def _see(object_encoder: SharedObjectEncoder, camera: str, trajectories: Trajectories) -> list[npt.NDArray[np.float32]]:
    """Returns the object encoder's encoding of each trajectory's frames, float32 (T, D)."""
    arrays = trajectories.frames[camera]
    seen: list[npt.NDArray[np.float32]] = []
    for item in range(len(trajectories)):
        frames = torch.from_numpy(np.array(arrays[item]))
        parts = [
            object_encoder(frames[start : start + _FRAMES_AT_ONCE]) for start in range(0, len(frames), _FRAMES_AT_ONCE)
        ]
        seen.append(torch.cat(parts).numpy())
    return seen


def action_loss(network: LanguageNetwork, modulated: Tensor, actions: Tensor) -> Tensor:
    """Returns the action loss of each timestep, float (B,): squared error, or cross-entropy of discrete actions."""
    predicted, choices = network.act_on(modulated), network.spec.action.choices
    if choices:
        return action_cross_entropy(predicted, action_bins.encode(actions, choices=choices))
    return squared_error(predicted, actions)


def reached_loss(network: LanguageNetwork, features: Tensor, modulated: Tensor, batch: TimestepBatch) -> Tensor:
    """Returns the balanced logistic loss of what the network says of reaching goals, float ()."""
    logits, shown, known = reached_logits(network, features, modulated, batch)
    return termination_loss(logits, shown & known, ~shown & known)


def reached_logits(
    network: LanguageNetwork, features: Tensor, modulated: Tensor, batch: TimestepBatch
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns logits of frames conditioned on their goal texts, then on the rivals; labels; and where these are known.

    A frame that shows its goal does not show that of a text which contradicts it; of any other frame that is unknown.

    Args:
        network: With a recognizer.
        features: Of the frames, float32 (B, D).
        modulated: By their goal texts, float32 (B, D).
        batch: The frames, which a reward model has judged.

    Returns:
        float32 (2 B,), bool (2 B,), bool (2 B,).
    """
    recognizer, judged = network.recognizer, batch.judged
    if recognizer is None or judged is None:
        found = f"recognizer: {recognizer is not None}, judged: {judged is not None}"
        raise ValueError(f"The network must have a recognizer, and the frames must be judged; got {found}.")
    logits = recognizer.logits(torch.cat([modulated, network.modulate(features, judged.rivals)]))
    shown = torch.cat([judged.reached, torch.zeros_like(judged.reached)])
    known = torch.cat([torch.ones_like(judged.reached), judged.reached & judged.is_rivalled])
    return logits, shown, known


def _sha256(reached: Sequence[npt.NDArray[np.bool_]]) -> str:
    return hashlib.sha256(b"".join(np.packbits(each).tobytes() for each in reached)).hexdigest()
