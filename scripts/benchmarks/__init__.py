"""Parts of scripts/benchmark.py that need processes of their own."""
