"""Any robot controller or PLC with a Modbus TCP server, by its register map."""

from bench.drivers.robot.modbus.link import ModbusLink
from bench.drivers.robot.modbus.program import ModbusProgram
from bench.drivers.robot.modbus.state import ModbusStateStream
from bench.drivers.robot.modbus.watch import ModbusSignalWatch

__all__ = ["ModbusLink", "ModbusProgram", "ModbusSignalWatch", "ModbusStateStream"]
