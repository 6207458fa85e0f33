"""Archives of results: what the results of an experiment have in common, such as counts of the same trials.

    <experiment>/archive-<digest>.json.xz   objects by digest: the first 12 hexadecimal digits of the sha256 of its JSON

The name of an archive is the digest of its contents, and results name objects, not archives: branches that pack their
results apart merge, and the folder has two archives until they are packed again.
"""

import hashlib
import json
import lzma
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from freerein.atomic_files import write_atomic

_PATTERN = "archive-*.json.xz"


def write(folder: Path, objects: Sequence[Mapping[str, Any]]) -> tuple[Path, list[str]]:
    """Writes objects to an archive of a folder; returns it, and their digests in order."""
    texts = [to_json(each) for each in objects]
    digests = [_digest(text) for text in texts]
    named = dict(zip(digests, texts, strict=True))
    joined = "{" + ",\n".join(f'"{digest}":{text}' for digest, text in named.items()) + "}"
    written = folder / _PATTERN.replace("*", _digest(joined))
    if not written.exists():
        write_atomic(written, compress(joined))
    return written, digests


def keep_only(archive: Path) -> None:
    """Deletes the other archives of its folder, whose objects no result names any more."""
    for path in set(archive.parent.glob(_PATTERN)) - {archive}:
        path.unlink()


def read(folder: Path, digest: str) -> Mapping[str, Any]:
    """Returns an object of an archive in a folder; not to be changed. Raises KeyError where no archive has it."""
    for path in folder.glob(_PATTERN):
        if found := _load(path).get(digest):
            return found
    raise KeyError(digest)


def to_json(value: Mapping[str, Any]) -> str:
    """Returns an object as JSON without spaces."""
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


def compress(text: str) -> bytes:
    """Returns a text by LZMA."""
    return lzma.compress(text.encode(), preset=9)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:12]


@lru_cache(maxsize=2)
def _load(path: Path) -> dict[str, Mapping[str, Any]]:
    """Returns the objects of an archive, which never changes under its name."""
    return dict(json.loads(lzma.decompress(path.read_bytes())))
