"""Calibration of a classifier with positive and unlabelled examples, where none is known to be negative."""

import math

import torch
from torch import Tensor
from torch.nn import functional

_ITERATIONS = 100
_LEAST_SCALE = 1e-6
_PENALTY = 1e-3  # of the squared parameters, which examples that are set apart would let grow without bound


def positive_unlabelled_calibration(positive: Tensor, unlabelled: Tensor, *, share: float) -> tuple[float, float]:
    """Returns gain and bias of logits, whose sigmoid is then the probability that an unlabelled example is positive.

    Where that probability is u, an example drawn from both sets by even chance is of the positive set with the odds
    u / share. The likelihood of these odds is maximised (after Elkan and Noto, "Learning classifiers from only positive
    and unlabeled data", 2008).

    Args:
        positive: Logits of positive examples, float32 (N,).
        unlabelled: Logits of unlabelled ones, float32 (M,).
        share: Share of positive ones among the unlabelled, in (0, 1].
    """
    every = torch.cat([positive, unlabelled]).double()
    centre, scale = every.mean(), every.std().clamp(min=_LEAST_SCALE)
    positive, unlabelled = ((each.double() - centre) / scale for each in (positive, unlabelled))
    parameters = torch.zeros(2, dtype=torch.float64, device=every.device, requires_grad=True)  # log gain, and bias
    optimiser = torch.optim.LBFGS([parameters], max_iter=_ITERATIONS, line_search_fn="strong_wolfe")

    def misfit() -> Tensor:
        log_gain, bias = parameters
        of_positive, of_unlabelled = (
            functional.logsigmoid(log_gain.exp() * each + bias) - math.log(share) for each in (positive, unlabelled)
        )  # log odds of the positive set
        loss = -functional.logsigmoid(of_positive).mean() - functional.logsigmoid(-of_unlabelled).mean()
        return loss + _PENALTY * parameters.square().sum()

    def closure() -> Tensor:
        optimiser.zero_grad()
        loss = misfit()
        loss.backward()  # type: ignore[no-untyped-call]
        return loss

    with torch.enable_grad():
        optimiser.step(closure)  # type: ignore[no-untyped-call]
    log_gain, bias = parameters.detach()
    gain = log_gain.exp() / scale
    return gain.item(), (bias - gain * centre).item()
