"""`bench calibrate`: from a run in which both devices see the flange to the calibration file and its table."""

from bench.report.calibration.run import CalibrationResults, calibrate_run
from bench.report.calibration.text import describe_calibration

__all__ = ["CalibrationResults", "calibrate_run", "describe_calibration"]
