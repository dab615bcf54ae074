"""The curve through the sorted markers, its curvature, and how sure both are."""
