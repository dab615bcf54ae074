"""How wrong the methods are: known shapes, and one motion against another."""
