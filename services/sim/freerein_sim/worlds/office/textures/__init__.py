"""Textures of a floor, all drawn from its seed: patterns of two colours, and pictures."""
