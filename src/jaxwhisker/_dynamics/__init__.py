"""Dynamics: small vibrations about equilibria."""
