"""Mutation testing: changes the code in small ways, one at a time, and expects a test to fail each time."""
