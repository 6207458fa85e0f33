"""The imitation service of freerein."""
