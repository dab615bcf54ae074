"""Which outputs a controller's software is too old for, as far as that is known.

Only what has a source is listed: a wrong line here costs a field on every robot in the field, a missing one costs
nothing, for a controller answers NOT_FOUND for a name that it does not know.
"""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["SINCE", "Version", "find_since", "too_new_outputs"]

Version = tuple[int, int, int, int]
"""Major (3: CB3, 5: e-Series, 10: PolyScope X), minor, bugfix and build of a controller's software."""

SINCE: Mapping[str, Mapping[int, tuple[int, int, int]]] = {
    # UR client library, pull request 110
    "tcp_offset": {3: (3, 12, 0), 5: (5, 5, 1)},
    # ur_rtde 1.6, recipe of its RTDEReceiveInterface; the RTDE guide has the same for the last three
    "payload": {3: (3, 11, 0), 5: (5, 5, 1)},
    "payload_cog": {3: (3, 11, 0), 5: (5, 5, 1)},
    "ft_raw_wrench": {5: (5, 9, 0)},
    "payload_inertia": {3: (3, 15, 0), 5: (5, 11, 0)},
    "actual_current_as_torque": {5: (5, 23, 0), 10: (10, 11, 0)},
    # UR client library, pull request 529, tried on 10.13.0
    "control_step": {5: (5, 26, 0), 10: (10, 13, 0)},
}
"""First version of each generation that has an output; a generation that is not named may have it or not."""


def find_since(name: str, version: Version) -> str:
    """Return the first version of this generation that has `name`, if `version` is older; else empty."""
    since = SINCE.get(name, {}).get(version[0])
    return "" if since is None or version[:3] >= since else ".".join(map(str, since))


def too_new_outputs(version: Version) -> frozenset[str]:
    """Return the outputs that `version` is known to lack."""
    return frozenset(name for name in SINCE if find_since(name, version))
