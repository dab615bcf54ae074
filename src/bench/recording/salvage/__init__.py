"""Making a sound file of an unfinished or damaged one."""
