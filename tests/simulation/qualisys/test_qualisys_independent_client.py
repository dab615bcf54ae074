"""Qualisys' own library reads what the simulated QTM sends."""

from __future__ import annotations

import asyncio
import struct

import numpy as np
import pytest
import qtm_rt
from qualisys_bench import PATIENCE_S, running_qtm

HOST = "127.0.71.11"
N_FRAMES = 30


async def connect():
    connection = await qtm_rt.connect(HOST, timeout=PATIENCE_S)
    assert connection is not None
    return connection


async def listen(frames="allframes", n_frames=N_FRAMES):
    packets, done = [], asyncio.Event()

    def take(packet):
        packets.append(packet)
        if len(packets) >= n_frames:
            done.set()

    connection = await connect()
    try:
        await connection.stream_frames(frames, ["3dres", "3dnolabelsres", "6dres"], take)
        await asyncio.wait_for(done.wait(), PATIENCE_S)
        await connection.stream_frames_stop()
    finally:
        connection.disconnect()
    return packets


def test_it_reads_the_same_positions():
    with running_qtm(HOST) as qtm:
        packets = asyncio.run(listen())
    numbers = [packet.framenumber for packet in packets]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    for packet in packets:
        shown = qtm.scene.exposures[packet.framenumber]
        _, labeled = packet.get_3d_markers_residual()
        _, free = packet.get_3d_markers_no_label_residual()
        seen_mm = np.array([[one.x, one.y, one.z] for one in [*labeled, *free]])
        assert seen_mm == pytest.approx(shown.points_m * 1e3, rel=1e-6)
        assert [one.id for one in free] == shown.ids[3:].tolist()
        _, [(position, rotation, _residual)] = packet.get_6d_residual()
        assert (position.x, position.y, position.z) == (1000.0, 2000.0, 3000.0)
        assert rotation.matrix == (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)


def test_its_time_is_that_of_the_exposure_by_its_own_clock():
    with running_qtm(HOST) as qtm:
        packets = asyncio.run(listen())
    for packet in packets:
        exposed_ns = qtm.scene.host_ns[packet.framenumber]
        assert abs(qtm.tracker_clock.ticks_at(exposed_ns) - packet.timestamp) <= 1


def test_a_client_may_ask_for_fewer_frames():
    with running_qtm(HOST):
        packets = asyncio.run(listen("frequencydivisor:4", 5))
    assert all(packet.framenumber % 4 == 0 for packet in packets)


def test_it_tells_its_version_state_settings_and_newest_frame():
    async def ask():
        connection = await connect()
        try:
            assert await connection.qtm_version() == b"QTM Version is 2024.2 (build 16000)"
            assert await connection.byte_order() == b"Byte order is little endian"
            asked = asyncio.ensure_future(connection.await_event(timeout=PATIENCE_S))
            await asyncio.sleep(0)
            await connection._protocol.send_command("getstate", callback=False)
            assert await asked == qtm_rt.QRTEvent.EventCaptureStarted
            settings = await connection.get_parameters(["general", "3d", "6d"])
            packet = await connection.get_current_frame(["3dnolabelsres"])
            return settings, packet
        finally:
            connection.disconnect()

    with running_qtm(HOST) as qtm:
        asyncio.run(listen(n_frames=1))  # so that there is a newest frame
        settings, packet = asyncio.run(ask())
    assert b"<Frequency>100</Frequency>" in settings
    assert b"<Name>clamp - 2</Name>" in settings
    assert len(packet.get_3d_markers_no_label_residual()[1]) == len(qtm.scene.exposures[packet.framenumber].ids) - 3


@pytest.mark.parametrize(
    "command",
    ["nonsense", "version", "version 9.9", "version x", "streamframes sometimes 3dres", "streamframes allframes 2d"],
)
def test_an_odd_command_is_answered_and_the_connection_stays(command):
    async def ask():
        connection = await connect()
        try:
            try:
                answer = await asyncio.wait_for(connection._protocol.send_command(command), PATIENCE_S)
            except qtm_rt.QRTCommandException as refusal:
                answer = refusal.value
            await connection.qtm_version()
            return answer
        finally:
            connection.disconnect()

    with running_qtm(HOST):
        answer = asyncio.run(ask())
    assert answer in (b"Parse error", b"Version NOT supported", b"Version is 1.25")


def test_a_lying_length_ends_the_connection():
    async def ask():
        reader, writer = await asyncio.open_connection(HOST, 22223)
        writer.write(struct.pack("<II", 1 << 30, 1))
        try:
            return await asyncio.wait_for(reader.read(), PATIENCE_S)
        finally:
            writer.close()
            await writer.wait_closed()

    with running_qtm(HOST):
        assert b"QTM RT Interface connected" in asyncio.run(ask())
