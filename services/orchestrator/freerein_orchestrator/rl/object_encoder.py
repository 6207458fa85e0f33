"""Makes a new policy's object encoder, of a stored reward model's image encoder and a body found by random actions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from freerein.config import parse
from freerein.criteria import CRITERIA
from freerein.criterion_text import stated_criterion
from freerein.errors import InvalidInput
from freerein.goal_text import Grammar
from freerein.learning import model_files, tensor_files
from freerein.learning.actor_critic.body import Exploration
from freerein.learning.actor_critic.networks import ActorCritic, ActorCriticSpec
from freerein.learning.actor_critic.object_encoder import PHRASES_FILE, ObjectEncoderSpec
from freerein.learning.encoders.clip import ClipImageSpec
from freerein.types.common import Camera
from freerein_orchestrator.rl.config import PPOConfig
from freerein_orchestrator.rl.initial_network import random_actions
from freerein_orchestrator.rl.vec_env import VecEnv, env_actions, observation_tensor

_PREFIX = "image."
_HEAT, _HEAT_BIAS = "pool.heat.weight", "pool.heat.bias"
"""Weights that find a keypoint for each phrase."""

_EXPLORATION_STEPS, _EXPLORATION_RANGE = 8, 0.5
_HINT = "Choose a reward model that was fitted to frames of this camera, or the encoder `spatial`."


@dataclass(frozen=True, eq=False)
class RewardEncoder:
    """A reward model's image encoder, which locates the two objects of a goal.

    Attributes:
        caption: The goal, as the reward model reads it.
        spec: Sizes, and the numbers of the two phrases.
        weights: By name.
    """

    caption: str
    spec: ObjectEncoderSpec
    weights: Mapping[str, Tensor]


def load_reward_encoder(
    folder: Path, *, goal_caption: str, camera: Camera, field: str = "config.reward_model"
) -> RewardEncoder:
    """Returns the image encoder of a reward model.

    Args:
        folder: The model's; read as untrusted.
        goal_caption: The goal text as the model reads it: two of its noun phrases and a relation.
        camera: The camera of the frames, and their size.
        field: Of the configuration that names the model.

    Raises:
        InvalidInput: The model is of another camera or frame size, or names no two objects; a file is malformed.
    """
    card: Any = model_files.read_card(folder).get("spec")
    embedded = folder / PHRASES_FILE
    of_relations = () if embedded.exists() else ("hidden_size", "embedding_dim")
    try:
        phrases = [str(phrase) for phrase in card["phrases"]]
        sizes = {name: card[name] for name in ("width", "depth", *of_relations)}
        seen = (list(card["cameras"]), card["image_size"])
    except (KeyError, TypeError) as error:
        raise InvalidInput(
            f"An object encoder is of a reward model, whose card has the sizes; reading them failed: {error!r}.",
            field=field,
            hint=_HINT,
        ) from error
    if seen != ([camera.name], camera.height) or camera.height != camera.width:
        raise InvalidInput(
            f"The reward model must see {camera.name} at {camera.height} x {camera.width}, and a square; this one sees "
            f"{', '.join(seen[0])} at {seen[1]} x {seen[1]}.",
            field=field,
            hint=_HINT,
        )
    first, second = _pair(phrases, goal_caption)
    image = parse(ClipImageSpec, {"phrases": len(phrases), "at_peaks": embedded.exists(), **sizes})
    tensors = tensor_files.parse((folder / model_files.MODEL.weights).read_bytes())
    weights = {name.removeprefix(_PREFIX): each for name, each in tensors.items() if name.startswith(_PREFIX)}
    if embedded.exists():
        weights |= _heat_of(tensors, tensor_files.parse(embedded.read_bytes()), field=field)
    if _HEAT not in weights:
        raise InvalidInput(
            f"An object encoder is of a model that locates its phrases; this one lacks the weights `{_HEAT}`.",
            field=field,
            hint="Fit the reward model again, choose another one, or the encoder `spatial`.",
        )
    criterion, _ = stated_criterion(goal_caption) or (None, ())
    spec = ObjectEncoderSpec(image, first, second, pushed=criterion is CRITERIA["close_to"])
    return RewardEncoder(goal_caption, spec, weights)


def fit_object_encoder(
    network: ActorCritic,
    envs: VecEnv,
    generator: torch.Generator,
    *,
    objects: Mapping[str, Tensor],
    explorations: int,
    augmentation: float = 0.0,
    interrupt: Callable[[], None] = lambda: None,
) -> None:
    """Loads the weights of a new network's object encoder, and has it find the policy's body by random actions.

    Args:
        network: Changed.
        envs: Explored.
        generator: Draws the actions.
        objects: Weights of the encoder, by name.
        explorations: Sequences of actions in each environment.
        augmentation: Strength of that of their frames; 0 for none.
        interrupt: Called often; raises to stop.
    """
    if network.eye is None:
        raise InvalidInput("The network must have an object encoder, to be fitted; it has an image encoder.")
    network.eye.load_objects(objects)
    explored = explore(network.spec, envs, generator, count=explorations)
    network.eye.fit(explored, generator, augmentation=augmentation, interrupt=interrupt)


def explored_steps(spec: ActorCriticSpec, config: PPOConfig) -> int:
    """Returns the steps of all environments that went into fitting the object encoder of a network; 0 without one."""
    return 0 if spec.eye is None else config.explorations * _EXPLORATION_STEPS * config.num_envs


def explore(spec: ActorCriticSpec, envs: VecEnv, generator: torch.Generator, *, count: int) -> Exploration:
    """Returns `count` short sequences of small random actions in each environment, from the starts of episodes.

    Those in which an episode ended are left out.
    """
    sequences, moves = [], []
    for _ in range(count):
        frames = [observation_tensor(envs.reset(), spec, envs.num_envs)]
        actions, has_ended = [], torch.zeros(envs.num_envs, dtype=torch.bool)
        for _ in range(_EXPLORATION_STEPS):
            actions.append(_EXPLORATION_RANGE * random_actions(spec, envs.num_envs, generator))
            step = envs.step(env_actions(actions[-1]))
            frames.append(observation_tensor(step.observations, spec, envs.num_envs))
            has_ended |= torch.from_numpy(step.terminated | step.truncated)
        sequences.append(torch.stack(frames, dim=1)[~has_ended])
        moves.append(torch.stack(actions, dim=1)[~has_ended])
    envs.rewards()  # unused
    return Exploration(torch.cat(sequences), torch.cat(moves))


def _heat_of(tensors: Mapping[str, Tensor], embedded: Mapping[str, Tensor], *, field: str) -> dict[str, Tensor]:
    """Returns the weights of `PeakPool` of a model of criteria, which compares phrases with cells.

    Args:
        tensors: The model's.
        embedded: The embeddings of its phrases.
        field: Of the configuration that names it.

    Raises:
        InvalidInput: A file lacks one.
    """
    try:
        queries = tensors["locator.log_scale"].exp() * (embedded["phrases"] - tensors["locator.contrast"])  # (P, D)
        return {
            _HEAT: queries @ tensors["cells.weight"],  # (P, C)
            _HEAT_BIAS: -tensors["locator.nowhere"].expand(len(queries)),
        }
    except (KeyError, RuntimeError) as error:
        raise InvalidInput(
            f"A model of criteria has the weights of its locator, and embeddings of its phrases; got {error!r}.",
            field=field,
            hint=_HINT,
        ) from error


def _pair(phrases: Sequence[str], caption: str) -> tuple[int, int]:
    """Returns the numbers of the two phrases that a caption relates, in its order."""
    related = Grammar(phrases, phrases).read(caption).statement
    _, nouns = stated_criterion(caption) or (None, ())
    pair = nouns if related is None else (related.first, related.second)
    if len(pair) != len(("first", "second")) or not set(pair) <= set(phrases):
        raise InvalidInput(
            "The goal text must relate two objects that the reward model knows; it does not.",
            field="config.goal_text",
            hint="Relate two of its noun phrases, or choose the encoder `spatial`.",
        )
    first, second = map(phrases.index, pair)
    return first, second
