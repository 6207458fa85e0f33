"""Shared by `goal_conditioned` and `inverse_model`: all but the network that chooses actions, and its loss."""
