"""Fits a `GoalTextReader` to random tagged texts: seconds, and no image."""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from freerein.learning import weights
from freerein_imitation.methods.language.texts.goal_text_reader import GoalTextReader, Tag
from freerein_imitation.methods.language.texts.tagged_texts import TaggedText, draw_tagged_text
from freerein_imitation.methods.language.texts.text_encoder import TextEncoder

_TEXTS, _STEPS, _TOKENS, _LR, _WEIGHT_DECAY = 1500, 500, 512, 2e-3, 0.1
_LEAST_STD = 1e-6
_TEXTS_AT_ONCE = 64


def fit_goal_text_reader(encoder: TextEncoder, *, seed: int) -> GoalTextReader:
    """Returns a reader of an encoder's tokens; the same for the same encoder and seed."""
    rng, generator = np.random.default_rng(seed), torch.Generator().manual_seed(seed)
    states, tags = _tokens(encoder, [draw_tagged_text(rng) for _ in range(_TEXTS)])
    reader = GoalTextReader(encoder.size)
    weights.initialise(reader, generator=generator)
    reader.mean.copy_(states.mean(dim=0))
    reader.std.copy_(states.std(dim=0).clamp(min=_LEAST_STD))
    optimiser = torch.optim.AdamW(reader.parameters(), lr=_LR, weight_decay=_WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, _STEPS)
    for _ in range(_STEPS):
        batch = torch.randint(len(states), (_TOKENS,), generator=generator)
        loss = functional.cross_entropy(reader(states[batch]), tags[batch])
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]  # torch does not annotate it
        optimiser.step()
        schedule.step()
    return reader.requires_grad_(False)


def _tokens(encoder: TextEncoder, texts: list[TaggedText]) -> tuple[Tensor, Tensor]:
    """Returns states, float32 (N, size), and tags, int64 (N,), of the tokens of all texts."""
    by_length: dict[int, list[tuple[Tensor, list[Tag]]]] = {}
    for text in texts:
        tokens = encoder.tokenize(" ".join(word for word, _ in text))  # (L,)
        pieces = [tag for word, tag in text for _ in encoder.tokenize(word)[1:-1]]  # without [CLS] and [SEP]
        by_length.setdefault(len(tokens), []).append((tokens, [Tag.NOTHING, *pieces, Tag.NOTHING]))
    states, tags = list[Tensor](), list[int]()
    for same_length in by_length.values():
        for start in range(0, len(same_length), _TEXTS_AT_ONCE):
            part = same_length[start : start + _TEXTS_AT_ONCE]
            states.append(encoder.token_states(torch.stack([tokens for tokens, _ in part])).flatten(0, 1))
            tags += [tag for _, each in part for tag in each]
    return torch.cat(states), torch.tensor(tags)
