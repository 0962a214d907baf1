"""Scenes as files: reading, writing, and the schema of both, which follows from the classes that make scenes."""
