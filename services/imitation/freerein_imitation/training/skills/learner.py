"""Skills as the resumable loop of `freerein.learning.fit` knows them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
import numpy.typing as npt
import torch

from freerein.errors import InvalidInput
from freerein.learning import weights
from freerein.learning.checkpoints import JSON
from freerein.learning.train_state import TrainState
from freerein_imitation.model.codebook import ColourCodebook
from freerein_imitation.model.skills import SkillsNetwork, SkillsSpec
from freerein_imitation.training.exploration import Exploration
from freerein_imitation.training.skills.config import SkillsConfig
from freerein_imitation.training.skills.segments import Segments, cut, hold_out, see
from freerein_imitation.training.skills.updates import State, evaluate, update

_CALIBRATION_FRAMES = 500
_PATIENCE = 1.5
_LONG = 95


@dataclass(frozen=True, eq=False)
class SkillsLearner:
    """A network to fit to some segments, and others to choose the best weights by.

    Attributes:
        config: What was chosen.
        spec: The network.
        codebook: What it sees with, calibrated.
        training: To learn from.
        validation: Held out.
        fingerprint: Of the dataset and of its labels.
        device: Where to compute.
    """

    config: SkillsConfig
    spec: SkillsSpec
    codebook: ColourCodebook
    training: Segments
    validation: Segments
    fingerprint: str
    device: torch.device

    @property
    def size(self) -> int:
        """Segments to learn from."""
        return len(self.training)

    @property
    def identity(self) -> Mapping[str, JSON]:
        """What the result depends on."""
        return {"config": asdict(self.config), "data": self.fingerprint}

    @property
    def max_steps_per_skill(self) -> int:
        """Control steps after which a skill is given up: half as many again as nearly all segments have."""
        return math.ceil(_PATIENCE * float(np.percentile(self.training.lengths(), _LONG)))

    def init(self, generator: torch.Generator) -> State:
        """Returns the state before the first update."""
        network = SkillsNetwork(self.spec)
        weights.initialise(network, generator=generator)
        network.image.load_state_dict(self.codebook.state_dict())
        network.calibrate(torch.cat(list(self.training.places)), generator=generator)
        network = network.to(self.device)
        optimiser = torch.optim.Adam(network.parameters(), self.config.lr, fused=True)
        return TrainState(network, optimiser, generator)

    def update(self, state: State, items: npt.NDArray[np.int64]) -> tuple[State, dict[str, float]]:
        """Returns the state after one update on some segments, and its metrics."""
        return update(state, self.training, items.tolist(), config=self.config)

    def evaluate(self, state: State) -> float:
        """Returns the loss on held-out segments, as it is trained on: true states have no part in it."""
        held_out = evaluate(state.network, self.validation, config=self.config)
        return (held_out.action + self.config.end_weight * held_out.end).item()


def prepare(
    config: SkillsConfig,
    demonstrations: Exploration,
    labels: Sequence[npt.NDArray[np.int64]],
    *,
    skills: tuple[str, ...],
    action_choices: int,
    fingerprint: str,
    device: torch.device,
) -> SkillsLearner:
    """Returns the learner of cloning skills; looks at every frame once.

    Args:
        config: What was chosen.
        demonstrations: Frames and executed actions.
        labels: By trajectory, the skill at each timestep, int64 (T,): predicted ones.
        skills: What labels are indices into. Those that no segment shows, of the ones to learn from, are left out.
        action_choices: How many different actions there are when they are discrete, else 0.
        fingerprint: Of the dataset and of its labels.
        device: Where to compute.

    Raises:
        InvalidInput: There are segments of fewer than 2 trajectories, or those held out show other skills.
    """
    spec = design(config, demonstrations, skills=skills, action_choices=action_choices)
    codebook = ColourCodebook(height=spec.height, width=spec.width, channels=spec.channels, colours=spec.colours)
    frames = torch.from_numpy(demonstrations.spread(_CALIBRATION_FRAMES))
    codebook.calibrate(frames, generator=torch.Generator().manual_seed(config.seed))
    places = see(codebook, demonstrations.frames)
    segments = Segments(cut(labels, shortest=config.shortest_segment), places, demonstrations.actions)
    training, validation = hold_out(segments, share=config.validation_fraction, seed=config.seed)
    shown = sorted({item.skill for item in training.items})
    training, validation = _only(shown, training), _only(shown, validation)
    if not validation.items:
        raise InvalidInput(
            "The trajectories held out must show a skill that the others show, too; they show none.",
            field="dataset",
            hint="Record more demonstrations, and label them.",
        )
    spec = replace(spec, skills=tuple(skills[skill] for skill in shown))
    return SkillsLearner(config, spec, codebook, training, validation, fingerprint, device)


def _only(skills: Sequence[int], segments: Segments) -> Segments:
    """Returns the segments of some skills, each skill now its place among these."""
    items = [replace(item, skill=skills.index(item.skill)) for item in segments.items if item.skill in skills]
    return replace(segments, items=items)


def design(
    config: SkillsConfig, demonstrations: Exploration, *, skills: tuple[str, ...], action_choices: int
) -> SkillsSpec:
    """Returns the network that fits demonstrations, of which the first trajectory shows the sizes."""
    height, width, channels = demonstrations.frames[0].shape[1:]
    return SkillsSpec(
        skills=skills,
        camera=config.camera,
        action_size=demonstrations.actions[0].shape[1],
        action_choices=action_choices,
        height=height,
        width=width,
        channels=channels,
        colours=config.colours,
        hidden=config.hidden,
        memory=config.memory,
    )
