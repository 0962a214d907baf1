"""Continuation through events, folds and snaps."""
