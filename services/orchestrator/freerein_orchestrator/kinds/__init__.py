"""The kinds of runs: the configuration and the work of each."""

from collections.abc import Mapping
from typing import Any

from freerein.types.orchestrator import RunKind
from freerein_orchestrator.kinds import collect, distill, evaluate, fit, label, ppo
from freerein_orchestrator.kinds.kind import Kind as Kind
from freerein_orchestrator.kinds.pipeline import pipeline_kind
from freerein_orchestrator.kinds.skills import skills_kind

_SINGLE: Mapping[RunKind, Kind[Any]] = {
    "collect": collect.KIND,
    "distill": distill.KIND,
    "evaluate": evaluate.KIND,
    "fit": fit.KIND,
    "label": label.KIND,
    "ppo": ppo.KIND,
}
_PIPELINE = pipeline_kind(_SINGLE)
KINDS: Mapping[RunKind, Kind[Any]] = {**_SINGLE, "pipeline": _PIPELINE, "skills": skills_kind(_PIPELINE)}
