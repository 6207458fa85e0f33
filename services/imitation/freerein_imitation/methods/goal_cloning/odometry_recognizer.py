"""A goal recognizer that learns from own actions how far apart two images are, and whether anything else changed.

Time alone is a poor measure of distance: where a robot lingers, images far apart in time are equal. What it executed in
between is a better one. Visual odometry places each image so that differences of places are sums of actions. A goal is
near within half of an action's largest movement along each axis; axes of small movements, such as fingers', do not
count. A second head compares images of nearby places: pairs close in time show the same scene, those of different
trajectories another one, and pairs far apart in time may show that an object was moved. Its probability is fitted to
the mix of pairs far apart: they are unlabelled beside the positive ones close in time (Elkan and Noto, "Learning
classifiers from only positive and unlabeled data", 2008).
"""

from itertools import pairwise

import torch
from torch import Tensor, nn

from freerein.types.common import ActionSpec

_NEAR = 0.5  # of the largest movement of an action
_LARGE = 0.5  # of the largest movement, too
_CONTRAST = 2.0  # of the difference of features
_NO_SPREAD = 1e-3
_ODOMETRY_DEPTH, _CHANGE_DEPTH = 2, 3


class OdometryRecognizer(nn.Module):
    """Probability that an observation is at a goal, from features of both.

    Args:
        features: D, number of image features.
        hidden_size: Units of the hidden layers.
        action: The action space. Sums of discrete actions are no places: there time alone tells.

    Attributes:
        tolerance: float32 (A,), largest distance of nearby places along each axis, in actions.
        counts: bool (A,), whether a goal must be near along each axis.
        spread: float32 (A,), standard deviation of differences of places.
        gain: float32 (), factor of the logits that nothing changed.
        bias: float32 (), added to them after that.
    """

    tolerance: Tensor
    counts: Tensor
    spread: Tensor
    gain: Tensor
    bias: Tensor

    def __init__(self, *, features: int, hidden_size: int, action: ActionSpec) -> None:
        super().__init__()
        scale = torch.tensor(action.scale or (1.0,) * action.size)
        self.register_buffer("tolerance", _NEAR * scale.max() / scale)
        self.register_buffer("counts", scale >= _LARGE * scale.max())
        self.register_buffer("spread", torch.full((action.size,), _NO_SPREAD if action.choices else 1.0))
        self.register_buffer("gain", torch.ones(()))
        self.register_buffer("bias", torch.zeros(()))
        self.odometry = (
            None
            if action.choices
            else perceptron(features, action.size, hidden_size=hidden_size, depth=_ODOMETRY_DEPTH)
        )
        self.change = perceptron(2 * features, 1, hidden_size=hidden_size, depth=_CHANGE_DEPTH)

    def places(self, features: Tensor) -> Tensor:
        """Returns places, in actions from an arbitrary origin, float32 (..., A), of features (..., D)."""
        if self.odometry is None:
            return torch.zeros_like(features[..., : len(self.tolerance)])
        places: Tensor = self.odometry(features)
        return places

    def unchanged_logit(self, observation: Tensor, goal: Tensor) -> Tensor:
        """Returns logits, float32 (...), that nothing changed between observations and goals, features (..., D)."""
        mean, difference = (observation + goal) / 2, (observation - goal).abs()
        logit: Tensor = self.change(torch.cat([mean, _CONTRAST * difference], dim=-1))
        return logit[..., 0]

    def forward(self, observation: Tensor, goal: Tensor) -> Tensor:
        """Returns probabilities, float32 (...), that observations are at goals, features (..., D) each."""
        off = (self.places(observation) - self.places(goal)).abs()  # (..., A)
        upper, lower = (torch.special.ndtr((edge - off) / self.spread) for edge in (self.tolerance, -self.tolerance))
        unchanged = (self.gain * self.unchanged_logit(observation, goal) + self.bias).sigmoid()
        near = (upper - lower).where(self.counts, 1.0).prod(dim=-1)
        reached: Tensor = near * unchanged
        return reached


def perceptron(inputs: int, outputs: int, *, hidden_size: int, depth: int) -> nn.Sequential:
    """Returns `depth` hidden layers with ReLU, and a linear output layer: float32 (..., inputs) to (..., outputs)."""
    sizes = [inputs, *[hidden_size] * depth]
    hidden = [layer for each in pairwise(sizes) for layer in (nn.Linear(*each), nn.ReLU())]
    return nn.Sequential(*hidden, nn.Linear(hidden_size, outputs))
