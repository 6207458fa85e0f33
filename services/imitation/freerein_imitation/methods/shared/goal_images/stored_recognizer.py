"""A goal recognizer that was fitted before, which a policy's fit names and copies."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from freerein.errors import InvalidInput, quoted
from freerein.learning.model_files import load_model, read_card
from freerein.model_store import ModelStore
from freerein.types.common import Camera, ModelRef, check_name
from freerein_imitation.methods.shared.goal_images.recognizer import GoalRecognizerNetwork, GoalRecognizerSpec
from freerein_imitation.model.policy import ControlSpec

METHOD_NAME = "goal_recognizer"

_FIELD = "config.recognizer"
_HINT = "Name a model of the method goal_recognizer; `freerein models list imitation` lists models and their methods."


@dataclass(frozen=True, eq=False)
class StoredRecognizer:
    """A recognizer in the model store.

    Attributes:
        ref: Its name and version.
        spec: Its encoder and size.
        weights: By name, of a `GoalRecognizer`.
        threshold: The probability from which a goal counts as reached.
        card: Its card.
    """

    ref: ModelRef
    spec: GoalRecognizerSpec
    weights: Mapping[str, Tensor]
    threshold: float
    card: Mapping[str, Any]

    @property
    def spec_fields(self) -> dict[str, Any]:
        """Fields of the spec of a network that copies it."""
        return {"recognizer_encoder": self.spec.encoder, "embedding_size": self.spec.embedding_size}

    def describe(self) -> dict[str, Any]:
        """Returns what the card of a policy that has copied it says of it."""
        return {**asdict(self.ref), **{name: self.card.get(name) for name in ("data", "supervision")}}


def active_recognizer(data_dir: Path, ref: ModelRef) -> ModelRef:
    """Returns a recognizer's reference with the version that is active now, where it has none.

    Raises:
        InvalidInput: No version is active.
    """
    check_name(ref.name, field=_FIELD)
    version = ref.version or _store(data_dir).active_version(ref.name)
    if not version:
        raise InvalidInput(
            f"`recognizer` must be the name of an active model of the imitation service; got {quoted(ref.name)}.",
            field=_FIELD,
            hint=_HINT,
        )
    return ModelRef(ref.name, version)


def load_recognizer(data_dir: Path, ref: ModelRef, *, cameras: tuple[Camera, ...]) -> StoredRecognizer:
    """Returns a recognizer of some cameras; its files are read as untrusted.

    Raises:
        NotFound: There is no such version.
        FailedPrecondition: A file is missing or changed.
        InvalidInput: The model is no recognizer, or one of other cameras.
    """
    ref = active_recognizer(data_dir, ref)
    folder = _store(data_dir).folder(ref)
    card = read_card(folder)
    if card.get("method") != METHOD_NAME:
        raise InvalidInput(
            f"`recognizer` must name a model of the method {METHOD_NAME}; {ref.name} {ref.version} is of another.",
            field=_FIELD,
            hint=_HINT,
        )
    network = load_model(folder, GoalRecognizerSpec, GoalRecognizerNetwork, device="cpu")
    spec = network.spec
    if spec.cameras != cameras:
        raise InvalidInput(
            f"The recognizer must see the cameras of the policy, {_shown(cameras)}; it sees {_shown(spec.cameras)}.",
            field=_FIELD,
            hint="Fit a recognizer to this dataset and these cameras, or name another.",
        )
    weights = network.recognizer.state_dict()
    return StoredRecognizer(ref, spec, weights, ControlSpec.from_card(card).reached_threshold, card)


def _store(data_dir: Path) -> ModelStore:
    return ModelStore(data_dir / "models" / "imitation")


def _shown(cameras: tuple[Camera, ...]) -> str:
    return ", ".join(f"{each.name} at {each.height} x {each.width} x {each.channels}" for each in cameras)
