"""Demonstrations given as images, followed by a policy in a simulated task."""
