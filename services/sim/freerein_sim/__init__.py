"""The sim service of freerein."""
