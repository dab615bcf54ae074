"""TOML to strict models: an unknown key, a wrong unit or a wrong kind is one sentence with its place."""

from bench.config.calibration import CalibrationConfig
from bench.config.load import (
    config_schema,
    load_config,
    parse_config,
    simulated_config,
    simulated_config_text,
    to_toml,
)
from bench.config.modbus import (
    Acknowledge,
    Command,
    Commands,
    CounterSignal,
    GrantSignal,
    HeartbeatIn,
    HeartbeatOut,
    Interlock,
    ModbusRobotConfig,
    PointSignal,
    ProgramNumber,
    RegisterMap,
    Signal,
    StateSignal,
    TimeSignal,
    VectorSignal,
)
from bench.config.models import (
    AnalysisConfig,
    AnchorConfig,
    AnyRobotConfig,
    CableConfig,
    Config,
    CycleConfig,
    RobotConfig,
    RunConfig,
)
from bench.config.policy import PolicyConfig
from bench.config.simulation import SimulationConfig
from bench.config.tracker import TrackerConfig

__all__ = [
    "Acknowledge",
    "AnalysisConfig",
    "AnchorConfig",
    "AnyRobotConfig",
    "CableConfig",
    "CalibrationConfig",
    "Command",
    "Commands",
    "Config",
    "CounterSignal",
    "CycleConfig",
    "GrantSignal",
    "HeartbeatIn",
    "HeartbeatOut",
    "Interlock",
    "ModbusRobotConfig",
    "PointSignal",
    "PolicyConfig",
    "ProgramNumber",
    "RegisterMap",
    "RobotConfig",
    "RunConfig",
    "Signal",
    "SimulationConfig",
    "StateSignal",
    "TimeSignal",
    "TrackerConfig",
    "VectorSignal",
    "config_schema",
    "load_config",
    "parse_config",
    "simulated_config",
    "simulated_config_text",
    "to_toml",
]
