"""The kinds of runs, a module or package each; `kind.py` is what one consists of."""

from collections.abc import Mapping
from typing import Any

from freerein.errors import InvalidInput
from freerein.unknown_names import described
from freerein_orchestrator.kinds import collect, distill, evaluate, fit, label, ppo
from freerein_orchestrator.kinds.kind import Kind as Kind
from freerein_orchestrator.kinds.pipeline import pipeline_kind
from freerein_orchestrator.kinds.skills import skills_kind
from freerein_orchestrator.kinds.zsrm import zsrm_kind

_SINGLE: Mapping[str, Kind[Any]] = {
    "collect": collect.KIND,
    "distill": distill.KIND,
    "evaluate": evaluate.KIND,
    "fit": fit.KIND,
    "label": label.KIND,
    "ppo": ppo.KIND,
}
_PIPELINE = pipeline_kind(_SINGLE)
KINDS: Mapping[str, Kind[Any]] = {
    **_SINGLE,
    "pipeline": _PIPELINE,
    "skills": skills_kind(_PIPELINE),
    "zsrm": zsrm_kind(_PIPELINE),
}


def find_kind(name: str) -> Kind[Any]:
    """Returns a kind. Raises InvalidInput where there is none of that name."""
    if name not in KINDS:
        raise InvalidInput(
            f"`kind` must be one of {', '.join(KINDS)}; got {described(name, KINDS)}",
            field="kind",
            hint="docs/runs.md describes them.",
        )
    return KINDS[name]
