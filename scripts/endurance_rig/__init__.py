"""What ``scripts/endurance`` is made of: a laboratory with an operator, and the checks of what they leave."""
