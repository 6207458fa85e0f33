"""Inference on the model's thread: whole trajectories, parts of them, and steps of streams."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt

from freerein.errors import OutputNotFinite, ServiceError
from freerein.serving.batcher import Batcher
from freerein.types.common import ActionSpec, Camera
from freerein_segmentation.model import Prediction

Pixels: TypeAlias = npt.NDArray[np.uint8]
Actions: TypeAlias = npt.NDArray[Any] | None


class PredictionStream(Protocol):
    """Predictions for one trajectory that arrives bit by bit; see `SegmentationStream`."""

    def push(self, frames: Pixels, actions: Actions) -> Prediction:
        """Returns the prediction of the timesteps that the next ones finish."""

    def finish(self) -> Prediction:
        """Returns the prediction of the others so far, as if the trajectory ended here; changes nothing."""


class SkillModel(Protocol):
    """A trained segmentation model, as the core uses it.

    Attributes:
        skills: The skills; labels are indices into them.
        camera: The camera whose frames it takes.
        action: The action space; None for a model without actions.
        lag: Timesteps after a timestep that its prediction depends on; None for a model of whole trajectories.
        fps: Timesteps per second of what it was trained on; 0 where unknown.
    """

    skills: tuple[str, ...]
    camera: Camera
    action: ActionSpec | None
    lag: int | None
    fps: float

    def predict(self, frames: Pixels, actions: Actions) -> Prediction:
        """Returns the prediction for frames (T, H, W, C) and actions (T, A), in bounded memory."""

    def encode(self, frames: Pixels, actions: Actions) -> Any:
        """Returns a few timesteps of a trajectory in a form that `predict_encoded` takes."""

    def predict_encoded(self, parts: Sequence[Any]) -> Prediction:
        """Returns the prediction for a trajectory in encoded parts."""

    def stream(self) -> PredictionStream:
        """Returns a stream of predictions; FailedPrecondition when `lag` is None."""


Work: TypeAlias = Callable[[], Any]
"""One item of the batcher: returns its output, or a `ServiceError` where it alone fails."""

SegmentationBatcher: TypeAlias = Batcher[Work, Any]


def run_batch(items: Sequence[Work]) -> list[Any]:
    """Returns the output of each item, or its error."""
    return [item() for item in items]


def predict(model: SkillModel, frames: Pixels, actions: Actions) -> Prediction | ServiceError:
    """Returns the prediction for a trajectory."""
    prediction = model.predict(frames, actions)
    _check_shapes(prediction, len(frames), len(model.skills))
    return _overflow(prediction) or prediction


def predict_encoded(model: SkillModel, parts: Sequence[Any]) -> Prediction | ServiceError:
    """Returns the prediction for a trajectory in encoded parts."""
    prediction = model.predict_encoded(parts)
    return _overflow(prediction) or prediction


def push(stream: PredictionStream, frames: Pixels, actions: Actions) -> tuple[Prediction, Prediction] | ServiceError:
    """Returns the final prediction of some timesteps of a stream, and the provisional one of those after them.

    It changes the stream, so its batch must hold nothing that could run it again.
    """
    final, provisional = stream.push(frames, actions), stream.finish()
    return _overflow(final, provisional) or (final, provisional)


def finish(stream: PredictionStream) -> Prediction | ServiceError:
    """Returns the prediction of the timesteps that are left at the end of a stream."""
    rest = stream.finish()
    return _overflow(rest) or rest


def _check_shapes(prediction: Prediction, timesteps: int, skills: int) -> None:
    if prediction.probabilities.shape != (timesteps, skills) or prediction.in_distribution.shape != (timesteps,):
        raise ValueError(f"the model returned {prediction.probabilities.shape}, expected {(timesteps, skills)}")


def _overflow(*predictions: Prediction) -> ServiceError | None:
    """Returns the error of predictions that are not finite."""
    if all(np.isfinite(each.probabilities).all() and np.isfinite(each.in_distribution).all() for each in predictions):
        return None
    return OutputNotFinite(
        "The model's output must be finite; it overflowed.",
        field="actions",
        hint="Scale actions as in the training data.",
    )
