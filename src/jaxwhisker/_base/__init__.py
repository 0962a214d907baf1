"""Argument checks, types, compilation and small linear algebra."""
