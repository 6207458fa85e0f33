"""The reward service of freerein."""
