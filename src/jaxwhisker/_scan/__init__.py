"""Scans, given loads, results, events, quantities and export."""
