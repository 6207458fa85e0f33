"""The kinds of runs: what each can be told, and what it does."""

from collections.abc import Mapping

from freerein.types.orchestrator import RunKind
from freerein_orchestrator.kinds.kind import Kind as Kind

KINDS: Mapping[RunKind, Kind] = {}
