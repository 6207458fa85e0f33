"""Shared by two methods or more."""
