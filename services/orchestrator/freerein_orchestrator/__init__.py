"""The orchestrator of freerein."""
