"""Argument checks, types, compilation, small linear algebra."""
