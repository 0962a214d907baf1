"""Foundations: argument checks, types, compilation, small linear algebra."""
