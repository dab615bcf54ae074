"""Robot and tracker in one space and one time, and what the cameras see."""
