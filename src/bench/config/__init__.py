"""TOML to strict models: an unknown key, a wrong unit or a wrong kind is one sentence with its place."""

from bench.config.load import (
    config_schema,
    load_config,
    parse_config,
    simulated_config,
    simulated_config_text,
    to_toml,
)
from bench.config.models import (
    AnalysisConfig,
    AnchorConfig,
    CableConfig,
    Config,
    CycleConfig,
    RobotConfig,
    RunConfig,
    SimulationConfig,
    TrackerConfig,
)
from bench.config.policy import PolicyConfig

__all__ = [
    "AnalysisConfig",
    "AnchorConfig",
    "CableConfig",
    "Config",
    "CycleConfig",
    "PolicyConfig",
    "RobotConfig",
    "RunConfig",
    "SimulationConfig",
    "TrackerConfig",
    "config_schema",
    "load_config",
    "parse_config",
    "simulated_config",
    "simulated_config_text",
    "to_toml",
]
