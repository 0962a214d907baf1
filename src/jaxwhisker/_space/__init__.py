"""Scans in space: contact, equilibrium and path of whiskers on surfaces."""
