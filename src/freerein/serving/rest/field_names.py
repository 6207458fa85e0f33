"""Names of request fields that there are not: what a caller probably meant."""

from collections.abc import Iterator

from google.protobuf.descriptor import Descriptor

from freerein.errors import InvalidInput
from freerein.serving.rest.schemas import STRUCT
from freerein.unknown_names import described

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


def _dotted_names(message: Descriptor, depth: int) -> Iterator[str]:
    """Yields the names of a message's fields, those of messages in it with dots; lists and maps end there."""
    for field in message.fields:
        yield field.name
        inner = field.message_type
        if depth > 1 and inner is not None and not field.is_repeated and inner.full_name != STRUCT:
            yield from (f"{field.name}.{name}" for name in _dotted_names(inner, depth - 1))
