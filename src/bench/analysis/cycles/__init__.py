"""Where each frame is in the test: in which cycle, at which phase; and what changes from cycle to cycle."""
