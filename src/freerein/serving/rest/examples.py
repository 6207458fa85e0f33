"""Examples of requests, for the OpenAPI document: they are answered as they stand where they name no id.

The images show a red block to the left of a blue one.
"""

import json
import shlex
from base64 import b64decode
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import Any, cast

import numpy as np
from google.protobuf.descriptor import Descriptor

from freerein import images
from freerein.api.common.v1 import common_pb2
from freerein.ports import PORTS
from freerein.serving.methods import Method
from freerein.serving.rest.schemas import STRUCT
from freerein.serving.rest.tensor_lists import reply_json
from freerein.types import imitation, learning, orchestrator, reward, segmentation, sim
from freerein.types.common import Goal, Image, Observation

ID = "33aff6d631d05c00849156bc87785527"
"""Of a session, a fit or a run: replace it by one that you were given."""

_FILE = "frame.png"
_ANY_PORT = PORTS["orchestrator"].rest
_VERSION = "d83bb442a837"
_PHRASES, _GOAL_TEXT = ("a red block", "a blue block"), "put the red block to the left of the blue block"
_EMPTY: tuple[object, ...] = ("", 0, [], {}, None)


@cache
def example_of(method: Method) -> Mapping[str, Any]:
    """Returns the JSON body of an example request of an RPC, without fields that have their defaults."""
    make = _REQUESTS.get(method.request)
    return cast(Mapping[str, Any], _without_defaults(reply_json(make()))) if make else {}


def example_parts(method: Method) -> list[tuple[str, str | bytes]]:
    """Returns an example as the parts of a multipart body, or of a query: dotted names, and texts or files."""
    return list(_parts(method.descriptor.input_type, example_of(method)))


def curl_command(method: Method, service: str) -> str:
    """Returns a command that sends an example, with files in place of images; empty without an example."""
    parts = [(name, part if isinstance(part, str) else f"@{_FILE}") for name, part in example_parts(method)]
    if not parts:
        return ""
    url = f"localhost:{PORTS[service].rest if service in PORTS else _ANY_PORT}{method.path}"
    if method.reads:
        return f"curl '{url}?{'&'.join(f'{name}={text}' for name, text in parts)}'"
    return " ".join(["curl", url, *(f"-F {shlex.quote(f'{name}={text}')}" for name, text in parts)])


def _parts(message: Descriptor, values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str | bytes]]:
    for name, value in values.items():
        field, inner = message.fields_by_name[name], message.fields_by_name[name].message_type
        for each in value if field.is_repeated else (value,):
            if isinstance(each, str):
                yield prefix + name, each
            elif inner is common_pb2.Image.DESCRIPTOR:
                yield prefix + name, b64decode(each["data"])
            elif inner is not None and inner.full_name != STRUCT and isinstance(each, dict):
                yield from _parts(inner, each, f"{prefix}{name}.")
            else:
                yield prefix + name, json.dumps(each)


def _without_defaults(value: Any) -> Any:
    if isinstance(value, dict):
        kept = {key: _without_defaults(each) for key, each in value.items()}
        return {key: each for key, each in kept.items() if each not in _EMPTY}
    return [_without_defaults(each) for each in value] if isinstance(value, list) else value


def _scene() -> Image:
    pixels = np.full((64, 64, 3), (120, 136, 148), np.uint8)
    pixels[44:] = (38, 40, 46)
    pixels[36:46, 14:24], pixels[36:46, 40:50] = (222, 24, 20), (26, 76, 236)
    return images.encode(pixels)


_REQUESTS: Mapping[type, Callable[[], object]] = {
    imitation.ActRequest: lambda: imitation.ActRequest(Observation((_scene(),)), Goal((_scene(),))),
    imitation.PublishPolicyRequest: lambda: imitation.PublishPolicyRequest(ID, "left-of"),
    learning.StartFitRequest: lambda: learning.StartFitRequest("demos", config={"seed": 1}),
    learning.GetFitRequest: lambda: learning.GetFitRequest(ID),
    learning.GetFitMetricsRequest: lambda: learning.GetFitMetricsRequest(ID),
    learning.WatchFitRequest: lambda: learning.WatchFitRequest(ID),
    learning.CancelFitRequest: lambda: learning.CancelFitRequest(ID),
    learning.ResumeFitRequest: lambda: learning.ResumeFitRequest(ID),
    learning.ActivateModelRequest: lambda: learning.ActivateModelRequest("default", _VERSION),
    orchestrator.StartRunRequest: lambda: orchestrator.StartRunRequest(
        "collect", {"task": "grid", "count": 10, "dataset": "demos"}
    ),
    orchestrator.GetRunRequest: lambda: orchestrator.GetRunRequest(ID),
    orchestrator.WatchRunRequest: lambda: orchestrator.WatchRunRequest(ID),
    orchestrator.GetMetricsRequest: lambda: orchestrator.GetMetricsRequest(ID),
    orchestrator.CancelRunRequest: lambda: orchestrator.CancelRunRequest(ID),
    orchestrator.ResumeRunRequest: lambda: orchestrator.ResumeRunRequest(ID),
    orchestrator.ListArtifactsRequest: lambda: orchestrator.ListArtifactsRequest(ID),
    orchestrator.GetArtifactRequest: lambda: orchestrator.GetArtifactRequest(ID, "result.json"),
    reward.RewardRequest: lambda: reward.RewardRequest(_GOAL_TEXT, images=(_scene(),)),
    reward.GroundRequest: lambda: reward.GroundRequest(_scene(), (*_PHRASES, "a dog")),
    reward.DescribeRequest: lambda: reward.DescribeRequest((_scene(),), _PHRASES),
    reward.EmbedGoalRequest: lambda: reward.EmbedGoalRequest(_GOAL_TEXT),
    segmentation.SegmentRequest: lambda: segmentation.SegmentRequest(
        images=(_scene(), _scene()), actions=np.array([[0.1, -0.2], [0.5, 0.25]]), resize=True
    ),
    sim.CreateSessionRequest: lambda: sim.CreateSessionRequest("grid", 2, seed=7, privileged=True),
    sim.ResetRequest: lambda: sim.ResetRequest(ID, seed=7),
    sim.StepRequest: lambda: sim.StepRequest(ID, 1, np.array([[1], [2]])),
    sim.RenderRequest: lambda: sim.RenderRequest(ID),
    sim.SnapshotRequest: lambda: sim.SnapshotRequest(ID),
    sim.RestoreRequest: lambda: sim.RestoreRequest(ID, b"what Snapshot returned"),
    sim.DrawRecipesRequest: lambda: sim.DrawRecipesRequest("grid", count=3, seed=7),
    sim.CheckRequest: lambda: sim.CheckRequest(ID, "completed/pick-red", np.zeros((1, 2, 12))),
    sim.ExpertActionsRequest: lambda: sim.ExpertActionsRequest(ID),
    sim.CloseSessionRequest: lambda: sim.CloseSessionRequest(ID),
}
