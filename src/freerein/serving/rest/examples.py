"""Examples of requests, for the OpenAPI document: a fresh installation answers them as they stand.

Those of fits and runs name the one that the example of its start makes, the fit of the dataset that the run records.
`ID` must be replaced. The images show a red block to the left of a blue one.
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
from freerein.jobs.store import id_of
from freerein.serving.methods import Method
from freerein.serving.rest.schemas import STRUCT
from freerein.serving.rest.tensor_lists import reply_json
from freerein.types import imitation, learning, orchestrator, reward, segmentation, sim
from freerein.types.common import Goal, Image, ModelRef, Observation

ID = "33aff6d631d05c00849156bc87785527"
"""Id of a simulation, or a ppo run: replace it by one that you were given."""

BASE_URL = "http://SERVICE"
"""The service's address in commands, a placeholder."""

_KEY = "example"
JOB = id_of(_KEY)
"""Id of the run and of the fit that the examples start, with the idempotency key."""

_FILE, _DATASET = "frame.png", "demos"
_SHIPPED = {
    "imitation": ModelRef("default", "d83bb442a837"),
    "segmentation": ModelRef("grid", "e31aecd90a70"),
    "reward": ModelRef("default", "56711e7312df"),
}
_FIT: dict[str, dict[str, Any]] = {"reward": {"phrases": ["a red block", "a blue block"]}}
_PHRASES, _GOAL_TEXT = ("a red block", "a blue block"), "put the red block to the left of the blue block"
_NAMED = {"id": JOB, "session": ID}
"""Examples of requests that name a job or a simulation, and need no more."""
_EMPTY: tuple[object, ...] = ("", 0, [], {}, None)


@cache
def example_of(method: Method, service: str) -> Mapping[str, Any]:
    """Returns the JSON body of an example request of an RPC, without fields that have their defaults."""
    first = next(iter(method.descriptor.input_type.fields), None)
    if method.request in _REQUESTS:
        return cast(Mapping[str, Any], _without_defaults(reply_json(_REQUESTS[method.request](service))))
    return {first.name: _NAMED[first.name]} if first is not None and first.name in _NAMED else {}


def example_parts(method: Method, service: str) -> list[tuple[str, str | bytes]]:
    """Returns an example as the parts of a multipart body, or of a query: dotted names, and texts or files."""
    return list(_parts(method.descriptor.input_type, example_of(method, service)))


def curl_commands(method: Method, service: str, *, has_token: bool = False) -> dict[str, str]:
    """Returns commands that send an example, by what is said of them: as it stands, and with files for its images."""
    url, parts = f"{BASE_URL}{method.path}", example_parts(method, service)
    curl = "curl -N" if method.rest_form == "events" else "curl"
    if has_token:
        curl += ' -H "Authorization: Bearer $FREEREIN_TOKEN"'
    if method.reads:
        query = "&".join(f"{name}={text!s}" for name, text in parts)
        return {"": f"{curl} {shlex.quote(f'{url}?{query}') if query else url}"}
    named = [(name, part if isinstance(part, str) else f"@{_FILE}") for name, part in parts]
    form = " ".join([curl, url, *(f"-F {shlex.quote(f'{name}={text}')}" for name, text in named)])
    if all(isinstance(part, str) for _, part in parts):
        return {"": form if parts else f"{curl} {url} --json '{{}}'"}
    body = shlex.quote(json.dumps(example_of(method, service)))
    return {"": f"{curl} {url} --json {body}", "With files of your own:": form}


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


def _scene(height: int = 64, width: int = 64) -> Image:
    pixels = np.full((64, 64, 3), (120, 136, 148), np.uint8)
    pixels[44:] = (38, 40, 46)
    pixels[36:46, 14:24], pixels[36:46, 40:50] = (222, 24, 20), (26, 76, 236)
    return images.encode(pixels[np.arange(height) * 64 // height][:, np.arange(width) * 64 // width])


_REQUESTS: Mapping[type, Callable[[str], object]] = {
    imitation.ActRequest: lambda _: imitation.ActRequest(Observation((_scene(),)), Goal((_scene(),))),
    imitation.PublishPolicyRequest: lambda _: imitation.PublishPolicyRequest(ID, "left-of"),
    learning.StartFitRequest: lambda service: learning.StartFitRequest(
        _DATASET, _KEY, {"steps": 100, **_FIT.get(service, {})}, _KEY
    ),
    learning.ActivateModelRequest: lambda service: learning.ActivateModelRequest(
        **vars(_SHIPPED.get(service, ModelRef("default")))
    ),
    learning.DeleteModelRequest: lambda _: learning.DeleteModelRequest(_KEY, even_active=True),
    orchestrator.StartRunRequest: lambda _: orchestrator.StartRunRequest(
        "collect", {"task": "grid", "count": 10, "dataset": _DATASET}, _KEY
    ),
    orchestrator.GetArtifactRequest: lambda _: orchestrator.GetArtifactRequest(JOB, "dataset.json"),
    reward.RewardRequest: lambda _: reward.RewardRequest(_GOAL_TEXT, images=(_scene(),)),
    reward.GroundRequest: lambda _: reward.GroundRequest(_scene(), (*_PHRASES, "a dog")),
    reward.DescribeRequest: lambda _: reward.DescribeRequest((_scene(),), _PHRASES),
    reward.EmbedGoalRequest: lambda _: reward.EmbedGoalRequest(_GOAL_TEXT),
    segmentation.SegmentRequest: lambda _: segmentation.SegmentRequest(
        images=(_scene(33, 30), _scene(33, 30)), actions=np.array([[1], [2]]), model=ModelRef("grid")
    ),
    segmentation.ListSkillsRequest: lambda _: segmentation.ListSkillsRequest(ModelRef("grid")),
    sim.CreateSessionRequest: lambda _: sim.CreateSessionRequest("grid", 2, seed=7, privileged=True),
    sim.ResetRequest: lambda _: sim.ResetRequest(ID, seed=7),
    sim.StepRequest: lambda _: sim.StepRequest(ID, 1, np.array([[1], [2]])),
    sim.RestoreRequest: lambda _: sim.RestoreRequest(ID, b"what Snapshot returned"),
    sim.DrawRecipesRequest: lambda _: sim.DrawRecipesRequest("grid", count=3, seed=7),
    sim.CheckRequest: lambda _: sim.CheckRequest(ID, "completed/pick-red", np.zeros((1, 2, 12))),
}
