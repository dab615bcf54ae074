"""Universal Robots: the state by RTDE, the program by the dashboard server."""
