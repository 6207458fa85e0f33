"""The kinds of runs: the configuration and the work of each."""

from collections.abc import Mapping
from typing import Any

from freerein.types.orchestrator import RunKind
from freerein_orchestrator.kinds import collect, distill, evaluate, fit, label, ppo
from freerein_orchestrator.kinds.kind import Kind as Kind
from freerein_orchestrator.kinds.pipeline import pipeline_kind

_SINGLE: Mapping[RunKind, Kind[Any]] = {
    "collect": collect.KIND,
    "distill": distill.KIND,
    "evaluate": evaluate.KIND,
    "fit": fit.KIND,
    "label": label.KIND,
    "ppo": ppo.KIND,
}
KINDS: Mapping[RunKind, Kind[Any]] = {**_SINGLE, "pipeline": pipeline_kind(_SINGLE)}
