"""Calibration from positive and unlabelled examples."""

import torch

from freerein_imitation.methods.goal_cloning.positive_unlabelled import positive_unlabelled_calibration


def test_the_probability_is_that_of_the_unlabelled_examples() -> None:
    generator = torch.Generator().manual_seed(0)
    positive = torch.randn(4000, generator=generator) + 2
    is_positive = torch.rand(8000, generator=generator) < 0.4
    unlabelled = torch.randn(8000, generator=generator) + torch.where(is_positive, 2.0, -1.0)
    gain, bias = positive_unlabelled_calibration(3 * positive + 5, 3 * unlabelled + 5, share=0.4)
    probability = (gain * (3 * unlabelled + 5) + bias).sigmoid()
    assert abs(probability.mean() - is_positive.float().mean()) < 0.05
    for least, most in ((0.0, 0.1), (0.1, 0.5), (0.5, 0.9), (0.9, 1.0)):
        kept = (probability >= least) & (probability <= most)
        assert abs(probability[kept].mean() - is_positive[kept].float().mean()) < 0.1


def test_examples_that_are_set_apart_are_told_apart() -> None:
    gain, bias = positive_unlabelled_calibration(torch.linspace(4, 5, 50), torch.linspace(-5, -4, 50), share=0.5)
    assert torch.sigmoid(torch.tensor(gain * 4 + bias)) > 0.8
    assert torch.sigmoid(torch.tensor(gain * -4 + bias)) < 0.05
