"""Studies: scans at many points of named parameters."""
