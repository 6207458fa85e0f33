"""A soak: all five services under mixed load for long, watched for leaks, wrong answers and hung calls."""
