"""The MCAP file: what stands where in it, finished or not, and its end."""
