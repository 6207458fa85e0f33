"""The learning rate over a training."""

import pytest

from freerein.learning.optimiser import cosine_lr


def test_the_learning_rate_rises_and_falls_to_zero() -> None:
    rates = [cosine_lr(2e-3, step, warmup_steps=10, steps=100) for step in range(101)]
    assert rates[0] == pytest.approx(2e-4)
    assert max(rates) == rates[9] <= 2e-3
    assert rates[-1] == 0.0
