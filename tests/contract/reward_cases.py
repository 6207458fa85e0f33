"""The reward service in the contract suite: models that say what they are told to, and requests to them."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from freerein import images
from freerein.goal_text import Grammar
from freerein.serving.health import Health
from freerein.serving.lifecycle import Service
from freerein.serving.limits import Limits
from freerein.serving.metrics import Metrics
from freerein.types.common import Image, ModelRef
from freerein.types.reward import DescribeRequest, EmbedGoalRequest, GroundRequest, RewardRequest
from freerein_reward.model import ImageEmbeddings

LESS, MORE = "less", "more"  # texts that fit a frame less and more, the brighter it is


class _MeanPixel:
    def preprocess(self, image: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        return np.full((2, 2, 3), image.mean(), np.uint8)


class Bright(_MeanPixel):
    """A reward model of one camera: a text that begins with `more` fits bright frames. It fails where told to."""

    cameras = ("top",)
    aspects: ClassVar[dict[str, float]] = {}
    grammar = Grammar((LESS, MORE), ("on", "raise", "nan"))

    def embed_images(self, views: Mapping[str, npt.NDArray[np.uint8]]) -> ImageEmbeddings:
        brightness = views["top"].mean(axis=(1, 2, 3)) / 255
        angles = brightness * (math.pi / 2)
        vectors = np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)
        return ImageEmbeddings(vectors, brightness.astype(np.float32))

    def similarities(self, images: npt.NDArray[np.float32], texts: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return (images @ texts.T).clip(-1, 1)

    def in_distribution(
        self, distances: npt.NDArray[np.float32], _similarities: npt.NDArray[np.float32]
    ) -> npt.NDArray[np.float32]:
        return 1 - distances

    def embed_texts(self, texts: Sequence[str]) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
        if "raise" in texts:
            raise ZeroDivisionError
        vectors = np.array([(0, 1) if text.startswith(MORE) else (1, 0) for text in texts], np.float32)
        return vectors * np.float32("nan" if "nan" in texts else 1), np.array([len(text) > 100 for text in texts])


class Corner(_MeanPixel):
    """A grounding model: the n-th phrase is n eighths from the upper left corner; it does not know the phrase `no`."""

    grammar = Grammar((), ("red", "block", "b", "no", "raise", "nan"))

    def locate(self, images: npt.NDArray[np.uint8], phrases: Sequence[str]) -> Any:
        if "raise" in phrases:
            raise ZeroDivisionError
        shape = (len(images), len(phrases))
        places = np.broadcast_to(np.arange(len(phrases)) / 8, shape)
        heatmaps = np.full((*shape, 4, 4), np.nan if "nan" in phrases else 0.5, np.float32)
        presence = np.broadcast_to([float(phrase != "no") for phrase in phrases], shape)
        return SimpleNamespace(heatmaps=heatmaps, x=places, y=places, presence=presence, known=presence[0])


def build(data_dir: Path, health: Health, publish: Callable[..., Any]) -> Service:
    """Returns the service around both models; `publish` puts a folder into a store, under a name."""
    from freerein_reward.__main__ import build
    from freerein_reward.settings import RewardSettings

    for name in ("", "grounding"):
        publish(data_dir / "models" / "reward", name)
    settings = RewardSettings(data_dir=data_dir, shipped_dir=data_dir / "none")
    return build(settings, Limits(), Metrics(), health, load=load)


def load(folder: Path, _device: str) -> Any:
    return Corner() if folder.parent.name == "grounding" else Bright()


def png(height: int, width: int, camera: str = "") -> Image:
    return images.encode(np.zeros((height, width, 3), np.uint8), camera=camera)


Cases = list[tuple[str, Any, str]]
FRAMES = np.arange(0, 240, 20, dtype=np.uint8)[:, None, None, None].repeat(3, axis=3)


def reward(code: str = "", **fields: Any) -> tuple[str, Any, str]:
    return "Reward", RewardRequest(**{"frames": {"top": FRAMES}, "goal_text": MORE, "rivals": (LESS,), **fields}), code


def ground(code: str = "", **fields: Any) -> tuple[str, Any, str]:
    return "Ground", GroundRequest(**{"image": png(5, 7), "phrases": ("a red block", "no"), **fields}), code


def describe(code: str = "", **fields: Any) -> tuple[str, Any, str]:
    return "Describe", DescribeRequest(**{"images": (png(5, 7),), "phrases": ("a", "b", "no"), **fields}), code


def embed_goal(text: str, code: str = "", model: ModelRef = ModelRef()) -> tuple[str, Any, str]:
    return "EmbedGoal", EmbedGoalRequest(text, model), code


def cases(version: str) -> Cases:
    """Returns (method, request, code) of each case, for models of a version."""
    return [
        reward(),
        reward(mode="raw"),
        reward(model=ModelRef("default", version)),
        reward(goal_text="more on top of less", rivals=()),
        reward(frames={}, images=(png(1, 1), png(900, 2))),
        reward(frames={}, images=(png(1, 1, "top"), png(3, 3, "left"))),
        reward("invalid_input", goal_text=""),
        reward(goal_text="More is on: less!", rivals=()),
        reward(goal_text="more zeppelins"),
        reward("invalid_input", rivals=("less zeppelins",)),
        reward("invalid_input", goal_text="more on less on more", rivals=()),
        reward("invalid_input", goal_text="!?"),
        reward("invalid_input", goal_text="a" * 2_001),
        reward("invalid_input", rivals=()),
        reward("invalid_input", rivals=("",)),
        reward("invalid_input", rivals=tuple(map(str, range(65)))),
        reward("invalid_input", frames={"top": FRAMES[0]}),
        reward("invalid_input", model=ModelRef("grounding")),
        reward("unsupported_media", frames={}, images=(Image("png", 0, 0, b"GIF89a"),)),
        reward("failed_precondition", model=ModelRef("other")),
        reward("not_found", model=ModelRef("default", "0" * 12)),
        reward("model_fault", goal_text="raise"),
        reward("output_not_finite", goal_text="nan"),
        ground(),
        ground(model=ModelRef("", version)),
        ground("invalid_input", phrases=()),
        ground("invalid_input", phrases=("a", "a")),
        ground("invalid_input", phrases=tuple(map(str, range(65)))),
        ground("invalid_input", image=png(4_000, 3_999)),
        ground("invalid_input", model=ModelRef("default")),
        ground("unsupported_media", image=Image("jpeg", 0, 0, b"BM")),
        ground("model_fault", phrases=("raise",)),
        ground("output_not_finite", phrases=("nan",)),
        describe(),
        describe(epsilon=0.5, images=(png(5, 7),) * 20),
        describe("invalid_input", epsilon=0.0),
        describe("invalid_input", epsilon=0.6),
        describe("invalid_input", phrases=("a",)),
        describe("invalid_input", images=()),
        describe("invalid_input", images=(png(1, 1),) * 257),
        describe("invalid_input", model=ModelRef("default")),
        embed_goal(MORE),
        embed_goal("words " * 20),
        embed_goal("more above less."),
        embed_goal("", "invalid_input"),
        embed_goal(MORE, "invalid_input", ModelRef("grounding")),
        embed_goal("nan", "output_not_finite"),
    ]
