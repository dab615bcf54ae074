"""QTM's components and settings, bytes for bytes."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.drivers.tracker.qualisys.frames import (
    BODIES,
    BODY,
    FREE,
    FREE_MARKERS,
    LABELED,
    LABELED_MARKERS,
    read_bodies,
    read_points,
)
from bench.drivers.tracker.qualisys.settings import read_settings
from bench.errors import ProtocolError
from bench.model import UNLABELED


def make(**components):
    """Return a packet's content and the places of its components."""
    data, places = b"\0" * 16, {}
    kinds = {"labeled": LABELED_MARKERS, "free": FREE_MARKERS, "bodies": BODIES}
    for name, rows in components.items():
        places[kinds[name]] = len(data) + 8
        content = struct.pack("<Ihh", len(rows), 0, 0) + rows.tobytes()
        data += struct.pack("<II", len(content) + 8, kinds[name]) + content
    return data, places


def test_points_are_metres_and_a_label_that_is_not_seen_is_left_out():
    labeled = np.array([((1.0, 2.0, 3.0), 0.5), ((np.nan,) * 3, np.nan), ((4.0, 5.0, 6.0), 0.25)], dtype=LABELED)
    free = np.array([((1000.0, -2000.0, 500.0), 70_001, 0.75)], dtype=FREE)
    points = read_points(*make(labeled=labeled, free=free))
    assert points.points_m == pytest.approx(np.array([[0.001, 0.002, 0.003], [0.004, 0.005, 0.006], [1.0, -2.0, 0.5]]))
    assert points.ids.tolist() == [1, 3, 70_001]
    assert points.flags.tolist() == [0, 0, UNLABELED]
    assert points.residual_m == pytest.approx([0.0005, 0.00025, 0.00075])


def test_a_rotation_comes_column_by_column():
    quarter_turn_about_z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rows = np.zeros(2, dtype=BODY)
    rows[0] = ((1000.0, 0.0, 0.0), quarter_turn_about_z.T, 0.5)
    rows[1] = ((np.nan,) * 3, np.full((3, 3), np.nan), np.nan)
    seen, hidden = read_bodies(*make(bodies=rows))
    assert seen.quaternion_xyzw == pytest.approx((0.0, 0.0, 0.5**0.5, 0.5**0.5))
    assert (seen.body_id, seen.position_m, seen.tracking_valid) == (1, (1.0, 0.0, 0.0), True)
    assert seen.mean_error_m == pytest.approx(0.0005)
    assert (hidden.body_id, hidden.tracking_valid) == (2, False)


def test_a_matrix_that_turns_nothing_is_no_pose():
    rows = np.zeros(1, dtype=BODY)
    assert not read_bodies(*make(bodies=rows))[0].tracking_valid


def test_what_was_not_sent_is_empty():
    points = read_points(b"", {})
    assert points.points_m.shape == (0, 3)
    assert read_bodies(b"", {}) == ()


@given(st.data())
@settings(max_examples=100, deadline=None)
def test_cut_and_lying_packets_raise_only_a_protocol_error(data):
    free = np.zeros(data.draw(st.integers(0, 5)), dtype=FREE)
    packet, places = make(labeled=np.zeros(3, dtype=LABELED), free=free, bodies=np.zeros(1, dtype=BODY))
    spoilt = bytearray(packet[: data.draw(st.integers(0, len(packet)))])
    if spoilt:
        spoilt[data.draw(st.integers(0, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    for read in (read_points, read_bodies):
        try:
            read(bytes(spoilt), places)
        except ProtocolError as error:
            assert "QTM packet" in str(error)


def test_settings_are_read_by_name_whatever_else_is_there():
    text = (
        b"<QTM_Parameters_Ver_1.25><General><Frequency>240</Frequency><Camera><ID>1</ID></Camera></General>"
        b"<The_6D><Body><Color R='1'/><Name>flange</Name></Body><Body><Name>pole</Name></Body></The_6D>"
        b"<The_3D><AxisUpwards>+Z</AxisUpwards><Label><Name>flange - 1</Name></Label></The_3D>"
        b"</QTM_Parameters_Ver_1.25>"
    )
    found = read_settings(text)
    assert (found.rate_hz, found.up_axis) == (240.0, "+Z")
    assert (found.labels, found.bodies) == (("flange - 1",), ("flange", "pole"))


def test_settings_without_anything_say_that_nothing_is_known():
    found = read_settings(b"<QTM_Parameters_Ver_1.13/>")
    assert np.isnan(found.rate_hz)
    assert (found.up_axis, found.labels, found.bodies) == ("", (), ())


def test_settings_that_are_no_xml_are_refused():
    with pytest.raises(ProtocolError, match="cannot be read"):
        read_settings(b"HTTP/1.1 400 Bad Request")
