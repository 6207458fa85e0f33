"""What learned services share of training: encoders, checkpoints, the resumable loop. Torch lives here alone."""
