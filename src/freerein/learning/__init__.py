"""Training library shared by learned services: encoders, checkpoints, the resumable fit loop. Imports torch."""
