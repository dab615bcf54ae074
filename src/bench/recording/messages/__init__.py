"""Records as messages: which topic, which definition, which bytes."""
