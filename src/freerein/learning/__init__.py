"""What learned services share of training: encoders, checkpoints, the resumable loop. The only home of torch in freerein."""
