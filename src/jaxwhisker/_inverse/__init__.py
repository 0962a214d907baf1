"""Inverse problems: identification, information, reconstruction."""
