"""Which point of a frame is which marker of the cable."""
