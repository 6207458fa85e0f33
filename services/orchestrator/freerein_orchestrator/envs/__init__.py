"""Environments, policies and rewards over the network, with recovery from services that fail."""
