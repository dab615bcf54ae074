"""A run on the disk: its files, their names, and what makes them durable."""
