"""One rod from its contact to its base, by integration or by elliptic functions."""
