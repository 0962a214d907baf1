"""Continuation in the plane: events, contact laws, snaps."""
