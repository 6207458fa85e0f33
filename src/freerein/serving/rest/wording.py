"""Words of errors for callers of the REST API: paths in place of RPCs."""

import re
from collections.abc import Mapping
from functools import cache

from freerein import wire
from freerein.serving.methods import rest_path, rest_reads

_NAME = re.compile(r"`(?P<quoted>[A-Z][A-Za-z]+)`|(?<!/)\b(?P<compound>[A-Z][a-z]+(?:[A-Z][a-z]+)+)\b")


def with_paths(sentence: str) -> str:
    """Returns a sentence with the method and path of each RPC that it names, `ListTasks` being `GET /v1/list-tasks`.

    A name of one word counts in backticks only, and none within a path. Streams of messages have no path, and stay.
    """
    return _NAME.sub(lambda found: _calls().get(found["quoted"] or found["compound"], found[0]), sentence)


@cache
def _calls() -> Mapping[str, str]:
    """Returns method and path by the name of each RPC."""
    unary = (rpc.name for service in wire.services() for rpc in service.methods if not rpc.client_streaming)
    return {name: f"{'GET' if rest_reads(name) else 'POST'} {rest_path(name)}" for name in unary}
