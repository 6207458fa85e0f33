"""The comments of the `.proto` files, which descriptors do not carry: `tools/stubs` keeps them beside the stubs."""

import json
from functools import cache
from importlib.resources import files


def comment_of(full_name: str) -> str:
    """Returns the comment of a message, field, enum, value, RPC or service, on one line; empty where it has none.

    Names are like `freerein.api.common.v1.Tensor.shape`; that of an enum's value begins with the enum's.
    """
    return _comments().get(full_name, "")


@cache
def _comments() -> dict[str, str]:
    found: dict[str, str] = json.loads(files("freerein.api").joinpath("comments.json").read_bytes())
    return found
