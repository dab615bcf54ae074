"""A simulated controller with a Modbus TCP server."""

from bench.simulation.modbus.controller import ModbusController

__all__ = ["ModbusController"]
