"""Robustness: what the models of the world `blocks` are worth under its conditions, and under other words."""

from experiments.robustness.experiment import RobustnessExperiment

EXPERIMENT = RobustnessExperiment()
