"""Folders of models that people bring: what is read of them, and what is refused before it is.

Weights are one safetensors file. No code of a folder runs, no pickle is read, and nothing is fetched.
"""

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from freerein.errors import InvalidInput
from freerein.learning import tensor_files
from freerein.regular_files import open_regular, read_regular

WEIGHTS = "model.safetensors"
MAX_WEIGHT_BYTES = 2 * 2**30
_MAX_JSON_BYTES = 1 << 24
_PICKLES = (".bin", ".pt", ".pth", ".pkl", ".ckpt", ".pickle")
_CODE_KEYS = ("auto_map", "custom_pipelines", "trust_remote_code")
_CONVERT = "Convert the weights with safetensors.torch.save_file, where you trust them."


def check_folder(folder: Path) -> None:
    """Raises InvalidInput unless a folder has weights as one safetensors file, and asks for no code."""
    if not folder.is_dir():
        raise InvalidInput(
            f"`source` must be a folder with {WEIGHTS}; there is no folder {folder.name}.",
            field="source",
            hint="Download the model to a folder first: nothing is fetched.",
        )
    names = sorted(path.name for path in folder.iterdir())
    if code := next((name for name in names if name.endswith(".py")), None):
        raise _asks_for_code(code)
    if WEIGHTS not in names:
        pickles = [name for name in names if name.endswith(_PICKLES)]
        shards = "has them in several files" if f"{WEIGHTS}.index.json" in names else "has none"
        found = f"has the pickle {pickles[0]}, which would run code" if pickles else shards
        raise InvalidInput(f"`source` must have its weights in {WEIGHTS}; it {found}.", field="source", hint=_CONVERT)
    for name in names:
        if name.endswith("config.json"):
            _check_no_code(name, read_json(folder, name))


def read_json(folder: Path, name: str) -> dict[str, Any]:
    """Returns a JSON object of a folder; InvalidInput when it is missing or malformed."""
    try:
        document = json.loads(read_regular(folder / name, name=name, most_bytes=_MAX_JSON_BYTES))
        if not isinstance(document, dict):
            raise TypeError
    except (OSError, ValueError, RecursionError, TypeError) as error:
        raise InvalidInput(
            f"`source` must have {name}, a JSON object of at most {_MAX_JSON_BYTES >> 20} MiB; got "
            f"{type(error).__name__}.",
            field="source",
            hint="Copy all files of the model.",
        ) from None
    return document


def weights_sha256(folder: Path) -> str:
    """Returns the SHA-256 of a folder's weights. Raises InvalidInput for a file that is over the limit or no file."""
    with open_regular(folder / WEIGHTS, name=WEIGHTS) as file:
        size = os.fstat(file.fileno()).st_size
        if size > MAX_WEIGHT_BYTES:
            raise InvalidInput(
                f"{WEIGHTS} must have at most {MAX_WEIGHT_BYTES >> 30} GiB; it has {size / 2**30:.1f}.",
                field="source",
                hint="Choose a smaller model, or save its weights as float16.",
            )
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_weights(folder: Path) -> Mapping[str, Tensor]:
    """Returns the weights of a folder; raises as `weights_sha256` and `tensor_files.parse`."""
    path = folder / WEIGHTS
    return tensor_files.parse(read_regular(path, name=WEIGHTS, most_bytes=MAX_WEIGHT_BYTES))


def _check_no_code(name: str, document: Mapping[str, Any]) -> None:
    if any(document.get(key) for key in _CODE_KEYS):
        raise _asks_for_code(name)


def _asks_for_code(name: str) -> InvalidInput:
    return InvalidInput(
        f"`source` must need no code of its own; {name} asks for some.",
        field="source",
        hint="Choose a CLIP or SigLIP model that transformers knows by itself, and leave .py files out.",
    )
