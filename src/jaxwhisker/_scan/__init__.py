"""Scans, deflections under given loads, results, events, quantities and export."""
