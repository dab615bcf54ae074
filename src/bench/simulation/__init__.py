"""The simulated bench: robots and trackers on the wire, one cable between them. `bench simulate` is its only door."""
