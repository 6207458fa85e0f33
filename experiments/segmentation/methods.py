"""The methods of chapter 2: the dissertation's, its baselines, ours, full supervision."""

from dataclasses import replace

from experiments.segmentation.effects import EFFECTS
from experiments.segmentation.study import SUPERVISED, Method, context_of
from freerein.learning.checkpoints import JSON

CAUSAL, WHOLE, LOOKAHEAD = "causal", "bidirectional", "lookahead-5"
OURS, OURS_FROM_LSE, OURS_AFTER, RECIPE = "ours", "ours_from_lse", "ours_after", "recipe"

LEARNING_RATES = (5e-4, 1.5e-3, 5e-3, 1.5e-2)
"""Peak learning rates that every method tries."""

CHOSEN = "set_likelihood"
"""The method of `development` that is the recipe."""

_RECIPE: dict[str, JSON] = {"objective": "lse_per_timestep", "final_objective": CHOSEN}


def objectives(*names: str, contexts: tuple[str, ...] = (CAUSAL, WHOLE)) -> tuple[Method, ...]:
    """Returns methods that are an objective of the segmentation service, by name."""
    return tuple(Method(name, contexts, {"objective": name}) for name in names)


def repeated(seeds: int, *methods: Method) -> tuple[Method, ...]:
    """Returns methods with so many networks, where it is another number than their study's."""
    return tuple(replace(method, seeds=seeds) for method in methods)


def at_every_timestep(*names: str) -> tuple[Method, ...]:
    """Returns causal objectives whose network sees each timestep in one sequence, whatever the others' stride is."""
    return tuple(Method(f"{name}_stride-1", (CAUSAL,), {"objective": name, "stride": 1}) for name in names)


def recipe(*, seeds: int) -> tuple[Method, ...]:
    """Returns the recipe that `development` chose: normalised pooling, then the likelihood of the sets of skills.

    Beside it stand two that are given less: no actions, and black frames.
    """
    return (
        Method(RECIPE, (WHOLE,), _RECIPE, effects=EFFECTS, seeds=seeds),
        Method(f"{RECIPE}_without_actions", (WHOLE,), _RECIPE | {"use_actions": False}, seeds=1),
        Method(f"{RECIPE}_without_frames", (WHOLE,), _RECIPE, sees_frames=False, seeds=1),
    )


def recipe_augmented(context: str) -> Method:
    """Returns the recipe fitted to augmented frames, in a context."""
    return Method(f"{RECIPE}_augmented", (context,), _RECIPE | {"augmentation": 1.0}, effects=EFFECTS, seeds=1)


def ours_augmented(context: str) -> Method:
    """Returns our method fitted to augmented frames, in a context: what comes with freerein."""
    return replace(
        _self_trained(f"{OURS}_augmented", "lse_per_timestep", (context,), augmentation=1.0), effects=EFFECTS, seeds=1
    )


def lse_as_published() -> Method:
    """Returns the dissertation's method with its own learning rate and batch size."""
    return Method("lse_as_published", (CAUSAL,), {"objective": "lse", "lr": 1e-4, "batch_size": 64})


def ours(*contexts: str) -> Method:
    """Returns our method: normalised pooling, then self-training without shares, with what skills do as evidence."""
    return _self_trained(OURS, "lse_per_timestep", contexts)


def ours_from_lse(*contexts: str) -> Method:
    """Returns our method with the dissertation's pooling in the place of normalised pooling."""
    return _self_trained(OURS_FROM_LSE, "lse", contexts)


def ours_after(tag_context: str) -> Method:
    """Returns our method in the whole context, after less of it while the tags are learned."""
    return _self_trained(
        f"{OURS_AFTER}_{tag_context}", "lse_per_timestep", (WHOLE,), tag_context=context_of(tag_context)
    )


def _self_trained(name: str, objective: str, contexts: tuple[str, ...], **settings: JSON) -> Method:
    own: dict[str, JSON] = {"objective": objective, "final_objective": "self_training", "action_evidence": 1.0}
    return Method(name, contexts or (WHOLE,), own | settings)


def supervised(*contexts: str) -> Method:
    """Returns full supervision, the ceiling."""
    return Method(SUPERVISED, contexts or (WHOLE,))
