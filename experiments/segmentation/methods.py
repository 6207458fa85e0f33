"""The methods of chapter 2: the dissertation's, its baselines, ours, full supervision; and what tables say of them."""

from experiments.segmentation.study import SUPERVISED, Method
from freerein.learning.checkpoints import JSON

CAUSAL, WHOLE, LOOKAHEAD = "causal", "bidirectional", "lookahead-5"
OURS = "ours"

LEARNING_RATES = (5e-4, 1.5e-3, 5e-3, 1.5e-2)
"""What every method tries, each for a quarter of its optimiser steps."""

PARTS = 30
"""Most parts that ours cuts a trajectory into; chosen in `blocks`."""

HOW_CHOSEN = """\
objective and context. Each tries the same four peak learning rates for a quarter of the steps; the lowest validation
loss, of the tags, and for `supervised` of true labels, chooses, and it chooses the weights that are evaluated. The
dissertation's method is `lse` with the causal context; it has a learning rate of 1e-4 and gives no number of steps."""

HOW_OURS = f"""\
`ours` trains with `lse_per_timestep` for half of the steps, and then itself: a copy labels trajectories within their
tags, and the network learns these labels. In training it sees each trajectory in up to {PARTS} parts, cut at random,
each part apart. Where `ours` or `lse` has several contexts, claims are of that whose labels explain held-out actions
better with the first seed: no true label chooses.

An earlier `ours` saw whole trajectories: on test sets it had 89.50 in `grid` and 90.35 in `dial`, which were looked at.
Its labels differed from those of `lse` on validation trajectories of `grid` in the last timestep of segments, which
suggested parts. In `blocks` up to 10 and up to {PARTS} were equally good, in `grid` labels of {PARTS} agreed with those
of `lse`."""

GUESSES_AND_INTERVALS = """\
`random` guesses a skill for each timestep, `random_cls` one of the trajectory's skills (the dissertation averages over
trajectories, the table over timesteps), `majority` always the trajectory's longest skill. `decoded` is after a Gaussian
filter over time and the merging of segments under 5 timesteps.

`gap closed` is (value - lse) / (supervised in the same context - lse), where that gap is at least half a point; this
`lse` is in the context that explains held-out actions better. Intervals are by bootstrap over seeds, then over
trajectories. With one seed, and for guesses, they are over trajectories only, and say nothing about other seeds."""


def objectives(*names: str, contexts: tuple[str, ...] = (CAUSAL, WHOLE)) -> tuple[Method, ...]:
    """Returns methods that are an objective of the segmentation service, by name."""
    return tuple(Method(name, contexts, {"objective": name}) for name in names)


def ours(*contexts: str) -> Method:
    """Returns our method: normalised pooling, then self-training with what skills do as evidence, both on parts."""
    settings: dict[str, JSON] = {
        "objective": "lse_per_timestep",
        "final_objective": "self_training",
        "action_evidence": 1.0,
        "parts": PARTS,
    }
    return Method(OURS, contexts or (WHOLE,), settings)


def supervised(*contexts: str) -> Method:
    """Returns full supervision, the ceiling."""
    return Method(SUPERVISED, contexts or (WHOLE,))
