"""Records into a run file, without ever waiting for the disk."""
