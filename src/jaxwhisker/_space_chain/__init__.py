"""Whiskers in space with several contacts each."""
