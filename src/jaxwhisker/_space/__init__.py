"""Whiskers in space: contact with surfaces, equilibria and their path; deflections under given loads."""
