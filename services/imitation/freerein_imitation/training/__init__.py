"""Training of policies, one module per method; what it samples from lies in a module beside it."""
