"""The simulated controller's Modbus server: pymodbus, in a thread and an event loop of its own."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from bench.errors import ConnectError
from bench.simulation.modbus.tables import TABLES, Tables

__all__ = ["TableServer"]

logging.getLogger("pymodbus").setLevel(logging.CRITICAL)

FUNCTIONS = {1: "coil", 5: "coil", 15: "coil", 2: "discrete", 3: "holding", 6: "holding", 16: "holding", 4: "input"}
"""Table of each function code (Modbus application protocol 1.1b3)."""
START_WITHIN_S = 10.0
LOOK_S = 0.02


class TableServer:
    """Serves tables to any number of clients, well or badly as it is told.

    Parameters
    ----------
    host, port : str, int
        Where to serve.
    unit_id : int
        The only unit that answers.
    tables : Tables
        What is read and written.
    """

    def __init__(self, host: str, port: int, unit_id: int, tables: Tables) -> None:
        self._address = (host, port)
        self._unit_id = unit_id
        self._tables = tables
        self._loop: asyncio.AbstractEventLoop | None = None
        self._server: Any = None
        self._thread: threading.Thread | None = None
        self.delay_s = 0.0
        """Every answer comes so much late, machine time."""
        self.exception_code = 0
        """Not 0: every request is refused with this code."""
        self.is_frozen = False
        """Requests are taken and not answered until it is False again."""

    def open(self) -> None:
        """Bind the port and serve. `ConnectError` if it is in use."""
        started: list[BaseException | None] = []
        ready = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(started, ready), name="modbus-server", daemon=True)
        self._thread.start()
        ready.wait(START_WITHIN_S)
        if not started or started[0] is not None:
            self.close()
            raise ConnectError(
                f"{self._address[0]}:{self._address[1]} (Modbus) is already in use.",
                hint="Is another simulated bench running? End it, or choose another [robot] host or port.",
            ) from (started[0] if started else None)

    def close(self) -> None:
        """Close all connections and end the thread. May be called twice."""
        thread, self._thread = self._thread, None
        if self._loop is not None and thread is not None and thread.is_alive():
            with suppress(RuntimeError):  # it has ended by itself
                self._loop.call_soon_threadsafe(self._stop)
        if thread is not None:
            thread.join()

    def drop_connections(self) -> None:
        """Close every client's connection; new ones are welcome."""
        if self._loop is not None and self._server is not None:
            self._loop.call_soon_threadsafe(self._close_clients)

    def judge(self, function: int) -> int:
        """Return the exception code that a request for this function is answered with; 0: it is granted."""
        return self.exception_code if function in FUNCTIONS else 1

    def _close_clients(self) -> None:
        for client in list(self._server.active_connections.values()):
            client.close()

    def _stop(self) -> None:
        self.is_frozen = False
        self._stopping.set()

    def _serve(self, started: list[BaseException | None], ready: threading.Event) -> None:
        try:
            asyncio.run(self._serve_until_stopped(started, ready))
        except Exception as error:
            started.append(error)
            ready.set()

    async def _serve_until_stopped(self, started: list[BaseException | None], ready: threading.Event) -> None:
        self._loop = asyncio.get_running_loop()
        self._stopping = asyncio.Event()
        self._server = ModbusTcpServer(self._make_device(), address=self._address)
        try:
            await self._server.serve_forever(background=True)
            started.append(None)
            ready.set()
            await self._stopping.wait()
        finally:
            await self._accept_no_more()
            await self._server.shutdown()
            await _end_other_tasks()
            await asyncio.sleep(LOOK_S)  # closing a connection takes a turn of the loop

    async def _accept_no_more(self) -> None:
        """Let a connection that is being accepted become one that is closed: the library would only let go of it."""
        if self._loop is not None and self._server.transport is not None:
            for listening in self._server.transport.sockets:
                self._loop.remove_reader(listening.fileno())
            await asyncio.sleep(LOOK_S)

    def _make_device(self) -> SimDevice:
        blocks = [
            [SimData(0, values=[False] * (-(-self._tables.size(table) // 16) * 16), datatype=DataType.BITS)]
            if table in ("coil", "discrete")
            else [SimData(0, count=self._tables.size(table), values=0, datatype=DataType.REGISTERS)]
            for table in TABLES
        ]
        return SimDevice(self._unit_id, (blocks[0], blocks[1], blocks[2], blocks[3]), action=self._make_action())

    def _make_action(self) -> Callable[..., Coroutine[None, None, ExcCodes | None]]:
        async def act(
            function: int, _start: int, address: int, _count: int, registers: list[int], values: Any
        ) -> ExcCodes | None:
            if self.delay_s:
                await asyncio.sleep(self.delay_s)
            while self.is_frozen:
                await asyncio.sleep(LOOK_S)
            if code := self.judge(function):
                return ExcCodes(code)
            table = FUNCTIONS[function]
            if values is not None:
                self._tables.write_cells(table, address, values)
            self._refresh(table, registers)
            return None

        return act

    def _refresh(self, table: str, registers: list[int]) -> None:
        """Put what the controller's memory holds where pymodbus answers from."""
        cells = self._tables.read_cells(table)
        if table in ("coil", "discrete"):
            cells += [0] * (-len(cells) % 16)
            cells = [sum(bit << i for i, bit in enumerate(cells[k : k + 16])) for k in range(0, len(cells), 16)]
        registers[: len(cells)] = cells


async def _end_other_tasks() -> None:
    """Let answers that still wait end with the server."""
    tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
