"""The methods of a service: each RPC of its `.proto`, bound to the coroutine of the core that implements it.

REST and gRPC are both made from this table. RPC `ListSkills` calls `core.list_skills` with the dataclass of its request
message and returns the dataclass of its response message. Over REST it is `/v1/list-skills`: GET for `List`, `Get` and
`Watch`, else POST. A `Watch` stream is server-sent events, a stream of file parts is the response body, and other
streams are gRPC only.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from google.protobuf.descriptor import MethodDescriptor, ServiceDescriptor

from freerein import wire
from freerein.errors import ServiceError

_READ_PREFIXES = ("List", "Get", "Watch")
_FILE_PART_FIELDS = ["data"]

RestForm = Literal["reply", "events", "file", "none"]


@dataclass(frozen=True)
class Method:
    """One RPC and its implementation.

    Attributes:
        descriptor: The RPC.
        request: Dataclass of the request.
        response: Dataclass of the response, or of each streamed response.
        call: The core's method: a coroutine function `(request) -> response`, for server streaming an async generator
            function `(request)`, for bidirectional streaming an async generator function `(requests)`, which receives
            an `InvalidMessage` in place of a message that could not be decoded.
    """

    descriptor: MethodDescriptor
    request: type[Any]
    response: type[Any]
    call: Any

    @property
    def name(self) -> str:
        """Name of the RPC, such as `ListSkills`."""
        return self.descriptor.name

    @property
    def is_stream(self) -> bool:
        """Whether it receives or sends a stream of messages."""
        return bool(self.descriptor.client_streaming or self.descriptor.server_streaming)

    @property
    def grpc_path(self) -> str:
        """The path over gRPC, such as `/freerein.api.learning.v1.ModelService/ListModels`."""
        return f"/{self.descriptor.containing_service.full_name}/{self.name}"

    @property
    def path(self) -> str:
        """The REST path, such as `/v1/list-skills`."""
        return rest_path(self.name)

    @property
    def reads(self) -> bool:
        """Whether it is read-only, and GET over REST."""
        return rest_reads(self.name)

    @property
    def rest_form(self) -> RestForm:
        """Its form over REST; `none` for gRPC only."""
        if self.descriptor.client_streaming:
            return "none"
        if not self.descriptor.server_streaming:
            return "reply"
        if self.name.startswith("Watch"):
            return "events"
        return "file" if [field.name for field in self.descriptor.output_type.fields] == _FILE_PART_FIELDS else "none"


@dataclass(frozen=True, eq=False)
class InvalidMessage:
    """A stream message that could not be decoded, and the `seq` of the numbered part that it holds, if any."""

    error: ServiceError
    seq: int | None = None


def rest_path(rpc: str) -> str:
    """Returns the REST path of an RPC, such as `/v1/list-skills`."""
    return "/v1/" + _split_words(rpc, "-")


def rest_reads(rpc: str) -> bool:
    """Returns whether an RPC is read-only, and GET over REST."""
    return rpc.startswith(_READ_PREFIXES)


def methods_of(service: ServiceDescriptor, *cores: object) -> tuple[Method, ...]:
    """Returns the methods of a service, each bound to the first core that implements it; LookupError without one."""
    return tuple(
        Method(
            descriptor=descriptor,
            request=wire.dataclass_of(descriptor.input_type),
            response=wire.dataclass_of(descriptor.output_type),
            call=_find(_split_words(descriptor.name, "_"), cores),
        )
        for descriptor in service.methods
    )


def service_names(methods: Sequence[Method]) -> tuple[str, ...]:
    """Returns the full names of the services of these methods, without duplicates."""
    return tuple(dict.fromkeys(method.descriptor.containing_service.full_name for method in methods))


def _find(name: str, cores: Sequence[object]) -> Any:
    for core in cores:
        if hasattr(core, name):
            return getattr(core, name)
    raise LookupError(f"no core has a method {name}")


def _split_words(name: str, separator: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", separator, name).lower()
