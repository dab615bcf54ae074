"""Which version the frames are in. The server's own word is not enough, the frames prove it."""

from __future__ import annotations

from bench.drivers.tracker.natnet.frame import BITSTREAM_CHANGED, Frame, decode_frame
from bench.drivers.tracker.natnet.models import Model, decode_models
from bench.drivers.tracker.natnet.wire import Version, dotted
from bench.errors import ProtocolError

__all__ = ["WANTED_VERSION", "Bitstream"]

WANTED_VERSION: Version = (4, 1, 0, 0)
"""What we ask of NatNet 4 servers: the first version whose sections tell their size."""
CHOOSING_SINCE = (4, 0)
LAYOUTS: tuple[Version, ...] = ((4, 1), (4, 0), (2, 10))
"""One version of each layout of frames: with sizes, without (3.0 to 4.0), without stamps (2.9 and 2.10)."""
DOUBTFUL_FAILURES = 3
"""Frames in a row that are of another version after all: what breaks on its way does not look like one so often."""


class Bitstream:
    """Decodes frames in the version that was agreed on, or in the one that turns out to be sent.

    Parameters
    ----------
    server_version : tuple of int
        What the server says of itself.
    may_choose : bool, optional
        Whether a client is sent the version it asked for: not in multicast.
    """

    def __init__(self, server_version: Version, *, may_choose: bool = True) -> None:
        self.is_chosen = may_choose and server_version >= CHOOSING_SINCE
        """Whether we may have the version that we want."""
        agreed = min(server_version, WANTED_VERSION) if self.is_chosen else server_version
        self._candidates = list(dict.fromkeys((agreed[:2], server_version[:2], *LAYOUTS)))
        self._proven = False
        self._n_failures = 0

    @property
    def version(self) -> Version:
        """The version in use, as far as is known."""
        return self._candidates[0]

    def decode_frame(self, payload: bytes) -> Frame:
        """Decode a frame; until one was understood, try the other versions before giving up.

        Raises
        ------
        ProtocolError
            The frame is of no version we know, or broken.
        """
        if not self._proven:
            frame = self._first_that_fits(payload)
            self._proven = True
            return frame
        try:
            frame = decode_frame(payload, self._candidates[0])
        except ProtocolError:
            return self._decode_unexpected(payload)
        self._n_failures = 0
        return frame

    def _decode_unexpected(self, payload: bytes) -> Frame:
        """Decode a frame that is not of the proven version: broken, or the first of another, which says so itself."""
        self._n_failures += 1
        proven = self._candidates[0]
        frame = self._first_that_fits(payload)
        if frame.params & BITSTREAM_CHANGED or self._n_failures >= DOUBTFUL_FAILURES:
            self._n_failures = 0
            return frame
        self._prefer(proven)
        raise ProtocolError(f"A NatNet frame is not of version {dotted(proven)}, as those before it.")

    def doubt(self) -> None:
        """Try all versions again: the server says that it changed the bitstream, or no frame can be read any more."""
        self._proven = False
        self._n_failures = 0

    def decode_models(self, payload: bytes) -> tuple[Model, ...]:
        """Decode the model definitions, in the version of the frames or in the server's own."""
        try:
            return decode_models(payload, self.version)
        except ProtocolError:
            for version in self._candidates[1:]:
                try:
                    return decode_models(payload, version)
                except ProtocolError:
                    continue
            raise

    def _first_that_fits(self, payload: bytes) -> Frame:
        first_error: ProtocolError | None = None
        for version in self._candidates:
            try:
                frame = decode_frame(payload, version)
            except ProtocolError as error:
                first_error = first_error or error
                continue
            self._prefer(version)
            return frame
        raise first_error or ProtocolError("A NatNet frame is of no known version.")

    def _prefer(self, version: Version) -> None:
        self._candidates.remove(version)
        self._candidates.insert(0, version)
