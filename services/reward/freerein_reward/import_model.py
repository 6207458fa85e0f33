"""Makes a local CLIP or SigLIP the grounding model.

    python -m freerein_reward.import_model SOURCE MODELS --sha256 HEX

SOURCE is a folder with model.safetensors: OpenAI's layout of a CLIP ResNet, or a model as transformers saves it. It is
published as MODELS/grounding/<version>/, where MODELS is the service's models/reward, and is the active version then.
"""

import argparse
import json
import shutil
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from freerein.atomic_files import write_atomic
from freerein.errors import InvalidInput, ServiceError
from freerein.learning import tensor_files
from freerein.learning.model_files import choose_device
from freerein.model_store import ModelStore
from freerein.types.common import ModelRef
from freerein_reward import command_line
from freerein_reward.model import GROUNDING, LAYOUTS, REFERENCES, ImportedGrounding
from freerein_reward.model.imported_grounding import KNOWN_PHRASES
from freerein_reward.model.vision_language import KEYPOINTS
from freerein_reward.model.vision_language.openai_clip import MERGES
from freerein_reward.model.vision_language.source_folder import WEIGHTS, check_folder, weights_sha256
from freerein_reward.model.vision_language.transformers_models import CONFIG, PREPROCESSOR, TOKENIZER
from freerein_reward.training.import_calibration import calibrate
from freerein_reward.training.synthetic_objects import VOCABULARY

_LEAST_ACCURACY = 0.5
_FILES = {"openai": (WEIGHTS, *MERGES), "transformers": (WEIGHTS, CONFIG, TOKENIZER, PREPROCESSOR)}
_LIMITS = (
    "Trained elsewhere, on images and texts of the web whose biases it has. Calibrated on drawings of single objects: "
    "phrases that name no colour or shape of theirs are not judged, and count as known."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Publishes a local model as the grounding model; returns the process's exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m freerein_reward.import_model", description="Make a local CLIP or SigLIP the grounding model."
    )
    parser.add_argument("source", type=Path, help=f"folder with {WEIGHTS}, of a CLIP ResNet or saved by transformers")
    parser.add_argument("models", type=Path, help="folder of the service's models, such as data/models/reward")
    parser.add_argument("--sha256", required=True, help=f"SHA-256 of {WEIGHTS}, from whom you trust")
    parser.add_argument("--place", choices=[*KEYPOINTS], default="centroid", help="how heat becomes a keypoint")
    parser.add_argument("--images", type=int, default=REFERENCES, help="images to calibrate on")
    parser.add_argument("--seed", type=int, default=0, help="seed of these images")
    parser.add_argument("--device", type=command_line.device, default="cpu", help="auto, cpu or cuda:N")
    options = parser.parse_args(arguments)
    if options.images < 64:
        parser.error(f"--images must be at least 64; got {options.images}.")
    try:
        ref, card = import_model(**vars(options))
    except ServiceError as error:
        sys.stderr.write(f"{error.detail} {error.hint}\n")
        return 1
    except OSError as error:
        sys.stderr.write(f"{command_line.file_problem(error)}\n")
        return 1
    sys.stdout.write(f"{ref.name} {ref.version}\n{json.dumps(card['figures'])}\n")
    sys.stdout.writelines(f"Warning: {each}\n" for each in card["warnings"])
    return 0


def import_model(
    source: Path, models: Path, *, sha256: str, place: str, images: int, seed: int, device: str
) -> tuple[ModelRef, Mapping[str, Any]]:
    """Publishes the model in `source`, whose weights have a SHA-256, and makes it the active grounding model.

    Args:
        source: Folder of the model; only files of its layout are copied.
        models: Folder of a model store.
        sha256: Of the weights, in hexadecimal digits.
        place: How heat becomes a keypoint, of `KEYPOINTS`.
        images: Synthetic images to calibrate on.
        seed: Their seed.
        device: `auto`, `cpu` or `cuda:N`.

    Returns:
        The model's reference and card.

    Raises:
        InvalidInput: The folder is not what it should be, or its weights have another SHA-256. Nothing was published.
        Unimplemented: The model needs a library that is not installed.
    """
    check_folder(source)
    layout = "transformers" if (source / CONFIG).exists() else "openai"
    _check_sha256(source, sha256)
    models.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=".import-", dir=models, ignore_cleanup_errors=True) as temporary:
        folder = Path(temporary) / "model"  # the temporary one is for this user alone
        folder.mkdir()
        for name in _FILES[layout]:
            _copy(source / name, folder / name)
        _check_sha256(folder, sha256)  # of what is read from now on
        model = LAYOUTS[layout](folder, choose_device(device))
        calibration, figures = calibrate(model, images=images, seed=seed)
        grounding = ImportedGrounding(model, calibration, place=place)
        write_atomic(folder / KNOWN_PHRASES, tensor_files.dump(calibration.known_phrases.state_dict()))
        card = {
            "method": GROUNDING,
            "layout": layout,
            "place": place,
            "presence_heat": calibration.presence_heat,
            "vocabulary": list(VOCABULARY),
            "source": {"sha256": sha256.lower()},
            "config": {"images": images, "seed": seed},
            "names": list(grounding.names),
            "figures": figures,
            "supervision": "images and captions of whoever trained it; see its publication",
            "limits": _LIMITS,
            "warnings": _warnings(figures),
        }
        write_atomic(folder / "card.json", json.dumps(card, indent=2, allow_nan=False).encode() + b"\n")
        store = ModelStore(models)
        ref = store.publish(GROUNDING, folder)
        store.activate(ref)
        return ref, card


def _copy(path: Path, to: Path) -> None:
    """Copies a file if there is one."""
    try:
        if path.exists():
            shutil.copyfile(path, to)
    except OSError as error:
        raise InvalidInput(
            f"`source` must have regular files that may be read, and there must be room for copies; {path.name} could "
            f"not be copied: {error.strerror or 'it is no regular file'}.",
            field="source",
            hint="Copy the folder to where you may read it, or make room.",
        ) from None


def _check_sha256(folder: Path, expected: str) -> None:
    found = weights_sha256(folder)
    if found != expected.lower():
        raise InvalidInput(
            f"{WEIGHTS} must have the SHA-256 {expected.lower()[:64]}; it has {found}.",
            field="sha256",
            hint="Copy the file again, or give the digest that its publisher names.",
        )


def _warnings(figures: Mapping[str, float]) -> list[str]:
    accuracy = figures["colour_accuracy"]
    if accuracy >= _LEAST_ACCURACY:
        return []
    return [
        f"The model tells the colour of a single drawn object in {accuracy:.0%} of the images: phrases that name "
        "colours will be refused, or found where they are not. Use a model that was trained on more."
    ]


if __name__ == "__main__":
    raise SystemExit(main())
