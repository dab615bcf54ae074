"""Our client behind a network that loses 5 % of all packets, doubles some and lets others overtake."""

from __future__ import annotations

from lossy_relay import LONGEST_HELD, lossy_relay
from natnet_bench import running_tracker
from test_natnet_end_to_end import Recording

from bench.config import TrackerConfig
from bench.drivers.tracker import make_tracker

HOST, RELAY_HOST = "127.0.32.41", "127.0.32.42"
SPEED = 10.0
N_FRAMES = 1_500


def test_every_loss_is_counted_and_none_is_invented() -> None:
    recording = Recording()
    with running_tracker(HOST, SPEED) as tracker, lossy_relay(RELAY_HOST, tracker.server.address) as relay:
        client = make_tracker(
            TrackerConfig(host=relay.address[0], command_port=relay.address[1]),
            tracker.clock,
            on_missed=lambda topic, n: recording.missed.append((topic, n)),
            on_lost=recording.lose,
        )
        client.open(recording.put)
        try:
            recording.wait(n_frames=N_FRAMES)
        finally:
            client.close()
    numbers = [frame.frame_number for frame in recording.frames]
    assert len(set(numbers)) == len(numbers)
    assert set(numbers) <= set(relay.passed)
    first, last = numbers[0], max(numbers)
    absent = set(range(first, last + 1)) - set(numbers)
    held_back_at_the_end = {number for number in absent if number > last - 2 * LONGEST_HELD}
    assert absent <= relay.lost | held_back_at_the_end
    assert relay.lost & set(range(first, last + 1)) <= absent
    assert len(absent) > N_FRAMES * 0.02
    assert sum(n for _, n in recording.missed) == len(absent)
    assert any(n > 1 for n in relay.passed.values())
    assert relay.order != sorted(relay.order)
    assert recording.loss == []
    assert {frame.segment for frame in recording.frames} == {0}
    told = [entry.text.split(":")[0] for entry in recording.log]
    assert {"Frames missed", "Frames late, out of order", "Frames received twice and recorded once"} == set(told)
