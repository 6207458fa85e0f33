"""Calls of other services that are passed on to pages: a list of names, so that nothing else gets through."""

from collections.abc import Mapping, Sequence

_FITS = (
    *("StartFit", "ListFits", "GetFit", "GetFitMetrics", "WatchFit", "CancelFit", "ResumeFit", "DeleteFit"),
    *("ListModels", "ActivateModel"),
)
CALLS: Mapping[str, Sequence[str]] = {
    "segmentation": ("Segment", "ListSkills", *_FITS),
    "imitation": ("Act", "GetSpec", *_FITS),
    "reward": ("Reward", "Ground", "Describe", *_FITS),
    "sim": (
        *("ListTasks", "CreateSession", "Reset", "Step", "Render", "CloseSession"),
        *("Check", "ExpertActions", "DrawRecipes"),
    ),
}
"""RPCs that a page may make, by service."""

ABOUT = ("/readyz", "/metrics", "/openapi.json")
"""Paths of every service that a page may read."""
