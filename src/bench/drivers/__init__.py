"""Everything that talks to a device or reads another system's files."""
