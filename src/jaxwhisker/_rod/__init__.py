"""One rod from its contact to its base: integrated, or by elliptic functions."""
