"""A client that others wrote reads what the simulated tracker sends."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from natnet import DataDescriptions, DataFrame, NatNetClient
from natnet_bench import PATIENCE_S, SimulatedTracker, running_tracker

HOST = "127.0.32.31"
N_FRAMES = 60
SPEED = 2.0
DATA_PORT = 15_111
"""None that anyone else in this network namespace listens on."""


class Listener:
    """What the other client hands out."""

    def __init__(self) -> None:
        self.frames: list[DataFrame] = []
        self.descriptions: list[DataDescriptions] = []
        self.done = threading.Event()

    def take_frame(self, frame: DataFrame) -> None:
        self.frames.append(frame)
        self._look()

    def take_descriptions(self, descriptions: DataDescriptions) -> None:
        self.descriptions.append(descriptions)
        self._look()

    def _look(self) -> None:
        if len(self.frames) >= N_FRAMES and self.descriptions:
            self.done.set()


def listen(tracker: SimulatedTracker, multicast: bool, data_port: int) -> Listener:
    listener = Listener()
    host, port = tracker.server.address
    client = NatNetClient(
        server_ip_address=host,
        local_ip_address="127.0.32.32",
        command_port=port,
        data_port=data_port,
        use_multicast=multicast,
    )
    client.on_data_frame_received_event.handlers.append(listener.take_frame)
    client.on_data_description_received_event.handlers.append(listener.take_descriptions)
    client.connect(timeout=PATIENCE_S)
    try:
        client.run_async()
        client.request_modeldef()
        assert listener.done.wait(PATIENCE_S)
    finally:
        client.shutdown()
    return listener


@pytest.mark.parametrize("multicast", [False, True])
@pytest.mark.parametrize("version", ["3.0", "3.1", "4.0", "4.1", "4.2", "4.3"])
def test_an_independent_client_reads_the_same_positions(
    version: str, multicast: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = {"natnet_version": version, "natnet_multicast": multicast, "data_port": DATA_PORT}
    with running_tracker(HOST, SPEED, **settings) as tracker:
        listener = listen(tracker, multicast, DATA_PORT)
    assert capsys.readouterr().out == ""  # it prints what it finds odd
    numbers = [frame.prefix.frame_number for frame in listener.frames]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    for frame in listener.frames:
        shown = tracker.scene.exposures[frame.prefix.frame_number]
        points_m = np.array([marker.pos for marker in frame.labeled_markers], dtype=np.float32)
        assert np.array_equal(points_m, shown.points_m)
        assert [marker.unlabeled for marker in frame.labeled_markers] == [False] * 3 + [True] * 9
        assert [marker.id_num for marker in frame.labeled_markers] == shown.ids.tolist()
        assert np.array_equal(np.array(frame.unlabeled_marker_pos, dtype=np.float32), shown.points_m[:3])
        assert frame.rigid_bodies[0].tracking_valid
        assert frame.suffix.stamp_camera_mid_exposure < frame.suffix.stamp_data_received < frame.suffix.stamp_transmit
    (body,) = listener.descriptions[0].rigid_bodies
    assert (body.name, body.id_num, len(body.markers)) == ("clamp", 4, 3)
