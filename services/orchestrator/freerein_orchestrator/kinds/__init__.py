"""The kinds of runs: what each can be told, and what it does."""

from collections.abc import Mapping

from freerein.types.orchestrator import RunKind
from freerein_orchestrator.kinds import collect, distill, evaluate, fit, ppo
from freerein_orchestrator.kinds.kind import Kind as Kind
from freerein_orchestrator.kinds.pipeline import Pipeline

_SIMPLE: Mapping[RunKind, Kind] = {
    "collect": collect.KIND,
    "distill": distill.KIND,
    "evaluate": evaluate.KIND,
    "fit": fit.KIND,
    "ppo": ppo.KIND,
}
KINDS: Mapping[RunKind, Kind] = {**_SIMPLE, "pipeline": Pipeline(_SIMPLE).kind}
