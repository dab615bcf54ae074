"""Writes the reference pages that are made from the code: ``python tests/docs/reference_pages.py``.

A test says so when one of them is not current.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from functools import cache
from typing import Any, get_args

from markdown_pages import ROOT
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from bench.config import Config, config_schema
from bench.recording.messages.schemas import load_schema
from bench.recording.messages.topics import TOPICS

REFERENCE = ROOT / "docs" / "reference"
NOTICE = "<!-- made by tests/docs/reference_pages.py: do not edit by hand -->\n"

TABLE_HEAD = "| key | kind | default | meaning |\n|---|---|---|---|\n"
CONFIGURATION_HEAD = """# Configuration

A configuration is one TOML file. Every key that is a quantity carries its unit in its name. An unknown key, a wrong
unit, text where a number belongs: each is refused with file, line and a suggestion, and exit code 2. Nothing is
guessed.

```console
$ bench config check lab.toml
$ bench config show lab.toml
$ bench config schema
```

`show` prints the file with every default filled in; that resolved text is what travels in the run file. `schema`
prints a JSON schema for editors. [`bench_configs/`](../../bench_configs/) has files to start from.

**bold**: must be given. Which tables are needed depends on the command: `bench run` and `bench check` need `[robot]`
and `[tracker]`; `bench import` and `bench report` do not.
"""

CONFIGURATION_TAIL = """
## What the keys have to say to each other

- Give either `marker_arc_length_m`, or `marker_count` together with `marker_spacing_m`. The anchor itself is at arc
  length 0 and is not in the list.
- `axial_stiffness_n` and `max_tension_n` belong together. Then `stretch` is their ratio (Hooke's law).
- `kind = "rigid_body"` needs `name`; `position_m` belongs to `kind = "static_marker"`.
- `register` and `running_register` are both output integer registers and must differ.
- `first_cycle_speed` below 1 needs a program that waits for a grant before each cycle.
- A `[simulation]` table needs loopback addresses (127.x.y.z): it makes `bench run` start the simulated bench.
"""

FORMAT_HEAD = """# Recording format

A run file is an [MCAP](https://mcap.dev) file. Every message is CDR (little endian, XCDR1) with a `ros2msg` schema, so
that Lichtblick, Foxglove, Rerun and PlotJuggler open it without plugins. The schemas travel in the file.

While it is written the file is called `NAME.mcap.active`; when it is finished it is renamed to `NAME.mcap`. An
existing file is never overwritten. Chunks are LZ4-compressed, at most about 1 MiB or half a second long, each with a
checksum. Why it is so: [the explanation](../explanations/recording.md).

## Times and numbers

| MCAP field | meaning |
|---|---|
| `log_time` | arrival at this computer, host time |
| `publish_time` | capture, mapped to host time by the clock map known online; for events the moment of the event |
| `sequence` | the device's own number: the place on the controller's time grid, or the tracker's frame number |

Host time is Unix nanoseconds computed from one pair of monotonic clock and UTC, read when the run starts. Raw device
times are in the messages, so that the maps can be computed again; the report does so.
What is missing is NaN, or -1 for an integer, never 0. Lengths are metres, angles radians.

## Metadata

| record | holds |
|---|---|
| `bench.config` | `toml`: the resolved configuration |
| `bench.run` | run id, format version, library versions, start |
| `bench.facts` | name, sample, operator, computer, whether the bench was simulated |
| `bench.channels` | topics by channel number, again, so that a file without its first chunk can be read |
| `bench.device.robot`, `bench.device.tracker` | what each device said of itself, and who stamps its arrivals |
| `bench.preflight` | each check before the first cycle, verdict and value; the program that the controller has loaded |
| `bench.program` | what the controller tells of the loaded program; `file`, `sha256`, `bytes` of the copy, see below |
| `bench.cycle_source` | what tells the cycles, and how well it knows their times |
| `bench.cycles` | how many cycles were completed |
| `bench.resumed_from` | of a run that goes on with another: its run id and file, cycles completed and recorded |
| `bench.import` | for imported takes: file, checksum, format, what its header promised |
| `bench.part` | of a run that is split by size: number of the part, the first one's file, messages written before it |
| `bench.continues` | at the end of each part but the last: the file in which the run goes on, and the counts so far |
| `bench.salvage` | `lost`: of a file made by `bench salvage`, what was lost |
| `bench.end` | exit status, reason, and for each topic received, written, dropped, missed; longest queue and sync |

## Attachments

| file | holds |
|---|---|
| `config.toml` | the resolved configuration |
| `calibration.toml` | the calibration that the configuration names, if any; it is part of `config.toml`, too |
| `program.urp`, or another suffix | the copy of the robot's program that `[robot] program_file` names, byte for byte |

`open_run("run.mcap").read_attachment("config.toml")` gives the bytes of one. Which one is the program, `bench.program`
says as `attachment`. `loaded` is the loaded program's name or path on the controller, and `loaded_sha256` and
`loaded_bytes` are of what a controller gives out of it (PolyScope X from 10.12 on).

## What the recorder counts

Twice a second `/bench/stats` has a message for each topic that had records: handed to the recorder (`received`), given
to the file (`written`), not written though received (`dropped`: the queue was full, or the record did not fit its
schema), never received (`missed`: gaps in the device's sequence), the longest the queue ever was, and the longest sync.
At every moment received = written + dropped. The same totals are in `bench.end`.

## Topics
"""


def make_configuration_page() -> str:
    """Return the text of ``docs/reference/configuration.md``."""
    parts = [CONFIGURATION_HEAD]
    places = {model: heading for heading, model in reversed(list(_tables("", Config)))}
    for heading, model in _tables("", Config):
        parts.append(f"\n## {heading}\n\n{inspect.cleandoc(model.__doc__ or '')}\n")
        parent = next((p for p in model.__mro__[1:] if p in places), None)
        if parent is not None:
            parts.append(f"\nThe keys of {_link(places[parent])}, and these, if any:\n")
        keys = [key for key in model.model_fields if parent is None or key not in parent.model_fields]
        rows = [row for key in keys for row in _rows(key, model, places)]
        parts.append(f"\n{TABLE_HEAD}{''.join(rows)}" if rows else "")
    return NOTICE + "".join(parts) + CONFIGURATION_TAIL


def make_recording_format_page() -> str:
    """Return the text of ``docs/reference/recording-format.md``."""
    rows = "".join(f"| `{topic.name}` | [`{topic.schema}`](#{_slug(topic.schema)}) |\n" for topic in TOPICS.values())
    parts = [FORMAT_HEAD, "\n| topic | schema |\n|---|---|\n", rows, "\n## Schemas\n"]
    schemas = dict.fromkeys(topic.schema for topic in TOPICS.values())
    parts.extend(f"\n### {name}\n\n```text\n{load_schema(name).text.strip()}\n```\n" for name in schemas)
    return NOTICE + "".join(parts)


PAGES = {
    REFERENCE / "configuration.md": make_configuration_page,
    REFERENCE / "recording-format.md": make_recording_format_page,
}


def _tables(prefix: str, model: type[BaseModel], of_kind: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Return heading and model of each table; one that another row leads to has its heading once."""
    seen: set[type[BaseModel]] = set()
    for name, info in model.model_fields.items():
        models = _models_in(info.annotation)
        for inner in models:
            if info.description and inner in seen:
                continue
            seen.add(inner)
            kind = of_kind or (get_args(inner.model_fields["kind"].annotation)[0] if len(models) > 1 else "")
            yield f"[{prefix}{name}]" + (f" of kind {kind}" if kind else ""), inner
            for heading, deeper in _tables(f"{prefix}{name}.", inner, kind):
                if deeper not in seen or not info.description:
                    seen.add(deeper)
                    yield heading, deeper


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    """Return the models an annotation allows, whatever it wraps them in."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for inner in get_args(annotation) for model in _models_in(inner)]


def _rows(field: str, model: type[BaseModel], places: dict[type[BaseModel], str]) -> list[str]:
    info = model.model_fields[field]
    tables = _models_in(info.annotation)
    if not tables:
        return [_row(field, model)]
    if not info.description:
        return []
    shown = f"**`{field}`**" if info.is_required() else f"`{field}`"
    default = "" if info.is_required() else "none"
    return [f"| {shown} | table {_link(places[tables[0]])} | {default} | {info.description} |\n"]


def _link(heading: str) -> str:
    return f"[`{heading.partition(' ')[0]}`](#{_slug(heading.replace(' ', '-'))})"


def _row(field: str, model: type[BaseModel]) -> str:
    info = model.model_fields[field]
    key = info.alias or field
    shown = f"**`{key}`**" if info.is_required() else f"`{key}`"
    meaning = (info.description or "").replace("|", "\\|")
    return f"| {shown} | {_kind(key, model)} | {_default(info)} | {meaning} |\n"


def _default(info: FieldInfo) -> str:
    if info.default is PydanticUndefined:
        return ""
    if info.default is None or info.default == "":
        return "none"
    value = f'"{info.default}"' if isinstance(info.default, str) else f"{info.default}"
    return f"`{value.lower() if isinstance(info.default, bool) else value}`"


def _kind(key: str, model: type[BaseModel]) -> str:
    schema = _definitions()[model.__name__]["properties"][key]
    options = [o for o in schema.get("anyOf", [schema]) if o.get("type") != "null"]
    return " or ".join(_describe(option) for option in options)


@cache
def _definitions() -> dict[str, Any]:
    definitions: dict[str, Any] = config_schema()["$defs"]
    return definitions


def _describe(schema: dict[str, Any]) -> str:
    if "enum" in schema or "const" in schema:
        values = schema.get("enum", [schema.get("const")])
        return ", ".join(f'`"{value}"`' if isinstance(value, str) else f"`{value}`" for value in values)
    if schema["type"] == "array":
        if schema.get("items", {}).get("type") == "integer":
            return "list of whole numbers"
        n = schema.get("minItems")
        return f"list of {n} numbers" if n == schema.get("maxItems") and n else "list of numbers"
    words = {"string": "text", "integer": "whole number", "number": "number", "boolean": "`true`, `false`"}
    return words[schema["type"]] + _bounds(schema)


def _bounds(schema: dict[str, Any]) -> str:
    low = f" {schema['minimum']:g}" if "minimum" in schema else ""
    low = f" above {schema['exclusiveMinimum']:g}" if "exclusiveMinimum" in schema else low
    high = f" to {schema['maximum']:g}" if "maximum" in schema else ""
    high = f" to below {schema['exclusiveMaximum']:g}" if "exclusiveMaximum" in schema else high
    if low and not high and "above" not in low:
        return f", at least{low}"
    return f",{low}{high}" if low or high else ""


def _slug(name: str) -> str:
    return "".join(character for character in name.lower() if character.isalnum() or character in "-_")


def main() -> None:
    for path, make in PAGES.items():
        path.write_text(make(), encoding="utf-8")


if __name__ == "__main__":
    main()
