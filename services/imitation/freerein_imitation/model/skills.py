"""The skill policies of section 2.4 in one recurrent network, told which skill to execute, with an end head.

What it looks at depends on the skill: a few pointers choose, skill by skill, whose place in the frame matters, and the
differences between pointers are where things are to one another. So what is learned of one skill serves all.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from freerein.errors import InvalidInput
from freerein.learning.config import bounded
from freerein_imitation.model import action_code
from freerein_imitation.model.codebook import MOMENTS, ColourCodebook

Memory = tuple[Tensor, Tensor]
"""What an LSTM remembers: hidden state and cell, float32 (1, B, memory) each."""

_POINTERS = 8
_GAIN = 10.0  # places are in [-1, 1], and a few hundredths decide whether a gripper fits
_PRESENT = 0.05


@dataclass(frozen=True, kw_only=True)
class SkillsSpec:
    """What a network does and sees, and how large it is.

    Attributes:
        skills: What it can do.
        camera: Which camera's frames it sees.
        action_size: Numbers per action.
        action_choices: How many different actions there are when they are discrete, else 0.
        height: Of the frames, in pixels.
        width: In pixels.
        channels: 1 or 3.
        colours: Colours that it tells from one another.
        hidden: Units of its layers.
        memory: Units of its LSTM.

    Raises:
        InvalidInput: There are no skills, or 2 channels.
    """

    skills: tuple[str, ...]
    camera: str
    action_size: int = bounded(1, least=1, most=256)
    action_choices: int = bounded(0, least=0, most=4096)
    height: int = bounded(64, least=4, most=1024)
    width: int = bounded(64, least=4, most=1024)
    channels: int = bounded(3, least=1, most=3)
    colours: int = bounded(32, least=2, most=256)
    hidden: int = bounded(128, least=8, most=1024)
    memory: int = bounded(64, least=8, most=1024)

    def __post_init__(self) -> None:
        if not self.skills or self.channels == 2:
            raise InvalidInput(
                f"A policy must know at least 1 skill and see 1 or 3 channels; "
                f"got {len(self.skills)} skills and {self.channels} channels.",
                hint="Label the dataset with skills, and store frames as gray or RGB.",
            )


class SkillsNetwork(nn.Module):
    """pi(a_t | x_1..x_t, a_{t-1}, skill), and the probability that the skill ends with x_t.

    Args:
        spec: What it does and sees.
    """

    usual: Tensor
    spread: Tensor

    def __init__(self, spec: SkillsSpec) -> None:
        super().__init__()
        self.spec = spec
        self.image = ColourCodebook(height=spec.height, width=spec.width, channels=spec.channels, colours=spec.colours)
        self.pointers = nn.Linear(len(spec.skills), _POINTERS * spec.colours, bias=False)
        pairs = _POINTERS * (_POINTERS - 1) // 2
        executed = spec.action_choices or spec.action_size
        inputs = MOMENTS * (spec.colours + _POINTERS) + 2 * pairs + executed + len(spec.skills)
        self.join = nn.Linear(inputs, spec.hidden)
        self.now = nn.Linear(spec.hidden, spec.hidden)
        self.past = nn.LSTM(spec.hidden, spec.memory, batch_first=True)
        self.trunk = nn.Linear(spec.memory + spec.hidden, spec.hidden)
        self.plan = nn.Linear(spec.hidden, spec.hidden)
        self.action = nn.Linear(spec.hidden, spec.action_choices or spec.action_size)
        self.end = nn.Linear(spec.hidden, 1)
        self.register_buffer("usual", torch.zeros(spec.colours * MOMENTS))
        self.register_buffer("spread", torch.ones(spec.colours * MOMENTS))

    @torch.no_grad()
    def calibrate(self, places: Tensor, *, generator: torch.Generator) -> None:
        """Takes what is usual from training frames, and draws pointers that point to different colours.

        Args:
            places: Where each colour is in these frames, float32 (N, colours, MOMENTS).
            generator: On the CPU.
        """
        flat = places.flatten(1)
        self.usual.copy_(flat.mean(dim=0))
        self.spread.copy_(flat.std(dim=0) + 0.01)
        self.pointers.weight.normal_(generator=generator)

    def forward(
        self, places: Tensor, skill: Tensor, previous: Tensor, memory: Memory | None = None
    ) -> tuple[Tensor, Tensor, Memory]:
        """Returns what to do, whether the skill ends, and the memory after the last timestep.

        Args:
            places: Where each colour is, float32 (B, T, colours, MOMENTS): `image` of the frames.
            skill: One-hot, float32 (B, skills).
            previous: a_{t-1}, float32 (B, T, A), zeros where nothing was executed, or int64 (B, T, 1), -1 there.
            memory: Before the first timestep; None where a skill begins.

        Returns:
            Actions, float32 (B, T, A), not clipped; or the scores of each discrete one, (B, T, 1, choices). The end's
            logits, float32 (B, T). The memory.
        """
        doing = skill[:, None].expand(-1, places.shape[1], -1)  # (B, T, skills)
        joined = [self._usual(places), *self._pointed(places, doing), self._executed(previous), doing]
        now = functional.relu(self.now(functional.relu(self.join(torch.cat(joined, dim=2)))))  # (B, T, hidden)
        remembered, memory = self.past(now, memory)  # (B, T, memory)
        trunk = functional.relu(self.trunk(torch.cat([remembered, now], dim=2)))  # (B, T, hidden)
        action = self.action(functional.relu(self.plan(trunk)))  # (B, T, A or choices)
        return action[:, :, None] if self.spec.action_choices else action, self.end(trunk)[..., 0], memory

    def _usual(self, places: Tensor) -> Tensor:
        return (places.flatten(2) - self.usual) / self.spread  # (B, T, colours * MOMENTS)

    def _pointed(self, places: Tensor, doing: Tensor) -> tuple[Tensor, Tensor]:
        """Returns where the pointers point, (B, T, pointers * MOMENTS), and how far apart that is, (B, T, pairs * 2).

        A colour that is not there is not pointed at: its share enters the softmax.
        """
        scores = self.pointers(doing).unflatten(2, (_POINTERS, -1))  # (B, T, pointers, colours)
        present = (places[..., 0].clamp(min=0) + _PRESENT).log()  # (B, T, colours)
        pointed = (scores + present[:, :, None]).softmax(dim=3) @ places  # (B, T, pointers, MOMENTS)
        one, other = torch.triu_indices(_POINTERS, _POINTERS, offset=1, device=places.device)
        apart = pointed[:, :, one, 1:3] - pointed[:, :, other, 1:3]  # (B, T, pairs, 2)
        return _GAIN / 2 * pointed.flatten(2), _GAIN * apart.flatten(2)

    def _executed(self, previous: Tensor) -> Tensor:
        if self.spec.action_choices:
            return action_code.encode(previous, choices=self.spec.action_choices).flatten(2)  # (B, T, choices)
        return previous
