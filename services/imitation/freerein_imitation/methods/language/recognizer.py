"""Whether a frame shows what a text says: a head of the language policy, taught by the rewards of a learned reward."""

import torch
from torch import Tensor, nn
from torch.nn import functional

PRECISION = 0.95
"""Precision of `reached` on held-out frames, by the learned reward, that sets the threshold."""

_ITERATIONS = 100
_PENALTY = 1e-3  # of the squared parameters, which examples that are set apart would let grow without bound


class GoalTextRecognizer(nn.Module):
    """A hidden layer and a logit; calibrated, its sigmoid is the probability that the goal is reached."""

    gain: Tensor
    bias: Tensor

    def __init__(self, size: int, hidden_size: int) -> None:
        super().__init__()
        self.hidden = nn.Linear(size, hidden_size)
        self.head = nn.Linear(hidden_size, 1)
        self.register_buffer("gain", torch.ones(()))
        self.register_buffer("bias", torch.zeros(()))

    def logits(self, modulated: Tensor) -> Tensor:
        """Returns logits before calibration, float32 (B,), of modulated features, (B, D)."""
        logits: Tensor = self.head(functional.relu(self.hidden(modulated)))[:, 0]
        return logits

    def forward(self, modulated: Tensor) -> Tensor:
        """Returns the probability that the goal is reached, float32 (B,), of modulated features, (B, D)."""
        return self.probability(self.logits(modulated))

    def probability(self, logits: Tensor) -> Tensor:
        """Returns calibrated probabilities, float32 (N,), of `logits`."""
        return torch.sigmoid(self.gain * logits + self.bias)

    def calibrate(self, logits: Tensor, reached: Tensor) -> None:
        """Fits gain and bias to held-out frames: their logits, float32 (N,), and whether they show the goal, bool (N,).

        Platt, "Probabilistic outputs for support vector machines", 1999.
        """
        gain, bias = logistic_calibration(logits, reached)
        self.gain.fill_(gain)
        self.bias.fill_(bias)


def logistic_calibration(logits: Tensor, targets: Tensor) -> tuple[float, float]:
    """Returns the gain >= 0 and the bias of logits, float32 (N,), that make targets, bool (N,), most likely."""
    values, wanted = logits.double(), targets.double()
    parameters = torch.zeros(2, dtype=torch.float64, device=logits.device, requires_grad=True)  # log gain, and bias
    optimiser = torch.optim.LBFGS([parameters], max_iter=_ITERATIONS, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimiser.zero_grad()
        log_gain, bias = parameters
        misfit = functional.binary_cross_entropy_with_logits(log_gain.exp() * values + bias, wanted)
        loss = misfit + _PENALTY * parameters.square().sum()
        loss.backward()  # type: ignore[no-untyped-call]
        return loss

    with torch.enable_grad():
        optimiser.step(closure)  # type: ignore[no-untyped-call]
    log_gain, bias = parameters.detach()
    return log_gain.exp().item(), bias.item()


def least_probability(probabilities: Tensor, reached: Tensor) -> float:
    """Returns the least probability from which on `PRECISION` of the frames show the goal, at least 1/2; else 1.

    Args:
        probabilities: Of held-out frames, float32 (N,).
        reached: Whether they show the goal, bool (N,).
    """
    ordered, places = probabilities.sort(descending=True)
    precision = reached[places].double().cumsum(dim=0) / torch.arange(1, len(ordered) + 1, device=ordered.device)
    is_last = torch.cat([ordered[1:] < ordered[:-1], ordered.new_ones(1, dtype=torch.bool)])  # of equal probabilities
    enough = ordered[is_last & (precision >= PRECISION) & (ordered >= 0.5)]
    return enough.min().item() if len(enough) else 1.0
