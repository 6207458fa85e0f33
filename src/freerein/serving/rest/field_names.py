"""Errors of unknown names of fields and paths, with the one that the caller probably meant."""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache

from google.protobuf.descriptor import Descriptor

from freerein import wire
from freerein.errors import InvalidInput, NotFound
from freerein.serving.methods import rest_path
from freerein.serving.rest.schemas import STRUCT
from freerein.unknown_names import described, quoted_name

_DEEPEST = 3


def unknown_field(name: str, message: Descriptor, request: Descriptor) -> InvalidInput:
    """Returns the error of a name that a message of a request has no field of.

    Args:
        name: The last part of the caller's name.
        message: The message in which it stands.
        request: The whole request, where the field may be in another place.
    """
    known = [*message.fields_by_name, *_dotted_names(request, _DEEPEST)]
    return InvalidInput(
        f"The request must have only the fields of its schema; got {described(name, known)}",
        hint="Dots lead into messages: model.name. GET /openapi.json lists the fields.",
    )


def unknown_path(path: str, known: Sequence[str]) -> NotFound:
    """Returns the error of a path that a service does not have, beside one of its own that is close."""
    owner = None if path in known else _owners().get(path)
    got = f"{quoted_name(path)}, which is one of {owner}." if owner else described(path, known)
    return NotFound(
        f"The path must be one that this service has; got {got}", hint="GET /openapi.json lists them; /docs shows them."
    )


@cache
def _owners() -> Mapping[str, str]:
    """Returns which service has a path, by the path of every RPC."""
    found = {}
    for service in wire.services():
        name = service.full_name.split(".")[2]
        owner = "segmentation, imitation and reward" if name == "learning" else f"the {name} service"
        for rpc in service.methods:
            found[rest_path(rpc.name)] = f"{owner}, over gRPC alone" if rpc.client_streaming else owner
    return found


def _dotted_names(message: Descriptor, depth: int) -> Iterator[str]:
    """Yields the names of a message's fields, those of messages in it with dots; lists and maps end there."""
    for field in message.fields:
        yield field.name
        inner = field.message_type
        if depth > 1 and inner is not None and not field.is_repeated and inner.full_name != STRUCT:
            yield from (f"{field.name}.{name}" for name in _dotted_names(inner, depth - 1))
