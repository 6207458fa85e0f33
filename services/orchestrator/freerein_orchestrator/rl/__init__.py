"""Proximal policy optimisation: networks, rollouts, updates, and the training loop. Knows no network and no service."""
