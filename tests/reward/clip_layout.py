"""The names and shapes of the weights that OpenAI published of its CLIP ResNets, and folders of random ones."""

from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from torch import Tensor

SMALL: dict[str, Any] = {
    "width": 8,
    "depths": (1, 1, 1, 1),
    "cells": 2,
    "text_width": 64,
    "text_depth": 1,
    "text_length": 16,
    "tokens": 520,
    "dimension": 24,
}
RN50: dict[str, Any] = {
    "width": 64,
    "depths": (3, 4, 6, 3),
    "cells": 7,
    "text_width": 512,
    "text_depth": 12,
    "text_length": 77,
    "tokens": 49_408,
    "dimension": 1024,
}
MERGES = '"bpe#version: 0.2\nr e\nre d</w>\nb l\nbl o\nc k</w>\nblo ck</w>\n'


def published(
    *,
    width: int,
    depths: tuple[int, ...],
    cells: int,
    text_width: int,
    text_depth: int,
    text_length: int,
    tokens: int,
    dimension: int,
) -> dict[str, tuple[int, ...]]:
    """Returns the shape of each weight, in the published order of parts."""
    shapes: dict[str, tuple[int, ...]] = {"positional_embedding": (text_length, text_width), "logit_scale": ()}
    shapes["text_projection"] = (text_width, dimension)
    stem = ((width // 2, 3), (width // 2, width // 2), (width, width // 2))
    for number, (after, before) in enumerate(stem, start=1):
        shapes |= {f"visual.conv{number}.weight": (after, before, 3, 3), **norm(f"visual.bn{number}", after)}
    before = width
    for stage, depth in enumerate(depths):
        planes = width * 2**stage
        for block in range(depth):
            name = f"visual.layer{stage + 1}.{block}"
            for number, (out, size) in enumerate(((planes, 1), (planes, 3), (4 * planes, 1)), start=1):
                channels = (before, planes, planes)[number - 1]
                shapes[f"{name}.conv{number}.weight"] = (out, channels, size, size)
                shapes |= norm(f"{name}.bn{number}", out)
            if block == 0:
                shapes[f"{name}.downsample.0.weight"] = (4 * planes, before, 1, 1)
                shapes |= norm(f"{name}.downsample.1", 4 * planes)
            before = 4 * planes
    shapes["visual.attnpool.positional_embedding"] = (1 + cells**2, before)
    for part, after in (("k", before), ("q", before), ("v", before), ("c", dimension)):
        shapes |= linear(f"visual.attnpool.{part}_proj", before, after)
    for layer in range(text_depth):
        name = f"transformer.resblocks.{layer}"
        shapes[f"{name}.attn.in_proj_weight"] = (3 * text_width, text_width)
        shapes[f"{name}.attn.in_proj_bias"] = (3 * text_width,)
        shapes |= linear(f"{name}.attn.out_proj", text_width, text_width)
        shapes |= linear(f"{name}.mlp.c_fc", text_width, 4 * text_width)
        shapes |= linear(f"{name}.mlp.c_proj", 4 * text_width, text_width)
        for each in ("ln_1", "ln_2"):
            shapes |= {f"{name}.{each}.weight": (text_width,), f"{name}.{each}.bias": (text_width,)}
    shapes |= {"token_embedding.weight": (tokens, text_width)}
    return shapes | {"ln_final.weight": (text_width,), "ln_final.bias": (text_width,)}


def norm(name: str, channels: int) -> dict[str, tuple[int, ...]]:
    parts = ("weight", "bias", "running_mean", "running_var")
    return {f"{name}.{part}": (channels,) for part in parts} | {f"{name}.num_batches_tracked": ()}


def linear(name: str, before: int, after: int) -> dict[str, tuple[int, ...]]:
    return {f"{name}.weight": (after, before), f"{name}.bias": (after,)}


def random_weights() -> dict[str, Tensor]:
    """Returns weights of a small model, drawn from a seed."""
    generator = torch.Generator().manual_seed(0)
    drawn = {}
    for name, shape in sorted(published(**SMALL).items()):
        spread = torch.randn(shape, generator=generator) * 0.1
        is_positive = name.endswith(("running_var", ".weight")) and len(shape) == 1
        drawn[name] = 1 + spread.abs() if is_positive else spread * 3
        if name.endswith("num_batches_tracked"):
            drawn[name] = torch.tensor(1)
    return drawn


def write(folder: Path, weights: dict[str, Tensor]) -> Path:
    """Writes weights, and merges, as a folder to import."""
    folder.mkdir(parents=True, exist_ok=True)
    safetensors.torch.save_file(weights, folder / "model.safetensors")
    (folder / "merges.txt").write_text(MERGES)
    return folder
