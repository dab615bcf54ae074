"""A robot controller with a Modbus TCP server, described by its register map: what stands where, and how it is told."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from bench.config.section import PROGRAM_FILE, Section

__all__ = [
    "Acknowledge",
    "Command",
    "Commands",
    "CounterSignal",
    "GrantSignal",
    "HeartbeatIn",
    "HeartbeatOut",
    "Interlock",
    "ModbusCycleConfig",
    "ModbusRobotConfig",
    "PointSignal",
    "ProgramNumber",
    "RegisterMap",
    "Signal",
    "StateSignal",
    "StateValues",
    "TimeSignal",
    "VectorSignal",
    "WrittenSignal",
]

Order = Literal["big", "little"]
Ints = Annotated[tuple[int, ...], Field(strict=False)]

WIDTH_BITS = {"bool": 1, "i16": 16, "u16": 16, "i32": 32, "u32": 32, "i64": 64, "f32": 32, "f64": 64}
LAST_ADDRESS = 65_535
"""Of a Modbus table, counted from 0 (Modbus application protocol 1.1b3)."""


class Signal(Section):
    """One value of the controller: where it stands and how it is written there."""

    table: Literal["coil", "discrete", "holding", "input"] = Field(description="Which of the four Modbus tables.")
    address: int = Field(ge=0, le=65_536, description="Address in the table, counted from [robot.map] base.")
    type: Literal["bool", "i16", "u16", "i32", "u32", "i64", "f32", "f64"] = Field(
        description="i and u: whole numbers with and without sign, f: floating point; the number counts bits."
    )
    bit: int | None = Field(None, ge=0, le=15, description="For a bool in a register: which bit, 0 the lowest.")
    scale: float = Field(1.0, description="The value is scale * raw + offset.")
    offset: float = Field(0.0, description="See scale.")
    word_order: Order | None = Field(None, description="Where it differs from [robot.map] word_order.")
    byte_order: Order | None = Field(None, description="Where it differs from [robot.map] byte_order.")

    @property
    def in_bits(self) -> bool:
        """Whether the table holds single bits."""
        return self.table in ("coil", "discrete")

    @property
    def width(self) -> int:
        """Addresses one value takes: registers, or one coil."""
        return 1 if self.in_bits else -(-WIDTH_BITS[self.type] // 16)

    @property
    def span(self) -> int:
        """Addresses the whole signal takes."""
        return self.width

    @model_validator(mode="after")
    def _fits_its_table(self) -> Signal:
        if self.in_bits and self.type != "bool":
            raise ValueError(f"a {self.table} is one bit: its type is 'bool', not '{self.type}'")
        if (self.bit is not None) != (self.type == "bool" and not self.in_bits):
            raise ValueError("bit = 0 to 15 belongs to a bool in a register, and only there")
        if self.scale == 0.0:
            raise ValueError("scale = 0 would make every value the same")
        return self


class WrittenSignal(Signal):
    """A value that bench writes."""

    @model_validator(mode="after")
    def _can_be_written(self) -> WrittenSignal:
        if self.table not in ("coil", "holding"):
            raise ValueError(f"bench writes it, which goes with a coil or a holding register, not with '{self.table}'")
        if self.bit is not None:
            raise ValueError("one bit of a register cannot be written without touching the others: use a coil")
        return self


class StateValues(Section):
    """Which values of the state signal mean what; several may mean the same. Any other value is 'unknown'."""

    running: Ints = Field(description="On the path.")
    stopped: Ints = Field(description="The program is not running.")
    waiting: Ints = Field((), description="The program runs and waits for the next grant.")
    paused: Ints = Field((), description="The program is held: by a pendant, a door, a light curtain.")
    fault: Ints = Field((), description="Something a person has to look at.")

    @property
    def names(self) -> dict[int, str]:
        """State by value."""
        return {value: name for name in type(self).model_fields for value in getattr(self, name)}

    @model_validator(mode="after")
    def _are_told_apart(self) -> StateValues:
        listed = [value for name in type(self).model_fields for value in getattr(self, name)]
        twice = sorted({value for value in listed if listed.count(value) > 1})
        if twice:
            raise ValueError(f"value {twice[0]} stands for two states")
        if not self.running or not self.stopped:
            raise ValueError("running and stopped need at least one value each")
        return self


class StateSignal(Signal):
    """What the program is doing."""

    mask: int | None = Field(None, ge=1, description="Bits that count, where others share the register.")
    values: StateValues = Field(description="Which values mean what.")


class CounterSignal(Signal):
    """Cycles completed, as the controller counts them."""

    restarts: bool = Field(
        True, description="False: it counts on from program to program, and bench counts from where it stood."
    )
    wrap: int | None = Field(
        None, ge=100, description="Count at which it is 0 again, as 10000 of a decimal one; left out: its type's end."
    )

    @property
    def n_counts(self) -> int:
        """How many values it has before it is 0 again."""
        return self.wrap or 1 << WIDTH_BITS[self.type]

    @model_validator(mode="after")
    def _is_a_counter(self) -> CounterSignal:
        if self.type not in ("u16", "u32", "i16", "i32") or (self.scale, self.offset) != (1.0, 0.0):
            raise ValueError("a counter is a u16, u32, i16 or i32 without scale and offset")
        n_bits = WIDTH_BITS[self.type] - (self.type[0] == "i")
        if self.wrap is not None and self.wrap > 1 << n_bits:
            raise ValueError(f"wrap = {self.wrap} is beyond the end of a {self.type}")
        return self


class TimeSignal(Signal):
    """The controller's own time; whole numbers may wrap."""

    tick_s: float = Field(0.001, gt=0, le=3600, description="Seconds for each count: the default is milliseconds.")


class VectorSignal(Signal):
    """Six values of one kind, one after the other."""

    n_values: ClassVar[int] = 6

    spacing: int | None = Field(None, ge=1, le=64, description="From one value to the next; left out: its width.")

    @property
    def step(self) -> int:
        """Addresses from one value to the next."""
        return self.spacing or self.width

    @property
    def span(self) -> int:
        return (self.n_values - 1) * self.step + self.width


class PointSignal(VectorSignal):
    """Three values of one kind, one after the other."""

    n_values: ClassVar[int] = 3


class GrantSignal(WrittenSignal):
    """Where bench writes how many cycles the program may have begun.

    With a counter that restarts: since it started. With one that counts on: up to which value of the counter.
    """


class Acknowledge(Signal):
    """What the controller shows when it has taken a command."""

    value: float = Field(1.0, description="The value that acknowledges.")


class Command(WrittenSignal):
    """Something the controller is told to do."""

    value: float = Field(1.0, description="What is written to give the command.")
    idle: float = Field(0.0, description="What is written when the command is over.")
    hold: Literal["pulse", "level"] = Field(
        "pulse", description="'pulse': value, then idle again; 'level': value stays until the opposite is wanted."
    )
    pulse_s: float = Field(0.2, gt=0, le=10, description="Length of a pulse: several scans of a slow controller.")
    ack: Acknowledge | None = Field(None, description="Left out: the state signal alone tells.")
    ack_timeout_s: float = Field(10.0, gt=0, le=600, description="Longest time until it is acknowledged and seen.")


class Commands(Section):
    """What bench may tell the controller."""

    start: Command | None = Field(None, description="Start the program, from its beginning.")
    stop: Command | None = Field(None, description="Stop it; a start that is a level is taken back too.")
    reset: Command | None = Field(
        None, description="Given before start: back to the program's beginning. Never given in a fault."
    )


class ProgramNumber(WrittenSignal):
    """Which of the controller's programs is to run."""

    value: int = Field(ge=0, description="The program's number.")
    strobe: Command | None = Field(None, description="Makes the controller take the number.")


class HeartbeatOut(WrittenSignal):
    """A sign of life of bench for the controller, written between polls."""

    period_s: float = Field(0.5, ge=0.1, le=60, description="Time from beat to beat.")
    beat: Literal["toggle", "count"] = Field("toggle", description="0, 1, 0, 1 …; or 0, 1, 2 … up to the type's end.")
    promise: str = Field(
        "", max_length=200, description="What the controller does when it stops, in words, for the recording."
    )


class HeartbeatIn(Signal):
    """A sign of life of the controller: a value that keeps changing."""

    max_age_s: float = Field(
        2.0,
        ge=0.1,
        le=600,
        description="Longest time without a change. Each value must stand for longer than one poll.",
    )
    on_loss: Literal["lost", "report"] = Field(
        "lost", description="'lost': the robot's link counts as lost; 'report': only a line in the log."
    )


class Interlock(Signal):
    """Something that must hold before the program is started, or all the time."""

    name: str = Field(min_length=1, max_length=80, description="What it is, for messages: 'guard door'.")
    must_be: float = Field(1.0, description="The value that allows the run.")
    when: Literal["start", "always"] = Field(
        "always", description="'start': looked at before the start; 'always': later it counts as a safeguard stop."
    )


class RegisterMap(Section):
    """What stands where in the controller's tables."""

    base: Literal[0, 1] = Field(0, description="How its manual counts addresses: from 0, or from 1.")
    word_order: Order = Field("big", description="Of values of several registers: 'big' has the high word first.")
    byte_order: Order = Field("big", description="Of the two bytes of a register: 'big' is what Modbus says.")
    read_gap: int = Field(
        8, ge=0, le=124, description="Unused addresses read along to save a request; 0 where the controller refuses."
    )
    read_max: int = Field(
        125, ge=4, le=125, description="Most registers of one request, and 16 times as many bits: some take less."
    )
    write_with: Literal["single", "multiple"] = Field(
        "single",
        description="'single': functions 5 and 6 for one coil or register; 'multiple': always 15 and 16.",
    )
    state: StateSignal = Field(description="What the program is doing.")
    cycle_counter: CounterSignal = Field(description="Cycles completed.")
    cycle_running: Signal | None = Field(None, description="Not zero on the path; left out: as state tells.")
    phase: Signal | None = Field(None, description="Place on the path, 0 to 1.")
    fault_code: Signal | None = Field(None, description="Each change is a line in the log.")
    speed_override: Signal | None = Field(None, description="0 to 1; scale = 0.01 for a percentage.")
    controller_time: TimeSignal | None = Field(None, description="Left out: the time of the answer.")
    joints: VectorSignal | None = Field(None, description="6 joint positions, radians.")
    joint_turns: VectorSignal | None = Field(None, description="6 whole turns, to be added to the joint positions.")
    joint_speeds: VectorSignal | None = Field(None, description="6 joint speeds, rad/s.")
    tcp_position: PointSignal | None = Field(None, description="x, y, z of the TCP in the base frame, metres.")
    tcp_rotation: PointSignal | None = Field(None, description="Its rotation vector, radians.")
    grant: GrantSignal | None = Field(None, description="Cycles that may have begun.")
    program_number: ProgramNumber | None = Field(None, description="Which program is to run.")
    command: Commands = Field(default_factory=Commands, description="What bench may tell it.")
    heartbeat_out: HeartbeatOut | None = Field(None, description="A sign of life of bench.")
    heartbeat_in: HeartbeatIn | None = Field(None, description="A sign of life of the controller.")
    interlock: tuple[Interlock, ...] = Field(
        (), strict=False, max_length=32, description="[[robot.map.interlock]], up to 32."
    )

    @model_validator(mode="after")
    def _tells_the_path(self) -> RegisterMap:
        if self.cycle_running is None and not self.state.values.waiting:
            raise ValueError("map either cycle_running, or a value of state that means waiting for the next grant")
        return self

    @model_validator(mode="after")
    def _grant_reaches_the_counter(self) -> RegisterMap:
        counter = self.cycle_counter
        if self.grant is not None and not counter.restarts and WIDTH_BITS[self.grant.type] < WIDTH_BITS[counter.type]:
            raise ValueError(f"grant as {self.grant.type} cannot follow a {counter.type} counter that counts on")
        return self

    @model_validator(mode="after")
    def _addresses_exist(self) -> RegisterMap:
        for name, signal in self.signals.items():
            if not self.base <= signal.address <= LAST_ADDRESS + self.base - signal.span + 1:
                raise ValueError(f"{name}: address {signal.address} does not exist, counted from base = {self.base}")
        return self

    @property
    def signals(self) -> dict[str, Signal]:
        """Everything mapped, read and written, by its name."""
        named = {name: getattr(self, name) for name in type(self).model_fields}
        found = {name: value for name, value in named.items() if isinstance(value, Signal)}
        for name in Commands.model_fields:
            command = getattr(self.command, name)
            if command is not None:
                found[f"command.{name}"] = command
                found |= {f"command.{name}.ack": command.ack} if command.ack else {}
        strobe = self.program_number.strobe if self.program_number else None
        if strobe is not None:
            found["program_number.strobe"] = strobe
            found |= {"program_number.strobe.ack": strobe.ack} if strobe.ack else {}
        return found | {f"interlock.{interlock.name}": interlock for interlock in self.interlock}


class ModbusCycleConfig(Section):
    """Cycles are counted by the controller, in [robot.map.cycle_counter]."""

    digital_output: ClassVar[None] = None
    digital_output_mode: ClassVar[str] = "level"
    joint_tolerance_deg: ClassVar[float] = 0.5
    start_joints_deg: ClassVar[None] = None
    """What other sources than the counter would be told."""

    source: Literal["counter"] = Field("counter", description="The program counts its cycles in a register.")
    timeout_s: float = Field(
        600.0, gt=0, le=86_400, description="Longest time for one cycle before the run gives up: 10 minutes."
    )

    @property
    def is_granted(self) -> bool:
        """Whether the program waits for a grant before each cycle: always."""
        return True


class ModbusRobotConfig(Section):
    """Any robot controller or PLC with a Modbus TCP server."""

    kind: Literal["modbus"] = Field(description="State and commands by Modbus TCP, as [robot.map] describes.")
    host: str = Field(min_length=1, description="Address of the controller.")
    port: int = Field(502, ge=1, le=65535, description="Port of its Modbus server.")
    unit_id: int = Field(1, ge=0, le=255, description="Unit (slave) number; some controllers want 0 or 255.")
    program: str = Field(
        "the program in the controller", min_length=1, max_length=200, description="What it is called, for the report."
    )
    program_file: str = Field("", max_length=1000, description=PROGRAM_FILE)
    poll_rate_hz: float = Field(
        50.0, ge=10, le=100, description="Reads a second; controllers refresh their registers 10 to 125 times."
    )
    timeout_s: float = Field(
        0.4, ge=0.05, le=5, description="Longest wait for one answer; controllers answer in 2 to 20 ms."
    )
    retries: int = Field(1, ge=0, le=1, description="How often an unanswered request is sent again.")
    silence_s: float = Field(1.0, ge=0.2, le=60, description="Time without a good answer after which the link is lost.")
    observe_only: bool = Field(False, description="True: bench reads and never writes, so it cannot drive a run.")
    cycle: ModbusCycleConfig = Field(default_factory=ModbusCycleConfig)
    map: RegisterMap = Field(description="What stands where in its tables.")

    @property
    def rate_hz(self) -> float:
        """State samples a second."""
        return self.poll_rate_hz

    @model_validator(mode="after")
    def _can_be_driven(self) -> ModbusRobotConfig:
        if self.observe_only:
            return self
        if self.map.grant is None or self.map.command.start is None:
            raise ValueError("to drive cycles map.grant and map.command.start are needed; or set observe_only = true")
        if self.map.command.stop is None and self.map.command.start.hold == "pulse":
            raise ValueError("map.command.stop is needed, as taking back a pulsed start stops nothing")
        return self
