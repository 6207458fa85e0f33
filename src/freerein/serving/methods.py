"""A service's methods: each RPC of its `.proto`, joined to the coroutine of the core that answers it.

Both doors are made from this table, so that they cannot differ. The rule: RPC `ListSkills` is answered by
`core.list_skills`, takes the dataclass of its request message and returns the dataclass of its response message; over
REST it is `/v1/list-skills`, by GET for `List`, `Get` and `Watch`, else by POST. There, what a `Watch` call streams is
server-sent events, the parts of a file are the reply's body, and other streams are gRPC's alone.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from google.protobuf.descriptor import MethodDescriptor, ServiceDescriptor
from google.protobuf.message import Message

from freerein import wire
from freerein.errors import ServiceError

_READS = ("List", "Get", "Watch")
_PART = ["data"]

RestForm = Literal["reply", "events", "file", "none"]


@dataclass(frozen=True)
class Method:
    """One RPC and who answers it.

    Attributes:
        descriptor: The RPC.
        request: The dataclass taken.
        response: The dataclass returned, or yielded.
        call: The core's method: a coroutine function `(request) -> response`, for server streaming an async generator
            function `(request)`, for bidirectional streaming an async generator function `(requests)`, which gets an
            `InvalidMessage` in place of a message that is none of its requests.
    """

    descriptor: MethodDescriptor
    request: type[Any]
    response: type[Any]
    call: Any

    @property
    def name(self) -> str:
        """The RPC's name, such as `ListSkills`."""
        return self.descriptor.name

    @property
    def path(self) -> str:
        """The REST path, such as `/v1/list-skills`."""
        return "/v1/" + _words(self.name, "-")

    @property
    def reads(self) -> bool:
        """Whether it changes nothing, so that REST serves it by GET."""
        return self.name.startswith(_READS)

    @property
    def rest_form(self) -> RestForm:
        """How REST serves it."""
        if self.descriptor.client_streaming:
            return "none"
        if not self.descriptor.server_streaming:
            return "reply"
        if self.name.startswith("Watch"):
            return "events"
        return "file" if [field.name for field in self.descriptor.output_type.fields] == _PART else "none"


@dataclass(frozen=True, eq=False)
class InvalidMessage:
    """A message of a stream that could not be made a dataclass.

    Attributes:
        error: Why.
        message: What came; None where the bytes were no such message at all.
    """

    error: ServiceError
    message: Message | None = None


def methods_of(service: ServiceDescriptor, *cores: object) -> tuple[Method, ...]:
    """Returns the methods of a service, each bound to the method of that name of the first core that has it.

    Raises:
        LookupError: None has it: the proto says more than is implemented.
    """
    return tuple(
        Method(
            descriptor=descriptor,
            request=wire.dataclass_of(descriptor.input_type),
            response=wire.dataclass_of(descriptor.output_type),
            call=_find(_words(descriptor.name, "_"), cores),
        )
        for descriptor in service.methods
    )


def service_names(methods: Sequence[Method]) -> tuple[str, ...]:
    """Returns the full names of the services that methods belong to, without repeats."""
    return tuple(dict.fromkeys(method.descriptor.containing_service.full_name for method in methods))


def _find(name: str, cores: Sequence[object]) -> Any:
    for core in cores:
        if hasattr(core, name):
            return getattr(core, name)
    raise LookupError(f"no core has a method {name}")


def _words(name: str, separator: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", separator, name).lower()
