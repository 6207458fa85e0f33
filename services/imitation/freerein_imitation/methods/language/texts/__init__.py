"""Encoders of goal texts: a frozen text encoder, and a reader of its tokens that is trained on text alone."""
