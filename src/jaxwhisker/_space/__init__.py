"""Whiskers in space: deflections under given loads."""
