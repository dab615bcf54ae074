"""Registers to values and back, counters and clocks beyond their registers' end, requests that cover all signals."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from bench.drivers.robot.modbus.blocks import plan_blocks
from bench.drivers.robot.modbus.codec import decode, encode, wrap_to_type
from bench.drivers.robot.modbus.counters import CounterUnwrapper, TimeUnwrapper

ORDERS = st.sampled_from(["big", "little"])
WHOLE = {kind: (int(kind[1:]), kind[0] == "i") for kind in ("i16", "u16", "i32", "u32", "i64")}
DATATYPES = {"i16": "INT16", "u16": "UINT16", "i32": "INT32", "u32": "UINT32", "i64": "INT64"}


def bounds(kind: str) -> tuple[int, int]:
    n_bits, signed = WHOLE[kind]
    return (-(1 << (n_bits - 1)), (1 << (n_bits - 1)) - 1) if signed else (0, (1 << n_bits) - 1)


@settings(deadline=None, max_examples=150)
@given(st.sampled_from(sorted(WHOLE)), st.data(), ORDERS, ORDERS)
def test_a_whole_number_survives_its_registers(kind: str, data: st.DataObject, words: str, order: str) -> None:
    value = data.draw(st.integers(*bounds(kind)))
    registers = encode(kind, value, word_order=words, byte_order=order)
    assert all(0 <= register <= 0xFFFF for register in registers)
    assert decode(kind, registers, word_order=words, byte_order=order) == value


@settings(deadline=None, max_examples=150)
@given(st.sampled_from(["f32", "f64"]), st.floats(width=32), ORDERS, ORDERS)
def test_a_floating_point_number_survives_its_registers(kind: str, value: float, words: str, order: str) -> None:
    read = decode(kind, encode(kind, value, word_order=words, byte_order=order), word_order=words, byte_order=order)
    assert read == value or (math.isnan(read) and math.isnan(value))


@settings(deadline=None, max_examples=100)
@given(st.sampled_from(sorted(WHOLE)), st.data(), ORDERS)
def test_pymodbus_reads_the_same_value(kind: str, data: st.DataObject, words: str) -> None:
    value = data.draw(st.integers(*bounds(kind)))
    datatype = ModbusClientMixin.DATATYPE[DATATYPES[kind]]
    registers = encode(kind, value, word_order=words)
    assert ModbusClientMixin.convert_from_registers(registers, datatype, words) == value  # type: ignore[arg-type]


def test_the_usual_orders_are_the_documented_ones() -> None:
    assert encode("u32", 0x11223344) == [0x1122, 0x3344]
    assert encode("u32", 0x11223344, word_order="little") == [0x3344, 0x1122]
    assert encode("u32", 0x11223344, byte_order="little") == [0x2211, 0x4433]


def test_a_value_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="70000 does not fit a u16"):
        encode("u16", 70_000)


@settings(deadline=None, max_examples=60)
@given(st.sampled_from([16, 32]), st.integers(0, 1 << 40), st.lists(st.integers(0, 1000), max_size=60))
def test_a_counter_is_followed_over_its_end(n_bits: int, start: int, steps: list[int]) -> None:
    counter, total = CounterUnwrapper(1 << n_bits), start % (1 << n_bits)
    counter.take(total)
    for step in steps:
        total += step
        assert counter.take(total % (1 << n_bits)) == total


@settings(deadline=None, max_examples=60)
@given(st.integers(1, 30_000))
def test_a_counter_set_to_zero_is_zero(before: int) -> None:
    counter = CounterUnwrapper(1 << 16)
    counter.take(before)
    assert counter.take(0) == 0


def test_a_counter_with_sign_wraps_like_one_without() -> None:
    counter = CounterUnwrapper(1 << 16)
    assert [counter.take(raw) for raw in (32_766, 32_767, -32_768, -32_767)] == [32_766, 32_767, 32_768, 32_769]
    assert wrap_to_type("i16", 32_768) == -32_768
    assert wrap_to_type("u16", 65_537) == 1


@settings(deadline=None, max_examples=60)
@given(st.integers(0, 65_535), st.lists(st.integers(0, 3000), max_size=80))
def test_a_clock_in_milliseconds_is_followed_over_its_end(start: int, steps_ms: list[int]) -> None:
    clock, total = TimeUnwrapper(16, 0.001), start
    clock.take(start, 0.0)
    for step in steps_ms:
        total += step
        assert clock.take(total % 65_536, step * 0.001) == pytest.approx(total * 0.001)
    assert clock.n_restarts == 0


def test_a_clock_that_falls_is_a_restart() -> None:
    clock = TimeUnwrapper(32, 0.001)
    clock.take(500_000, 0.0)
    assert clock.take(7, 0.02) == pytest.approx(0.007)
    assert clock.n_restarts == 1


def test_a_clock_without_end_may_fall_too() -> None:
    clock = TimeUnwrapper(0, 1.0)
    clock.take(1e6, 0.0)
    clock.take(1e6 + 0.02, 0.02)
    clock.take(0.5, 0.02)
    assert clock.n_restarts == 1


SPANS = st.lists(
    st.tuples(st.sampled_from(["coil", "holding", "input"]), st.integers(0, 400), st.integers(1, 4)), max_size=40
)


@settings(deadline=None, max_examples=100)
@given(SPANS, st.integers(0, 124), st.integers(4, 125))
def test_every_signal_is_whole_in_one_request_of_a_size_the_controller_allows(
    spans: list[tuple[str, int, int]], gap: int, most: int
) -> None:
    blocks = plan_blocks(spans, gap, most)
    for table, address, count in spans:
        assert any(b.table == table and b.address <= address and address + count <= b.address + b.count for b in blocks)
    assert all(block.count <= (16 * most if block.table == "coil" else most) for block in blocks)


def test_without_a_gap_no_unused_address_is_read() -> None:
    blocks = plan_blocks([("input", 0, 2), ("input", 2, 1), ("input", 4, 1)], 0)
    assert [str(block) for block in blocks] == ["input 0..2", "input 4..4"]
